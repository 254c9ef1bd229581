"""Figures of sets of models and of their members: covers, records, responses, worst members, campaigns.

The weight over the models' errors, the parameters in their box, the influence of each block; a record as explained by
the smallest Delta, and in the envelope of all members (figures 11.5-11.20 of the thesis).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.campaign.campaign_result import CampaignResult, exceedance_curve
from robustlab.campaign.store import Store
from robustlab.errors import InputError
from robustlab.identification.comparison.envelope import EnvelopeCoverage
from robustlab.identification.validation import Validation
from robustlab.identification.validation.data_cover import DataCover
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.margins.cover import Cover
from robustlab.report import style
from robustlab.report.robustness_figures import response_figure
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.covers import Overbound, error_sizes
from robustlab.uncertainty.unstructured import Form
from robustlab.worst_case_analysis import WorstCase
from robustlab.worst_case_analysis.sampling import Responses

if TYPE_CHECKING:
    from robustlab.dynamics.extended.effect_blocks import EffectBlocks

SHOWN = 24  # parameters side by side
MODELS = 60  # errors drawn one by one
LIGHTEST = 1e-7  # smallest value drawn, relative to the largest
NOMINAL: dict[str, Any] = {"color": style.NOMINAL, "lw": 1.2, "ls": (0, (5, 1.5)), "label": "nominal"}
RECORD: dict[str, Any] = {"color": style.MEASURED, "lw": 1.4, "label": "record"}
EXPLAINED: dict[str, Any] = {"color": style.WORST, "lw": 1.1, "label": "with the smallest Delta"}


# --- covers -----------------------------------------------------------------------------------------------------------


def cover_figures(cover: Cover, models: Sequence[StateSpaceModel]) -> dict[str, tuple[Figure, str]]:
    """Return ``weight`` of an unstructured form or ``cloud`` of a parametric one with its caption."""
    if cover.fit is not None:
        text = "The weight, and below it the error of every model against the nominal one."
        return {"weight": (weight_figure(cover, models), text)}
    if not cover.model.blocks:
        return {}
    return {"cloud": (cloud_figure(cover), "Every model as a point in the box of the parameters.")}


def cover_figure(cover: Cover, models: Sequence[StateSpaceModel] = ()) -> Figure:
    """The weight of an unstructured form (over the errors of ``models``), the cloud of a parametric one."""
    for figure, _ in cover_figures(cover, models).values():
        return figure
    raise InputError("Cover.plot", "a cover without blocks", "one with something uncertain in it")


def weight_figure(cover: Cover, models: Sequence[StateSpaceModel] = ()) -> Figure:
    """Errors of the models, their bound, and the weight above it; below, its excess."""
    assert cover.fit is not None
    form = cast(Form, cover.form)
    errors = error_sizes(tuple(models), cover.model.nominal, form, cover.fit.omega) if models else ()
    return overbound_figure(cover.fit, errors, f"{cover.form}: weight over the errors of {len(cover.sizes)} models")


@style.house_style()
def overbound_figure(fit: Overbound, errors: Sequence[Array] | Array = (), title: str = "") -> Figure:
    """A weight above its bound, and the curves under the bound; below, its excess."""
    ratios = {"height_ratios": [2.2, 1.0]}
    figure, (above, below) = style.new_figure(2, 1, width=7.6, height=2.3, sharex=True, gridspec_kw=ratios)
    floor = LIGHTEST * float(fit.bound.max())
    for k, row in enumerate(errors[:MODELS]):
        label = "error of a model" if k == 0 else None
        above.plot(fit.omega, np.maximum(row, floor), color=style.SAMPLE, lw=0.8, label=label)
    above.plot(fit.omega, fit.bound, color=style.MEASURED, lw=1.0, ls=(0, (5, 1.5)), label="bound")
    above.plot(fit.omega, fit.magnitude, color=style.NOMINAL, label=f"weight of order {fit.order}")
    style.logarithmic(above.xaxis)
    style.logarithmic(above.yaxis)
    height = max(float(fit.bound.min()) / 10.0, floor), 2.0 * float(fit.magnitude.max())
    heading = style.plain_label(title or f"weight of order {fit.order} above a bound")
    above.set(ylim=height, ylabel="gain", title=heading)
    below.plot(fit.omega, 100.0 * (fit.magnitude / fit.bound - 1.0), color=style.NOMINAL)
    below.set_ylim(bottom=0.0)
    below.set(ylabel="above the\nbound [%]", xlabel="frequency [rad/s]")
    style.legend_below(figure, (above,), 3)
    return figure


@style.house_style()
def cloud_figure(cover: Cover) -> Figure:
    """Every model as a point in the range of each parameter."""
    names = [b.name for b in cover.model.blocks]
    deltas = np.array([[float(d[name]) for name in names[:SHOWN]] for d in cover.deltas])
    figure, (axes,) = style.new_figure(width=6.4, height=1.2 + 0.27 * max(3, deltas.shape[1]))
    for k, column in enumerate(deltas.T):
        axes.plot([-1, 1], [k, k], color=style.BAND, lw=5, alpha=0.35, solid_capstyle="butt")
        axes.plot(column, np.full(len(column), k), "o", ms=3.5, color=style.NOMINAL, alpha=0.7)
    more = f", {SHOWN} of {len(names)} shown" if len(names) > SHOWN else ""
    title = f"{len(names)} parameter{'s' * (len(names) > 1)}{more}"
    _places(axes, names[:SHOWN])
    axes.set(xlim=(-1.12, 1.12), xlabel="normalised value", title=title)
    return figure


def _places(axes: Any, names: Sequence[str]) -> None:
    """Set a row for each parameter over its range from -1 to 1."""
    axes.set_yticks(range(len(names)), [style.plain_label(name[:40]) for name in names])
    axes.set(ylim=(len(names) - 0.4, -0.6), xticks=[-1, -0.5, 0, 0.5, 1])
    axes.grid(visible=False, axis="y")


@style.house_style()
def blocks_figure(made: EffectBlocks) -> Figure:
    """Change of the nominal model's response by each block alone, relative to its size, over frequency.

    A real parameter at both of its ends, a dynamic block at the largest gain that it can add.
    """
    model = made.model
    if not model.blocks:
        raise InputError("EffectBlocks.plot", "a model without blocks", "one with something uncertain in it")
    q, p = model.delta_shape
    omega = default_grid(model.nominal, 240)
    m = frequency_response(model.M, omega)
    plant = slice(q + len(made.noise), None)
    size = np.linalg.norm(m[:, p:, plant], 2, axis=(1, 2))
    figure, (axes,) = style.new_figure(1, 1, width=7.6, height=3.4)
    row = col = 0
    for k, block in enumerate(model.blocks):
        w, z = slice(row, row + block.rows), slice(col, col + block.cols)
        row, col = row + block.rows, col + block.cols
        moved = _moved(m[:, z, w], m[:, z, plant], m[:, p:, w], not block.is_scalar)
        dashes = ("-", (0, (5, 1.5)), (0, (1, 1)))[k // 10 % 3]
        percent, label = np.maximum(100.0 * moved / size, 1e-12), style.plain_label(block.name)
        axes.plot(omega, percent, label=label, lw=1.4, color=f"C{k % 10}", ls=dashes)
    style.frequency_axis(axes)
    style.logarithmic(axes.yaxis)
    top = max(float(np.max(line.get_ydata())) for line in axes.lines)
    height = max(1e-3, 1e-6 * top), 2.0 * top
    axes.set(ylim=height, ylabel="change of the response [%]", title="What each block alone does")
    style.legend_below(figure, (axes,), 4)
    return figure


def _moved(m11: Any, m12: Any, m21: Any, full: bool) -> Array:
    """Return the largest ``||m21 (I - Delta m11)^-1 Delta m12||`` over Delta = +-1 (of a full block a bound)."""
    if full:
        loop = np.linalg.norm(m11, 2, axis=(1, 2))
        gain = np.linalg.norm(m21, 2, axis=(1, 2)) * np.linalg.norm(m12, 2, axis=(1, 2))
        return np.where(loop < 1.0, gain / np.maximum(1.0 - loop, 1e-12), np.inf)
    eye = np.eye(m11.shape[1])
    changes = [m21 @ np.linalg.solve(eye - sign * m11, sign * m12) for sign in (-1.0, 1.0)]
    return np.max([np.linalg.norm(c, 2, axis=(1, 2)) for c in changes], axis=0)


# --- records and sets -------------------------------------------------------------------------------------------------


@style.house_style()
def validation_figure(found: Validation, output: str | None = None) -> Figure:
    """One output recorded, of the nominal model and as explained; below, the residuals in the noise bound.

    Of a measured frequency response the magnitudes alone.
    """
    output = style.chosen([name for name, _ in found.outputs], output, "output")
    k = [name for name, _ in found.outputs].index(output)
    response = found.domain == "frequency" and found.noise_norm == "peak"
    figure, panels = style.new_figure(1 if response else 2, 1, width=7.6, height=3.4 if response else 2.4, sharex=True)
    measured, nominal, explained = (a[:, k] for a in (found.measured, found.nominal, found.explained))
    curves = [(nominal, NOMINAL), *([(explained, EXPLAINED)] if np.isfinite(explained).all() else [])]
    for curve, how in [*curves, (measured, RECORD)]:
        panels[0].plot(found.t, curve, **how)
    panels[0].set_title(style.plain_label(f"{found.record}: {found.verdict}"))
    if response:
        style.frequency_axis(panels[0])
        style.logarithmic(panels[0].yaxis)
        panels[0].set_ylabel(f"|{style.plain_label(output)}| per input")
    else:
        below, unit, bound = panels[1], found.outputs[k][1], found.noise_bound[output]
        for curve, how in curves:
            below.plot(found.t, measured - curve, **how)
        word = "noise bound" if found.noise_norm == "peak" else "rms noise bound"
        below.axhspan(-bound, bound, color=style.BAND, alpha=0.35, lw=0, label=word)
        panels[0].set_ylabel(style.axis_label(output, unit))
        time = "time in the mean period [s]" if found.domain == "frequency" else "time [s]"
        below.set(ylabel=style.axis_label("record minus model", unit), xlabel=time)
    style.legend_below(figure, panels, 4)
    return figure


def cover_record(found: DataCover, record: str | None = None, output: str | None = None) -> Figure:
    """One record of a set, of the nominal model and as explained."""
    return validation_figure(found.validations[style.chosen(list(found.validations), record, "record")], output)


@style.house_style()
def delta_figure(found: Validation) -> Figure:
    """Size of each block over frequency, and gamma."""
    if found.domain != "frequency" or not np.isfinite(found.upper):
        given = f"domain {found.domain}, gamma {found.upper:.4g}"
        raise InputError("plot('delta')", given, "a finite one over frequency")
    figure, (axes,) = style.new_figure(1, 1, width=7.6, height=3.0)
    kept = found.omega > 0
    for i, name in enumerate(found.blocks):
        label = style.plain_label(name)
        axes.plot(found.omega[kept], found.line_sizes[kept, i], lw=1.2, marker=".", ms=4, label=label)
    axes.axhline(found.upper, color=style.LIMIT, lw=1.0, ls=(0, (5, 1.5)), label=f"gamma: {found.upper:.4g}")
    style.frequency_axis(axes)
    title = style.plain_label(f"{found.record}: the Delta that explains it")
    axes.set(ylim=(0.0, 1.15 * max(found.upper, 1e-9)), ylabel="size of the block", title=title)
    style.legend_below(figure, (axes,), 5)
    return figure


@style.house_style()
def envelope_figure(found: EnvelopeCoverage, output: str | None = None) -> Figure:
    """The record in the envelope of all members; below, both minus the nominal response."""
    signal = found.signals[style.chosen(list(found.signals), output, "output")]
    figure, (above, below) = style.new_figure(2, 1, width=9.0, height=2.3, sharex=True)
    t = signal.t
    for axes, origin in ((above, 0.0), (below, signal.nominal)):
        band = signal.lower - origin, signal.upper - origin
        axes.fill_between(t, *band, color=style.BAND, alpha=0.45, lw=0, label="envelope of all members")
        axes.plot(t, signal.nominal - origin, color=style.NOMINAL, lw=1.0, label="nominal")
        axes.plot(t, signal.measured - origin, **RECORD)
    if signal.share < 1:
        k = int(abs(t - signal.miss_time).argmin())
        gap = signal.measured[k] - signal.nominal[k]
        below.plot(t[k], gap, "o", color=style.WORST, ms=5, label="largest miss")
    above.set_ylabel(style.axis_label(signal.name, signal.unit))
    below.set(ylabel=style.axis_label("minus nominal", signal.unit), xlabel="time [s]")
    style.legend_below(figure, (below,), 4)
    return figure


# --- members ----------------------------------------------------------------------------------------------------------


def band_figure(found: Responses, output: str | None = None) -> Figure:
    """All responses of one output and their envelope."""
    names = [s.name for s in found.outputs]
    k = names.index(style.chosen(names, output, "output"))
    envelope = found.lower[:, k], found.upper[:, k]
    return response_figure(found.t, found.y[:, :, k], found.nominal[:, k], envelope, output=found.outputs[k])


@style.house_style()
def member_figure(worst: WorstCase | CampaignResult) -> Figure:
    """The worst member found: each parameter in its range, from -1 over nominal to 1."""
    scalar = {name: np.ravel(value)[0] for name, value in worst.delta.items() if np.size(value) == 1}
    if not scalar:
        raise InputError("plot('delta')", "a member without scalar blocks", "a Delta with scalar values")
    ranked = sorted(scalar, key=lambda name: -abs(scalar[name]))[:SHOWN]
    figure, (axes,) = style.new_figure(width=7.2, height=1.2 + 0.27 * max(3, len(ranked)))
    for row, name in enumerate(ranked):
        size = float(abs(scalar[name])) if np.iscomplexobj(scalar[name]) else float(scalar[name])
        axes.plot([-1, 1], [row, row], color=style.BAND, lw=6, alpha=0.35, solid_capstyle="butt")
        axes.plot(size, row, "o", color=style.WORST, ms=6)
        known = worst.physical.get(name)
        text = style.plain_label(f"{known[0]:.4g} {known[1]}".rstrip() if known else f"{size:.3g}")
        axes.annotate(text, (1.08, row), va="center", fontsize=8.5, annotation_clip=False)
    axes.axvline(0.0, color=style.NOMINAL, ls=style.DASHED, lw=1.1)
    _places(axes, ranked)
    value = worst.value if isinstance(worst, WorstCase) else worst.worst
    title = style.plain_label(f"{worst.metric}: {value:.4g} {worst.unit}".rstrip())
    axes.set(xlim=(-1.05, 1.45), xlabel="place in the range: 0 nominal, -1 and 1 its ends", title=title)
    return figure


@style.house_style()
def campaign_figure(result: CampaignResult) -> Figure:
    """Share of the samples worse than each value."""
    if result.kind != "samples":
        raise InputError("plot('exceedance')", f"a campaign of {result.kind}", "one of samples", "plot('delta')")
    store = Store.open(Path(result.store))
    try:
        values, share, upper = exceedance_curve(store, result.sense, result.done, result.lost)
    finally:
        store.close()
    figure, (axes,) = style.new_figure(height=3.4)
    seen = share > 0
    if seen.any():
        axes.step(values[seen], share[seen], where="post", color=style.NOMINAL, label="share of the samples")
    axes.plot(values, upper, color=style.WORST, ls=(0, (6, 2)), label="probability, at most (95 %)")
    if len(values):
        axes.plot(values[-1], upper[-1], "o", color=style.WORST, ms=5, label="worst sample")
    if result.violation is not None:
        label = style.plain_label(f"limit {result.violation.limit:g}")
        axes.axvline(result.violation.limit, color=style.LIMIT, lw=1.3, label=label)
    axes.set(xlabel=style.axis_label(result.metric, result.unit), ylabel="probability to be worse")
    axes.legend(loc="best")
    style.logarithmic(axes.yaxis)
    return figure
