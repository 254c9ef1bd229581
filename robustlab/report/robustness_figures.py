"""Figures of robustness analysis, proved and sampled.

Bounds over frequency with what is proved, shares of the blocks, replay in time; members' responses, the worst one, how
a metric is distributed, what matters for it. The responses are those of figures 10.2 and 10.3 of the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.norms import PeakGain
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    frequency_axis,
    house_style,
    legend_below,
    new_figure,
    plain_label,
    zero_line,
)
from robustlab.worst_case_analysis.statistics import Influence, ViolationProbability

if TYPE_CHECKING:
    from robustlab.mu_analysis import Margin, WorstCaseGain
    from robustlab.mu_analysis.axis.critical_delta import CriticalResponse
    from robustlab.mu_analysis.margins.at_frequencies import DiskMarginsAt, GainAt, MarginAt
    from robustlab.worst_case_analysis.worst_case_search import WorstCase

Interval = tuple[float, float, float]
PROVED = "#d6ecf8"  # opaque: the intervals overlap
SHOWN_BLOCKS = 16


def mu_figure(margin: Margin) -> Figure:
    """Bounds of mu at the frequencies of the margin, and what is proved between them."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    omega, lower, upper = _with_points_of_the_peak(margin)
    with house_style():
        shown = _frame(axes, omega, margin.intervals)
        if shown.any():
            axes.plot(omega[shown], upper[shown], color=COLOURS["nominal"], label="upper bound (proved by D, G)")
        found = shown & (lower > 0)
        if found.any():
            points = "lower bound (attained by an explicit Δ)"
            axes.plot(omega[found], lower[found], ".", color=COLOURS["worst"], ms=4, label=points)
        peak = 1 / margin.upper if margin.upper > 0 else 0.0
        low, high = axes.get_xlim()
        if margin.frequency is not None and low <= margin.frequency <= high and peak > 0:
            axes.plot(margin.frequency, peak, "o", color=COLOURS["worst"], ms=6, label="peak of μ, attained")
        level = 1 / margin.lower if margin.lower > 0 else float("inf")
        if np.isfinite(level) and level > 0:
            text = f"{level:.4g}: proved on the whole axis"
            axes.axhline(level, color=COLOURS["good"], lw=1.1, label=text)
            if any("as wide below as above" in note for note in margin.notes):
                axes.set_title("curves: ranges as wide below as above; proved: as they are")
        axes.axhline(1.0, color=COLOURS["reference"], ls=(0, (5, 2)), lw=1.1, label="1: robust stability limit")
        tall = [1.0, peak, level, float(np.nanmax(upper[shown], initial=0.0))]
        axes.set_ylim(0, 1.12 * max(v for v in tall if np.isfinite(v)))
        axes.set_ylabel("structured singular value μ")
        legend_below(figure, (axes,), 2)
    return figure


def _with_points_of_the_peak(margin: Margin) -> tuple[Array, Array, Array]:
    """Frequencies and bounds of mu of the margin, and some more around its peak, which may lie between two of them."""
    omega, lower, upper = margin.omega, margin.mu_lower, margin.mu_upper
    peak, system = margin.frequency, margin.system
    if not len(omega) or system is None or peak is None or not 0 < peak < np.inf:
        return omega, lower, upper
    added = peak * np.exp(np.append(0.0, np.outer([1, -1], np.geomspace(1e-3, 0.3, 9))))
    if system.dt:
        added = added[added < np.pi / system.dt]
    try:
        found = mu(frequency_response(system.delta_channels, added), system.blocks)
    except InputError:  # ranges wider on one side
        return omega, lower, upper
    order = np.argsort(np.append(omega, added))
    bounds = ((omega, added), (lower, found.lower), (upper, found.upper))
    first, second, third = (np.concatenate([np.atleast_1d(part) for part in both])[order] for both in bounds)
    return first, second, third


