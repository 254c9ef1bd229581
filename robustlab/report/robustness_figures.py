"""Figures of sets of models: robustness analysis, members and samples, covers, records in a set.

Bounds over frequency, sensitivities of the blocks, critical and worst responses, the distribution of a metric and its
relevant parameters; covers over the errors of models; a record as explained by the smallest Delta, and in the envelope
of all members. The figures correspond to 10.2, 10.3 and 11.5-11.20 of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array, Mask
from robustlab.errors import InputError
from robustlab.mu_analysis.margins.disk_margin import DiskBounds, DiskMargins
from robustlab.norms import PeakGain
from robustlab.report import style
from robustlab.uncertainty.covers import Overbound, error_sizes
from robustlab.worst_case_analysis.worst_case_search import WorstCase

if TYPE_CHECKING:
    from robustlab.campaign.runs import CampaignResult
    from robustlab.identification.comparison.envelope import EnvelopeCoverage
    from robustlab.identification.validation import Validation
    from robustlab.identification.validation.model_validation import DataCover
    from robustlab.mu_analysis.axis.margin import CriticalResponse, Margin, WorstCaseGain
    from robustlab.mu_analysis.margins.at_frequencies import DiskMarginAt, GainAt, MarginAt
    from robustlab.mu_analysis.margins.uncertainty_cover import Cover
    from robustlab.statespace import StateSpaceModel
    from robustlab.uncertainty.unstructured import Form
    from robustlab.worst_case_analysis.sampling import Responses
    from robustlab.worst_case_analysis.statistics import Influence, ViolationProbability

Interval = tuple[float, float, float]
PROVED = "#d6ecf8"  # opaque: the intervals overlap
SHOWN_BLOCKS, SHOWN, SHOWN_PARAMETERS = 16, 12, 24
MAX_CURVES = 60  # sample curves; more make the file large and show nothing beyond the envelope
SETTLED = 0.8  # share of the time at which the zoomed panel begins
BINS = 40
LARGEST_GAIN = 60  # dB; of a disk margin's curve
MODELS = 60  # errors drawn one by one
LIGHTEST = 1e-7  # smallest value drawn, relative to the largest
NOMINAL: dict[str, Any] = {"color": style.NOMINAL, "lw": 1.2, "ls": (0, (5, 1.5)), "label": "nominal"}
RECORD: dict[str, Any] = {"color": style.MEASURED, "lw": 1.4, "label": "record"}
EXPLAINED: dict[str, Any] = {"color": style.WORST, "lw": 1.1, "label": "with the smallest Delta"}


@style.house_style()
def mu_figure(margin: Margin) -> Figure:
    """Bounds of μ over frequency. The proved margin is the inverse of the highest shaded level."""
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=3.6)
    omega, lower, upper = margin.omega, margin.mu_lower, margin.mu_upper
    shown = _frame(axes, omega, margin.intervals)
    if shown.any():
        axes.plot(omega[shown], upper[shown], color=style.NOMINAL, label="upper bound (proved by D, G)")
    found = shown & (lower > 0)
    if found.any():
        points = "lower bound (attained by an explicit Δ)"
        axes.plot(omega[found], lower[found], ".", color=style.WORST, ms=4, label=points)
    peak = 1 / margin.upper if margin.upper > 0 else 0.0
    level = 1 / margin.lower if margin.lower > 0 else float("inf")
    if peak > 0:
        _mark(axes, margin.frequency, peak, "peak of μ, attained")
    if np.isfinite(level) and level > 0:
        axes.axhline(level, color=style.GOOD, lw=1.1, label=f"{level:.4g}: proved on the whole axis")
        if any("as wide below as above" in note for note in margin.notes):
            axes.set_title("curves: ranges as wide below as above; proved: as they are")
    axes.axhline(1.0, color=style.MEASURED, ls=style.DASHED, lw=1.1, label="1: robust stability limit")
    tall = [1.0, peak, level, float(np.nanmax(upper[shown], initial=0.0))]
    axes.set(ylim=(0, 1.12 * max(v for v in tall if np.isfinite(v))), ylabel="structured singular value μ")
    return style.legend_below(figure, (axes,), 2)


def _mark(axes: Axes, frequency: float | None, value: float, label: str) -> None:
    """Draw a point at a frequency inside the axis."""
    low, high = axes.get_xlim()
    if frequency is not None and low <= frequency <= high and np.isfinite(value):
        axes.plot(frequency, value, "o", color=style.WORST, ms=6, label=label)


@style.house_style()
def bounds_at(found: MarginAt | GainAt | DiskMarginAt) -> Figure:
    """Both bounds at given frequencies; between the points nothing is known."""
    gain = isinstance(found, PeakGain)
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=3.6)
    omega, columns = np.asarray(found.table().index[1]), found.table().columns
    words = ("attained by an explicit Δ", "proved") if gain else ("proved", "attained by an explicit Δ")
    shown = omega > 0
    for name, word, mark, colour in zip(("lower", "upper"), words, "^v", (style.NOMINAL, style.WORST), strict=True):
        bound = np.asarray(columns[name])
        finite = shown & np.isfinite(bound)
        axes.plot(omega[finite], bound[finite], mark, color=colour, ms=4, ls="none", label=word)
    style.frequency_axis(axes, (omega[shown][0], omega[-1]) if shown.sum() > 1 else None)
    margin = "disk margin" if isinstance(found, DiskBounds) else "stability margin"
    axes.set_ylabel("worst-case gain" if gain else margin)
    axes.set_ylim(bottom=0)
    return style.legend_below(figure, (axes,), 2)


@style.house_style()
def gain_figure(worst: WorstCaseGain) -> Figure:
    """Nominal gain, largest gain found and its bound over frequency, and the bound proved on intervals."""
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=3.6)
    shown = _frame(axes, worst.omega, worst.intervals)
    omega, upper = worst.omega[shown], worst.gain_upper[shown]
    axes.plot(omega, upper, color=style.NOMINAL, label="bound (proved by D, G)")
    axes.plot(omega, worst.gain_lower[shown], ".", color=style.WORST, ms=4, label="largest gain found")
    axes.plot(omega, worst.nominal_gain[shown], color=style.MEASURED, lw=1.0, label="nominal gain")
    _mark(axes, worst.frequency, worst.lower, "worst gain, attained")
    tall = [worst.lower, worst.upper, float(np.nanmax(upper, initial=0.0))]
    top = 1.12 * max([v for v in tall if np.isfinite(v)] or [1.0])
    axes.set(ylim=(0, top), ylabel="largest singular value")
    return style.legend_below(figure, (axes,), 2)


def _frame(axes: Axes, omega: Array, intervals: Sequence[Interval]) -> Mask:
    """Shade the proved intervals and set the frequency axis; return a mask of the frequencies on it.

    Without curves the axis covers the ends of the intervals, a decade further for unbounded ones.
    """
    shown = np.isfinite(omega) & (omega > 0)
    ends = [edge for start, stop, _ in intervals for edge in (start, stop)]
    inner = [edge for edge in ends if 0 < edge < np.inf] or [1.0]
    edges = [min(inner) / 10, max(inner) * (10 if np.inf in ends or len(inner) < 2 else 1)]
    seen = omega[shown] if shown.any() else np.array(edges)
    low, high = float(seen.min()), float(seen.max())
    label: str | None = "proved for every frequency between"
    for start, stop, bound in intervals:
        edges = [max(start, low), min(stop, high)]
        if edges[0] < edges[1] and np.isfinite(bound):
            axes.fill_between(edges, 0, bound, color=PROVED, lw=0, label=label)
            label = None
    style.frequency_axis(axes, (low, high))
    return shown


@style.house_style()
def margin_shares(margin: Margin) -> Figure:
    """Sensitivity of the margin to the range of each block, the largest first."""
    if not margin.shares:
        raise InputError("plot('shares')", "a margin without shares of its blocks", "one at a simple critical pole")
    ranked = sorted(margin.shares.items(), key=lambda pair: -abs(pair[1]))[:SHOWN_BLOCKS]
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=0.8 + 0.26 * len(ranked))
    values = [value for _, value in ranked]
    colours = [style.NOMINAL if v >= 0 else style.SAMPLE for v in values]
    axes.barh(range(len(ranked)), values, color=colours, height=0.7)
    axes.set_yticks(range(len(ranked)), [style.plain_label(name[:40]) for name, _ in ranked])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.axvline(0.0, color=style.MEASURED, lw=0.8)
    axes.set_xlabel("gain of the margin in % if the range is 1 % smaller")
    return figure


@style.house_style()
def replay_figure(replay: CriticalResponse, shown: int = 4) -> Figure:
    """Free responses of the nominal model, just inside the margin, and at the critical Delta."""
    columns = np.argsort(-np.abs(replay.critical).max(axis=0), kind="stable")[:shown]
    figure, panels = style.new_figure(len(columns), 1, width=8.0, height=2.2, sharex=True)
    for axes, k in zip(panels, columns, strict=True):
        axes.plot(replay.t, replay.critical[:, k], color=style.WORST, lw=1.1, label="at the critical Δ")
        axes.plot(replay.t, replay.inside[:, k], color=style.BAND, lw=1.1, label="at 0.95 of it")
        axes.plot(replay.t, replay.nominal[:, k], color=style.MEASURED, lw=1.1, label="nominal")
        axes.set_ylabel(style.axis_label(replay.outputs[k].name, replay.outputs[k].unit))
    panels[-1].set_xlabel("time [s]")
    return style.legend_below(figure, panels[:1], 3)


@style.house_style()
def disk_figure(found: DiskMargins | DiskBounds) -> Figure:
    """Changes of gain and phase that keep the loop stable (inside each curve), of each loop and of all at once."""
    every: Mapping[str, DiskBounds] = {"disk margin": found}
    if isinstance(found, DiskMargins):
        every = {"all at once": found.simultaneous, **found.channels}
    figure, (axes,) = style.new_figure(width=6.4, height=3.8)
    for k, (name, margin) in enumerate(every.items()):
        colour, label = style.CURVES[k % len(style.CURVES)], style.plain_label(f"{name}: {margin.lower:.4g}")
        if not 0 < margin.lower < np.inf:
            axes.plot([], [], color=colour, label=label)
            continue
        turn = margin.lower * np.exp(1j * np.linspace(-np.pi, np.pi, 14401))
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = (1 + (1 - margin.skew) / 2 * turn) / (1 - (1 + margin.skew) / 2 * turn)
            gain, phase = 20 * np.log10(np.abs(factor)), np.degrees(np.unwrap(np.angle(factor)))
        phase -= np.mean(phase)
        axes.plot(gain, phase, color=colour, lw=2.4 if k == 0 else 1.4, label=label)
        if k == 0:
            axes.fill(gain, phase, color=style.BAND, alpha=0.25, lw=0)
    wide = any(np.abs(np.asarray(line.get_xdata())).max(initial=0.0) > LARGEST_GAIN for line in axes.lines)
    if wide:  # near a margin of 2 the curve is unbounded
        axes.set_xlim(-LARGEST_GAIN, LARGEST_GAIN)
    axes.plot(0.0, 0.0, "+", color=style.MEASURED, ms=9, mew=1.4)
    axes.set_xlabel(f"change of gain [dB]{f', shown to {LARGEST_GAIN} dB' * wide}")
    axes.set(ylabel="change of phase [degrees]", title="stable for every change inside of the curve")
    return style.legend_below(figure, (axes,), 3)


@style.house_style()
def response_figure(
    t: Array,
    samples: Array,
    nominal: Array,
    envelope: tuple[Array, Array],
    *,
    output: tuple[str, str],
    references: Sequence[tuple[float, str]] = (),
) -> Figure:
    """All responses of one output: the whole time on the left, the end of it enlarged on the right."""
    figure, (whole, zoom) = style.new_figure(1, 2, width=9.6, height=3.6)
    for axes in (whole, zoom):
        axes.fill_between(t, *envelope, color=style.BAND, alpha=0.25, lw=0, label="envelope of all members")
        for i, curve in enumerate(samples[:MAX_CURVES]):
            axes.plot(t, curve, color=style.SAMPLE, lw=0.6, alpha=0.8, label="members" if i == 0 else None)
        axes.plot(t, nominal, color=style.NOMINAL, label="nominal")
        for value, text in references:
            axes.axhline(value, color=style.WORST, ls=style.DASHED, lw=1.3, label=style.plain_label(text))
        axes.set_xlabel("time [s]")
    whole.set(ylabel=style.axis_label(*output), title="whole response")
    last = t >= t[0] + SETTLED * (t[-1] - t[0])
    zoom.set(title="enlarged: the end of the response", xlim=(t[last][0], t[-1]))
    seen = np.concatenate([*(curve[last] for curve in envelope), [value for value, _ in references]])
    zoom.set_ylim(*_span(seen, 0.12))
    # Not `legend_below`: two reference lines may have the same name.
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _span(values: Array, share: float) -> tuple[float, float]:
    """Return limits of an axis: all finite values with a margin, which is positive for equal values."""
    seen = values[np.isfinite(values)]
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
    margin = share * (high - low) or 0.05 * max(abs(high), 1e-12)
    return low - margin, high + margin


@style.house_style()
def worst_case_figure(found: WorstCase) -> Figure:
    """Nominal and worst response of the judged output, and their difference below."""
    response = found.response
    if response is None:
        raise InputError("plot('response')", f"no response: {found.metric}", "a metric of a response")
    t, change = response.t, response.worst - response.nominal
    figure, (above, below) = style.new_figure(2, 1, width=7.6, height=2.2, sharex=True)
    above.plot(t, response.nominal, color=style.NOMINAL, label="nominal")
    above.plot(t, response.worst, color=style.WORST, ls=(0, (6, 2)), label="worst member found")
    above.set_ylabel(style.axis_label(response.output, response.unit))
    above.legend(loc="best")
    below.plot(t, change, color=style.WORST)
    style.zero_line(below)
    peak = int(np.argmax(np.abs(change)))
    below.plot(t[peak], change[peak], "o", color=style.WORST, ms=5)
    below.set(ylabel=style.axis_label("deviation", response.unit), xlabel="time [s]")
    return figure


@style.house_style()
def distribution_figure(found: ViolationProbability) -> Figure:
    """Histogram of the metric over the samples, with the limit; violations in the colour of the worst."""
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=3.6)
    values = found.values[np.isfinite(found.values)]
    edges = np.linspace(*_span(np.append(values, found.limit), 0.04), BINS + 1)
    # The limit is an edge, so that no bar is of two kinds.
    edges[np.argmin(np.abs(edges - found.limit))] = found.limit
    beyond = found.sense * values > found.sense * found.limit
    violating = f"violates it: {found.violations} of {found.n}"
    for some, colour, label in ((~beyond, style.NOMINAL, "within the limit"), (beyond, style.WORST, violating)):
        axes.hist(values[some], edges.tolist(), color=colour, alpha=0.85, label=label)
    limit = f"limit {found.limit:.4g} {found.unit}".rstrip()
    axes.axvline(found.limit, color=style.MEASURED, ls=style.DASHED, lw=1.3, label=style.plain_label(limit))
    text = f"P(violation) between {found.lower:.3g} and {found.upper:.3g}"
    title = f"{text} at {100 * found.confidence:g} % confidence"
    axes.set(xlabel=style.axis_label(found.metric, found.unit), ylabel="samples", title=title)
    return style.legend_below(figure, (axes,), 3)


def violation_influence(found: ViolationProbability) -> Figure:
    """Relevant parameters of a limited metric."""
    if found.influence is None:
        raise InputError("plot('influence')", "no influences", "32 samples at least, and real scalar blocks")
    return influence_figure(found.influence, found.metric)


@style.house_style()
def influence_figure(found: Influence, metric: str) -> Figure:
    """Relevant parameters: their shares of the spread, and the gain of each alone at the worst sample.

    Left: share of the variance that each parameter explains by itself; a bar that ends in the grey zone may be chance.
    Right: the metric at the worst sample (line), and with that one parameter at its nominal value (dot).
    """
    order = tuple(k for k in found.order if found.matters[k])[:SHOWN] or found.order[:1]
    figure, (shares, saved) = style.new_figure(1, 2, width=10.4, height=1.4 + 0.3 * max(3, len(order)), sharey=True)
    for direction, colour, label in (
        (1, style.WORST, f"{metric} grows with it"),
        (-1, style.NOMINAL, f"{metric} falls with it"),
        (0, style.SAMPLE, "no clear direction"),
    ):
        some = [row for row, k in enumerate(order) if found.directions[k] == direction]
        if some:
            widths = [100 * found.first_order[order[row]] for row in some]
            shares.barh(some, widths, color=colour, label=style.plain_label(label))
    shares.axvspan(0, 100 * found.noise, color=style.SAMPLE, alpha=0.25, lw=0, label="may be chance")
    shares.set_yticks(range(len(order)), [style.plain_label(found.names[k]) for k in order])
    shares.invert_yaxis()
    rest = len(found.names) - len(order)
    shares.set(
        xlim=(0, max(108 * float(found.first_order.max(initial=0.0)), 200 * found.noise, 1.0)),
        xlabel="share of the spread [%]",
        title="which parameters matter" + (f" ({rest} more do not, or less)" if rest else ""),
    )
    if np.isfinite(found.worst_value):
        restored = np.where(np.isfinite(found.restored), found.restored, found.worst_value)
        saved.axvline(found.worst_value, color=style.WORST, lw=1.4, label="worst sample")
        saved.axvline(found.nominal_value, color=style.NOMINAL, lw=1.4, ls=style.DASHED, label="nominal")
        for row, k in enumerate(order):
            saved.plot([found.worst_value, restored[k]], [row, row], color="#444444", lw=1.2)
            label = "that parameter nominal" if row == 0 else None
            saved.plot(restored[k], row, "o", color="#444444", ms=5, label=label)
    else:
        saved.text(0.5, 0.5, "the worst sample has no bounded value", ha="center", transform=saved.transAxes)
        saved.grid(visible=False)
    saved.set(xlabel=style.axis_label(metric, found.unit), title="the worst sample, one parameter nominal")
    return style.legend_below(figure, (shares, saved), 3)


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
    form = cast("Form", cover.form)
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
    return style.legend_below(figure, (above,), 3)


@style.house_style()
def cloud_figure(cover: Cover) -> Figure:
    """Every model as a point in the range of each parameter."""
    names = [b.name for b in cover.model.blocks]
    figure, axes = _in_ranges({n: [float(d[n]) for d in cover.deltas] for n in names[:SHOWN_PARAMETERS]}, style.NOMINAL)
    more = f", {SHOWN_PARAMETERS} of {len(names)} shown" if len(names) > SHOWN_PARAMETERS else ""
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
    return style.legend_below(figure, panels, 4)


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
    return style.legend_below(figure, (below,), 4)


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
    ranked = sorted(scalar, key=lambda name: -abs(scalar[name]))[:SHOWN_PARAMETERS]
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
