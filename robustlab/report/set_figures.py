"""Figures of sets of models: covers of models, and records beside them.

The weight over the models' errors, the cloud of parameters in its box, what each block does; a record as the smallest
Delta explains it, and in the envelope of all members (figures 11.5-11.20 of the thesis).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.identification.comparison.envelope import EnvelopeCoverage, SignalCoverage
from robustlab.identification.validation import Validation
from robustlab.identification.validation.data_cover import DataCover
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.margins.cover import Cover
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    chosen,
    frequency_axis,
    house_style,
    is_guest,
    legend_below,
    logarithmic,
    new_figure,
    plain_label,
)
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.covering.overbound import Overbound
from robustlab.uncertainty.covering.unstructured_cover import error_sizes
from robustlab.uncertainty.unstructured import Form

if TYPE_CHECKING:
    from robustlab.dynamics.extended.effect_blocks import EffectBlocks

SHOWN = 24  # parameters side by side
MODELS = 60  # errors drawn one by one
LIGHTEST = 1e-7  # share of a curve's largest value at which it leaves the picture


def cover_figures(cover: Cover, models: Sequence[StateSpaceModel]) -> dict[str, tuple[Figure, str]]:
    """``weight`` of an unstructured form, ``cloud`` of a parametric one, each with its caption."""
    if cover.fit is not None:
        text = "The weight, and below it the error of every model against the nominal one."
        return {"weight": (weight_figure(cover, models), text)}
    if not cover.model.blocks:
        return {}
    text = "Every model as a point in the box of the parameters."
    return {"cloud": (cloud_figure(cover), text)}


def weight_figure(cover: Cover, models: Sequence[StateSpaceModel] = ()) -> Figure:
    """Errors of the models, their bound, and the weight above it; below, by how much it lies above."""
    assert cover.fit is not None
    form = cast(Form, cover.form)
    errors = error_sizes(tuple(models), cover.model.nominal, form, cover.fit.omega) if models else ()
    return overbound_figure(cover.fit, errors, f"{cover.form}: weight over the errors of {len(cover.sizes)} models")


def overbound_figure(fit: Overbound, errors: Sequence[Array] | Array = (), title: str = "") -> Figure:
    """A weight above its bound, and the curves that made the bound; below, by how much it lies above."""
    figure, (above, below) = new_figure(
        2, 1, width=7.6, height=2.3, sharex=True, gridspec_kw={"height_ratios": [2.2, 1.0]}
    )
    with house_style():
        for k, row in enumerate(errors[:MODELS]):
            label = "error of a model" if k == 0 else None
            above.plot(
                fit.omega, np.maximum(row, LIGHTEST * fit.bound.max()), color=COLOURS["sample"], lw=0.8, label=label
            )
        above.plot(fit.omega, fit.bound, color=COLOURS["reference"], lw=1.0, ls=(0, (5, 1.5)), label="bound")
        above.plot(fit.omega, fit.magnitude, color=COLOURS["nominal"], label=f"weight of order {fit.order}")
        low = max(float(fit.bound.min()) / 10.0, LIGHTEST * float(fit.bound.max()))
        logarithmic(above.xaxis)
        logarithmic(above.yaxis)
        above.set_ylim(low, 2.0 * float(fit.magnitude.max()))
        above.set_ylabel("gain")
        above.set_title(plain_label(title or f"weight of order {fit.order} above a bound"))
        below.plot(fit.omega, 100.0 * (fit.magnitude / fit.bound - 1.0), color=COLOURS["nominal"])
        below.set_ylim(bottom=0.0)
        below.set_ylabel("above the\nbound [%]")
        below.set_xlabel("frequency [rad/s]")
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def cloud_figure(cover: Cover) -> Figure:
    """Left: the models over the two parameters that are least tied to each other. Right: over all parameters."""
    names = [b.name for b in cover.model.blocks]
    deltas = np.array([[float(d[name]) for name in names] for d in cover.deltas])
    wide = len(names) > 1
    figure, axes = new_figure(1, 1 + wide, width=8.2 if wide else 5.0, height=3.4)
    with house_style():
        if wide:
            _plane(axes[0], deltas, names)
        rows = axes[-1]
        shown = deltas[:, :SHOWN]
        for k in range(shown.shape[1]):
            rows.plot([-1, 1], [k, k], color=COLOURS["band"], lw=5, alpha=0.35, solid_capstyle="butt")
            rows.plot(shown[:, k], np.full(len(shown), k), "o", ms=3.5, color=COLOURS["nominal"], alpha=0.7)
        rows.set_yticks(range(shown.shape[1]), [plain_label(n)[:24] for n in names[:SHOWN]])
        rows.set_ylim(shown.shape[1] - 0.4, -0.6)
        rows.set_xlim(-1.12, 1.12)
        rows.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
        rows.set_xlabel("normalised value")
        more = f", {SHOWN} of {len(names)} shown" if len(names) > SHOWN else ""
        rows.set_title(f"{len(names)} parameter{'s' * (len(names) > 1)}{more}")
    return figure


def _plane(axes, deltas: Array, names: Sequence[str]) -> None:  # type: ignore[no-untyped-def]
    i, j = _least_tied(deltas)
    box = np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
    axes.fill(*box, color=COLOURS["band"], alpha=0.2, lw=0)
    axes.plot(*box, color=COLOURS["band"], lw=1.2, label="box of the cover")
    axes.plot(deltas[:, i], deltas[:, j], "o", ms=4, color=COLOURS["nominal"], label="models", ls="none")
    axes.set_aspect("equal")
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    axes.set_xlabel(plain_label(names[i]))
    axes.set_ylabel(plain_label(names[j]))
    axes.set_title("The two that are least tied" if len(names) > 2 else "The cloud in its box")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)


def _least_tied(deltas: Array) -> tuple[int, int]:
    """The pair of columns of least correlation among the first ones, the larger of equals first."""
    part = deltas[:, :SHOWN] - deltas[:, :SHOWN].mean(axis=0)
    size = np.linalg.norm(part, axis=0)
    tied = np.abs(part.T @ part) / np.maximum(np.outer(size, size), 1e-300)
    tied[np.tril_indices(len(tied))] = 2.0
    i, j = np.unravel_index(int(np.argmin(np.round(tied, 6))), tied.shape)
    return int(i), int(j)


def blocks_figure(made: EffectBlocks) -> Figure:
    """How far each block alone moves the response of the nominal model, of its size, over frequency.

    A real parameter at both of its ends, a dynamic block at the largest gain that it can add.
    """
    model = made.model
    if not model.blocks:
        raise InputError("EffectBlocks.plot", "a model without blocks", "one with something uncertain in it")
    q, p = model.delta_shape
    omega = default_grid(model.nominal, 240)
    m = frequency_response(model.M, omega)
    plant = slice(q + len(made.noise), None)
    nominal = m[:, p:, plant]
    size = np.linalg.norm(nominal, 2, axis=(1, 2))
    figure, (axes,) = new_figure(1, 1, width=7.6, height=3.4)
    with house_style():
        row = col = 0
        for k, block in enumerate(model.blocks):
            w, z = slice(row, row + block.rows), slice(col, col + block.cols)
            row, col = row + block.rows, col + block.cols
            m11, m12, m21 = m[:, z, w], m[:, z, plant], m[:, p:, w]
            moved = _moved(m11, m12, m21, not block.is_scalar)
            style = ("-", (0, (5, 1.5)), (0, (1, 1)))[k // 10 % 3]
            percent = np.maximum(100.0 * moved / size, 1e-12)
            axes.plot(omega, percent, label=plain_label(block.name), lw=1.4, color=f"C{k % 10}", ls=style)
        frequency_axis(axes)
        logarithmic(axes.yaxis)
        top = max(float(line.get_ydata().max()) for line in axes.lines)  # type: ignore[union-attr]
        axes.set_ylim(max(1e-3, 1e-6 * top), 2.0 * top)
        axes.set_ylabel("change of the response [%]")
        axes.set_title("What each block alone does")
        if is_guest(axes):
            legend_below(figure, (axes,))
        else:
            figure.legend(loc="outside right upper")
    return figure


def _moved(m11, m12, m21, full: bool) -> Array:  # type: ignore[no-untyped-def]
    """Largest change ``||m21 (I - Delta m11)^-1 Delta m12||`` over Delta = +-1 (a full block: its bound)."""
    if full:
        loop = np.linalg.norm(m11, 2, axis=(1, 2))
        gain = np.linalg.norm(m21, 2, axis=(1, 2)) * np.linalg.norm(m12, 2, axis=(1, 2))
        return np.where(loop < 1.0, gain / np.maximum(1.0 - loop, 1e-12), np.inf)
    eye = np.eye(m11.shape[1])
    changes = [m21 @ np.linalg.solve(eye - sign * m11, sign * m12) for sign in (-1.0, 1.0)]
    return np.max([np.linalg.norm(c, 2, axis=(1, 2)) for c in changes], axis=0)


def cover_figure(cover: Cover, models: Sequence[StateSpaceModel] = ()) -> Figure:
    """The weight of an unstructured form (over the errors of ``models``), the cloud of a parametric one."""
    if cover.fit is not None:
        return weight_figure(cover, models)
    if not cover.model.blocks:
        raise InputError("Cover.plot", "a cover without blocks", "one with something uncertain in it")
    return cloud_figure(cover)


def validation_figures(found: Validation) -> dict[str, Figure]:
    """All figures of a validation: one for each output, and ``delta`` in the frequency domain."""
    figures = {}
    for name, _ in found.outputs:
        figures[name] = record_of(found, name)
    if found.domain == "frequency" and np.isfinite(found.upper):
        figures["delta"] = delta_figure(found)
    return figures


def envelope_figures(found: EnvelopeCoverage) -> dict[str, Figure]:
    """A figure for each signal of a record in the envelope of a set."""
    return {name: envelope_figure(signal) for name, signal in found.signals.items()}


def validation_figure(found: Validation, output: str) -> Figure:
    """Recorded, nominal and explained output; below, the record minus each of the two against the noise bound."""
    k = [name for name, _ in found.outputs].index(output)
    unit = found.outputs[k][1]
    measured, nominal, explained = (a[:, k] for a in (found.measured, found.nominal, found.explained))
    figure, (above, below) = new_figure(2, 1, width=7.6, height=2.4, sharex=True)
    known = bool(np.isfinite(explained).all())
    bound = found.noise_bound[output]
    with house_style():
        above.plot(found.t, nominal, color=COLOURS["nominal"], lw=1.2, ls=(0, (5, 1.5)), label="nominal")
        above.plot(found.t, measured, color=COLOURS["measured"], lw=1.4, label="recorded")
        below.plot(found.t, measured - nominal, color=COLOURS["nominal"], lw=1.0, ls=(0, (5, 1.5)))
        if known:
            above.plot(found.t, explained, color=COLOURS["worst"], lw=1.1, label="with the smallest Delta")
            below.plot(found.t, measured - explained, color=COLOURS["worst"], lw=0.9)
        word = "noise bound" if found.noise_norm == "peak" else "rms noise bound"
        below.axhspan(-bound, bound, color=COLOURS["band"], alpha=0.35, lw=0, label=word)
        above.set_ylabel(axis_label(output, unit))
        below.set_ylabel(axis_label("record minus model", unit))
        below.set_xlabel("time in the mean period [s]" if found.domain == "frequency" else "time [s]")
        above.set_title(plain_label(f"{found.record}: {found.verdict}"))
        legend_below(figure, (above, below), 4)
    return figure


def _response_figure(found: Validation, output: str) -> Figure:
    """Magnitude of a recorded frequency response, of the nominal model, and of the explanation."""
    k = [name for name, _ in found.outputs].index(output)
    figure, (axes,) = new_figure(1, 1, width=7.6, height=3.4)
    with house_style():
        axes.plot(found.t, found.nominal[:, k], color=COLOURS["nominal"], lw=1.2, ls=(0, (5, 1.5)), label="nominal")
        axes.plot(found.t, found.measured[:, k], color=COLOURS["measured"], lw=1.4, label="record")
        if np.isfinite(found.explained).all():
            axes.plot(found.t, found.explained[:, k], color=COLOURS["worst"], lw=1.1, label="with the smallest Delta")
        frequency_axis(axes)
        logarithmic(axes.yaxis)
        axes.set_ylabel(f"|{plain_label(output)}| per input")
        axes.set_title(plain_label(f"{found.record}: {found.verdict}"))
        legend_below(figure, (axes,), 3)
    return figure


def delta_figure(found: Validation) -> Figure:
    """Size of each block over frequency, and gamma."""
    if found.domain != "frequency" or not np.isfinite(found.upper):
        raise InputError(
            "plot('delta')", f"domain {found.domain}, gamma {found.upper:.4g}", "a finite one over frequency"
        )
    figure, (axes,) = new_figure(1, 1, width=7.6, height=3.0)
    kept = found.omega > 0
    with house_style():
        for i, name in enumerate(found.blocks):
            axes.plot(found.omega[kept], found.line_sizes[kept, i], lw=1.2, marker=".", ms=4, label=plain_label(name))
        axes.axhline(found.upper, color=COLOURS["limit"], lw=1.0, ls=(0, (5, 1.5)), label=f"gamma: {found.upper:.4g}")
        frequency_axis(axes)
        axes.set_ylim(0.0, 1.15 * max(found.upper, 1e-9))
        axes.set_ylabel("size of the block")
        axes.set_title(plain_label(f"{found.record}: the Delta that explains it"))
        legend_below(figure, (axes,), 5)
    return figure


def envelope_figure(signal: SignalCoverage) -> Figure:
    """The measured signal with nominal response and envelope; below, both minus the nominal response."""
    figure, (above, below) = new_figure(2, 1, width=9.0, height=2.3, sharex=True)
    t, outside = signal.t, signal.share < 1
    with house_style():
        for axes, origin in ((above, 0.0), (below, signal.nominal)):
            lower, upper = signal.lower - origin, signal.upper - origin
            axes.fill_between(t, lower, upper, color=COLOURS["band"], alpha=0.45, lw=0, label="envelope of all members")
            axes.plot(t, signal.nominal - origin, color=COLOURS["nominal"], lw=1.0, label="nominal")
            axes.plot(t, signal.measured - origin, color=COLOURS["measured"], lw=1.2, label="record")
        if outside:
            k = int(abs(t - signal.miss_time).argmin())
            gap = signal.measured[k] - signal.nominal[k]
            below.plot(t[k], gap, "o", color=COLOURS["worst"], ms=5, label="largest miss")
        above.set_ylabel(axis_label(signal.name, signal.unit))
        below.set_ylabel(axis_label("minus nominal", signal.unit))
        below.set_xlabel("time [s]")
        legend_below(figure, (below,), 4)
    return figure


# --- single drawings --------------------------------------------------------------------------------------------------


def record_of(found: Validation, output: str | None = None) -> Figure:
    """One output of the record beside the nominal model and the explanation."""
    name = chosen([name for name, _ in found.outputs], output, "output")
    measured_response = found.domain == "frequency" and found.noise_norm == "peak"
    return _response_figure(found, name) if measured_response else validation_figure(found, name)


def cover_record(found: DataCover, record: str | None = None, output: str | None = None) -> Figure:
    """How a set explains one of its records."""
    return record_of(found.validations[chosen(list(found.validations), record, "record")], output)