def bounds_at(found: MarginAt | GainAt | DiskMarginsAt) -> Figure:
    """Both bounds at given frequencies, of all loops at once: points, for nothing is known between them."""
    whole: Any = getattr(found, "simultaneous", found)
    gain = isinstance(found, PeakGain)
    label = "worst-case gain" if gain else "stability margin" if whole is found else "disk margin, all loops at once"
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    omega, columns = np.asarray(whole.table().index[1]), whole.table().columns
    words = ("attained by an explicit Δ", "proved") if gain else ("proved", "attained by an explicit Δ")
    bounds = tuple(np.asarray(columns[name]) for name in ("lower", "upper"))
    with house_style():
        shown = omega > 0
        for bound, word, mark, colour in zip(bounds, words, "^v", (COLOURS["nominal"], COLOURS["worst"]), strict=True):
            finite = shown & np.isfinite(bound)
            axes.plot(omega[finite], bound[finite], mark, color=colour, ms=4, ls="none", label=word)
        frequency_axis(axes, (omega[shown][0], omega[-1]) if shown.sum() > 1 else None)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        legend_below(figure, (axes,), 2)
    return figure


def gain_figure(worst: WorstCaseGain) -> Figure:
    """Nominal gain, largest gain found and its bound over frequency, and what is proved between them."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    omega = worst.omega
    with house_style():
        shown = _frame(axes, omega, worst.intervals)
        axes.plot(omega[shown], worst.gain_upper[shown], color=COLOURS["nominal"], label="bound (proved by D, G)")
        axes.plot(omega[shown], worst.gain_lower[shown], ".", color=COLOURS["worst"], ms=4, label="largest gain found")
        axes.plot(omega[shown], worst.nominal_gain[shown], color=COLOURS["reference"], lw=1.0, label="nominal gain")
        low, high = axes.get_xlim()
        if worst.frequency is not None and low <= worst.frequency <= high and np.isfinite(worst.lower):
            axes.plot(worst.frequency, worst.lower, "o", color=COLOURS["worst"], ms=6, label="worst gain, attained")
        tall = [worst.lower, worst.upper, float(np.nanmax(worst.gain_upper[shown], initial=0.0))]
        axes.set_ylim(0, 1.12 * max([v for v in tall if np.isfinite(v)] or [1.0]))
        axes.set_ylabel("largest singular value")
        legend_below(figure, (axes,), 2)
    return figure


def _frame(axes: Axes, omega: Array, intervals: Sequence[Interval]) -> NDArray[np.bool_]:
    """Shade the proved intervals, set the frequency axis; which frequencies can be shown on it."""
    shown = np.isfinite(omega) & (omega > 0)
    seen = omega[shown] if shown.any() else _edges(intervals)
    low, high = float(seen.min()), float(seen.max())
    label: str | None = "proved for every frequency between"
    for start, stop, bound in intervals:
        edges = [max(start, low), min(stop, high)]
        if edges[0] < edges[1] and np.isfinite(bound):
            axes.fill_between(edges, 0, bound, color=PROVED, lw=0, label=label)
            label = None
    frequency_axis(axes, (low, high))
    return shown


def _edges(intervals: Sequence[Interval]) -> Array:
    """The frame of a picture without curves: the ends of the proved intervals, a decade further where they go on."""
    ends = [edge for start, stop, _ in intervals for edge in (start, stop)]
    inner = [edge for edge in ends if 0 < edge < np.inf]
    if not inner:
        return np.array([0.1, 10.0])
    return np.array([min(inner) / 10, max(inner) * (10 if np.inf in ends else 1)])


def margin_shares(margin: Margin) -> Figure:
    """Share of each block in the margin, the largest on top: which range to tighten first."""
    if not margin.shares:
        raise InputError("plot('shares')", "a margin without shares of its blocks", "one at a simple critical pole")
    ranked = sorted(margin.shares.items(), key=lambda pair: -abs(pair[1]))[:SHOWN_BLOCKS]
    figure, (axes,) = new_figure(1, 1, width=8.0, height=0.8 + 0.26 * max(len(ranked), 1))
    with house_style():
        names = [plain_label(name if len(name) <= 40 else name[:39] + "…") for name, _ in ranked]
        values = [value for _, value in ranked]
        colours = [COLOURS["nominal"] if v >= 0 else COLOURS["sample"] for v in values]
        axes.barh(range(len(ranked)), values, color=colours, height=0.7)
        axes.set_yticks(range(len(ranked)), names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.axvline(0.0, color=COLOURS["reference"], lw=0.8)
        axes.set_xlabel("percent of margin gained per percent of range taken off")
    return figure


def replay_figure(replay: CriticalResponse, shown: int = 4) -> Figure:
    """Free responses of the nominal model, just inside the margin, and at the critical Delta."""
    size = np.abs(replay.critical).max(axis=0)
    columns = np.argsort(-size, kind="stable")[:shown]
    figure, panels = new_figure(len(columns), 1, width=8.0, height=2.2, sharex=True)
    with house_style():
        for axes, k in zip(panels, columns, strict=True):
            axes.plot(replay.t, replay.critical[:, k], color=COLOURS["worst"], lw=1.1, label="at the critical Δ")
            axes.plot(replay.t, replay.inside[:, k], color=COLOURS["band"], lw=1.1, label="at 0.95 of it")
            axes.plot(replay.t, replay.nominal[:, k], color=COLOURS["reference"], lw=1.1, label="nominal")
            axes.set_ylabel(axis_label(replay.outputs[k].name, replay.outputs[k].unit))
        panels[-1].set_xlabel("time [s]")
        legend_below(figure, panels[:1], 3)
    return figure


MAX_CURVES = 60  # more sample curves than this make the file large and show nothing more than the envelope
SETTLED = 0.8  # the zoomed panel shows the last part of the response
SHOWN = 12
BINS = 40


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
    figure, (whole, zoom) = new_figure(1, 2, width=9.6, height=3.6)
    with house_style():
        for axes in (whole, zoom):
            axes.fill_between(t, *envelope, color=COLOURS["band"], alpha=0.25, lw=0, label="envelope of all members")
            for i, curve in enumerate(samples[:MAX_CURVES]):
                axes.plot(t, curve, color=COLOURS["sample"], lw=0.6, alpha=0.8, label="members" if i == 0 else None)
            axes.plot(t, nominal, color=COLOURS["nominal"], label="nominal")
            for value, text in references:
                axes.axhline(value, color=COLOURS["worst"], ls=(0, (5, 2)), lw=1.3, label=plain_label(text))
            axes.set_xlabel("time [s]")
        whole.set_ylabel(axis_label(*output))
        whole.set_title("whole response")
        zoom.set_title("enlarged: the end of the response")
        _enlarge(zoom, t, envelope, [value for value, _ in references])
        # Not `legend_below`: two reference lines may be called the same.
        figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def worst_case_figure(found: WorstCase) -> Figure:
    """Nominal and worst response of the output that is judged, and their difference below."""
    if found.response is None:
        raise InputError("plot('response')", f"no response: {found.metric}", "a metric of a response")
    t, nominal, worst = found.response.t, found.response.nominal, found.response.worst
    output = (found.response.output, found.response.unit)
    figure, (above, below) = new_figure(2, 1, width=7.6, height=2.2, sharex=True)
    with house_style():
        above.plot(t, nominal, color=COLOURS["nominal"], label="nominal")
        above.plot(t, worst, color=COLOURS["worst"], ls=(0, (6, 2)), label="worst member found")
        above.set_ylabel(axis_label(*output))
        above.legend(loc="best")
        below.plot(t, worst - nominal, color=COLOURS["worst"])
        zero_line(below)
        peak = int(np.argmax(np.abs(worst - nominal)))
        below.plot(t[peak], (worst - nominal)[peak], "o", color=COLOURS["worst"], ms=5)
        below.set_ylabel(axis_label("deviation", output[1]))
        below.set_xlabel("time [s]")
    return figure


def _enlarge(axes: Axes, t: Array, curves: Sequence[Array], values: Sequence[float]) -> None:
    last = t >= t[0] + SETTLED * (t[-1] - t[0])
    seen = np.concatenate([*(curve[last] for curve in curves), np.asarray(values, dtype=float)])
    seen = seen[np.isfinite(seen)]
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
    margin = 0.12 * (high - low) or 0.05 * max(abs(high), 1e-12)
    axes.set_xlim(t[last][0], t[-1])
    axes.set_ylim(low - margin, high + margin)


def distribution_figure(found: ViolationProbability) -> Figure:
    """Histogram of the metric over the samples, with the limit; what violates it is in the colour of the worst."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    values = found.values[np.isfinite(found.values)]
    low, high = _range(values, found.limit)
    edges = np.linspace(low, high, BINS + 1)
    # The limit is an edge, so that no bar is of two kinds.
    edges[np.argmin(np.abs(edges - found.limit))] = found.limit
    beyond = found.sense * values > found.sense * found.limit
    with house_style():
        for some, colour, label in (
            (~beyond, COLOURS["nominal"], "within the limit"),
            (beyond, COLOURS["worst"], f"violates it: {found.violations} of {found.n}"),
        ):
            axes.hist(values[some], edges.tolist(), color=colour, alpha=0.85, label=label)
        limit = f"limit {found.limit:.4g} {found.unit}".rstrip()
        axes.axvline(found.limit, color=COLOURS["reference"], ls=(0, (5, 2)), lw=1.3, label=plain_label(limit))
        axes.set_xlabel(axis_label(found.metric, found.unit))
        axes.set_ylabel("samples")
        text = f"P(violation) between {found.lower:.3g} and {found.upper:.3g}"
        axes.set_title(f"{text} at {100 * found.confidence:g} % confidence")
        legend_below(figure, (axes,), 3)
    return figure


