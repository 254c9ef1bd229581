"""Figures of sets of models and of their members: covers, records, responses, worst members, campaigns.

The weight over the models' errors, the parameters in their box; a record as explained by the smallest Delta, and in
the envelope of all members (figures 11.5-11.20 of the thesis).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.campaign.runs import CampaignResult
from robustlab.errors import InputError
from robustlab.identification.comparison.envelope import EnvelopeCoverage
from robustlab.identification.validation import Validation
from robustlab.identification.validation.model_validation import DataCover
from robustlab.mu_analysis.margins.cover import Cover
from robustlab.report import style
from robustlab.report.robustness_figures import response_figure
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.covers import Overbound, error_sizes
from robustlab.uncertainty.unstructured import Form
from robustlab.worst_case_analysis.sampling import Responses
from robustlab.worst_case_analysis.worst_case_search import WorstCase

SHOWN = 24  # parameters side by side
MODELS = 60  # errors drawn one by one
LIGHTEST = 1e-7  # smallest value drawn, relative to the largest
NOMINAL: dict[str, Any] = {"color": style.NOMINAL, "lw": 1.2, "ls": (0, (5, 1.5)), "label": "nominal"}
RECORD: dict[str, Any] = {"color": style.MEASURED, "lw": 1.4, "label": "record"}
EXPLAINED: dict[str, Any] = {"color": style.WORST, "lw": 1.1, "label": "with the smallest Delta"}


# --- covers -----------------------------------------------------------------------------------------------------------


def cover_figure(cover: Cover, models: Sequence[StateSpaceModel] = ()) -> Figure:
    """The weight of an unstructured form (over the errors of ``models``), the cloud of a parametric one."""
    if cover.fit is not None:
        return weight_figure(cover, models or cover.models)
    if not cover.model.blocks:
        raise InputError("Cover.plot", "a cover without blocks", "one with something uncertain in it")
    return cloud_figure(cover)


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
    figure, axes = _in_ranges({n: [float(d[n]) for d in cover.deltas] for n in names[:SHOWN]}, style.NOMINAL)
    more = f", {SHOWN} of {len(names)} shown" if len(names) > SHOWN else ""
    title = f"{len(names)} parameter{'s' * (len(names) > 1)}{more}"
    axes.set(xlim=(-1.12, 1.12), xlabel="normalised value", title=title)
    return figure


def _in_ranges(points: Mapping[str, Sequence[float]], colour: str) -> tuple[Figure, Axes]:
    """Draw points of each parameter in its range from -1 to 1, a row each."""
    figure, (axes,) = style.new_figure(height=1.2 + 0.27 * max(3, len(points)))
    for row, values in enumerate(points.values()):
        axes.plot([-1, 1], [row, row], color=style.BAND, lw=5, alpha=0.35, solid_capstyle="butt")
        axes.plot(values, np.full(len(values), row), "o", ms=4, color=colour, alpha=0.7)
    axes.set_yticks(range(len(points)), [style.plain_label(name[:40]) for name in points])
    axes.set(ylim=(len(points) - 0.4, -0.6), xticks=[-1, -0.5, 0, 0.5, 1])
    axes.grid(visible=False, axis="y")
    return figure, axes


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
    places = {n: float(abs(scalar[n])) if np.iscomplexobj(scalar[n]) else float(scalar[n]) for n in ranked}
    figure, axes = _in_ranges({name: [place] for name, place in places.items()}, style.WORST)
    for row, (name, place) in enumerate(places.items()):
        known = worst.physical.get(name)
        text = style.plain_label(f"{known[0]:.4g} {known[1]}".rstrip() if known else f"{place:.3g}")
        axes.annotate(text, (1.08, row), va="center", fontsize=8.5, annotation_clip=False)
    axes.axvline(0.0, color=style.NOMINAL, ls=style.DASHED, lw=1.1)
    value = worst.value if isinstance(worst, WorstCase) else worst.worst
    title = style.plain_label(f"{worst.metric}: {value:.4g} {worst.unit}".rstrip())
    axes.set(xlim=(-1.05, 1.45), xlabel="place in the range: 0 nominal, -1 and 1 its ends", title=title)
    return figure