def influence_figure(found: Influence, metric: str) -> Figure:
    """Which parameters matter: their shares of the spread, and what each alone would save at the worst sample.

    Left: share of the variance that each parameter explains by itself; a bar that ends in the grey zone may be chance.
    Right: the metric at the worst sample (line), and where it comes to if that one parameter were nominal (dot).
    """
    order = tuple(k for k in found.order if found.matters[k])[:SHOWN] or found.order[:1]
    figure, (shares, saved) = new_figure(1, 2, width=10.4, height=1.4 + 0.3 * max(3, len(order)), sharey=True)
    rows = np.arange(len(order))
    names = [plain_label(found.names[k]) for k in order]
    kinds = {
        1: (COLOURS["worst"], f"{metric} grows with it"),
        -1: (COLOURS["nominal"], f"{metric} falls with it"),
        0: (COLOURS["sample"], "no clear direction"),
    }
    with house_style():
        for direction, (colour, label) in kinds.items():
            some = [row for row, k in enumerate(order) if found.directions[k] == direction]
            if some:
                widths = [100 * found.first_order[order[row]] for row in some]
                shares.barh(some, widths, color=colour, label=plain_label(label))
        shares.axvspan(0, 100 * found.noise, color=COLOURS["sample"], alpha=0.25, lw=0, label="may be chance")
        shares.set_yticks(rows, names)
        shares.invert_yaxis()
        shares.set_xlim(0, max(1.08 * 100 * float(found.first_order.max(initial=0.0)), 200 * found.noise, 1.0))
        shares.set_xlabel("share of the spread [%]")
        rest = len(found.names) - len(order)
        shares.set_title("which parameters matter" + (f" ({rest} more do not, or less)" if rest else ""))
        _draw_savings(saved, found, order)
        saved.set_xlabel(axis_label(metric, found.unit))
        saved.set_title("the worst sample, one parameter nominal")
        legend_below(figure, (shares, saved), 3)
    return figure


def _draw_savings(axes: Axes, found: Influence, order: tuple[int, ...]) -> None:
    restored = np.where(np.isfinite(found.restored), found.restored, found.worst_value)
    if not np.isfinite(found.worst_value):
        axes.text(0.5, 0.5, "the worst sample has no bounded value", ha="center", transform=axes.transAxes)
        axes.grid(visible=False)
        return
    axes.axvline(found.worst_value, color=COLOURS["worst"], lw=1.4, label="worst sample")
    axes.axvline(found.nominal_value, color=COLOURS["nominal"], lw=1.4, ls=(0, (5, 2)), label="nominal")
    for row, k in enumerate(order):
        axes.plot([found.worst_value, restored[k]], [row, row], color="#444444", lw=1.2)
        axes.plot(restored[k], row, "o", color="#444444", ms=5, label="that parameter nominal" if row == 0 else None)


def _range(values: np.ndarray, limit: float) -> tuple[float, float]:
    """What the axis shows: all finite values and the limit; some width where they are all the same."""
    seen = np.append(values, limit)
    low, high = float(seen.min()), float(seen.max())
    margin = 0.04 * (high - low) or 0.05 * max(abs(high), 1e-12)
    return low - margin, high + margin


def violation_influence(found: ViolationProbability) -> Figure:
    """Which parameters matter for a limited metric."""
    if found.influence is None:
        raise InputError("plot('influence')", "no influences", "32 samples at least, and real scalar blocks")
    return influence_figure(found.influence, found.metric)
