"""Figures of robustness analysis: bounds over frequency with what is proved, shares of the blocks, replay in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    frequency_axis,
    house_style,
    legend_below,
    new_figure,
    plain_label,
)
from robustlab.tables import Tabular

if TYPE_CHECKING:
    from robustlab.mu_analysis import Margin, WorstCaseGain
    from robustlab.mu_analysis.axis.critical_delta import Replay
    from robustlab.mu_analysis.margins.at_frequencies import DiskMarginsAt, GainAt, MarginAt
    from robustlab.synthesis.sampled.sampled_robustness import SampledRobustness

Interval = tuple[float, float, float]
PROVED = "#d6ecf8"  # opaque: the intervals overlap
SHOWN_BLOCKS = 16


def mu_figure(margin: Margin) -> Figure:
    """Bounds of mu at the frequencies of the margin, and what is proved between them."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    omega, lower, upper = margin.omega, margin.mu_lower, margin.mu_upper
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


def bounds_at(found: MarginAt | GainAt | DiskMarginsAt) -> Figure:
    """Both bounds at given frequencies, of all loops at once: points, for nothing is known between them."""
    whole = found if isinstance(found, Tabular) else found.simultaneous
    return _bounds_at(whole, "stability margin" if whole is found else "disk margin, all loops at once")


def _bounds_at(found: MarginAt | GainAt, label: str) -> Figure:
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    kind = "margin" if hasattr(found, "between") else "gain"
    words = ("proved", "attained by an explicit Δ") if kind == "margin" else ("attained by an explicit Δ", "proved")
    with house_style():
        shown = found.omega > 0
        for bound, word, mark, colour in zip(
            (found.lower, found.upper), words, "^v", (COLOURS["nominal"], COLOURS["worst"]), strict=True
        ):
            finite = shown & np.isfinite(bound)
            axes.plot(found.omega[finite], bound[finite], mark, color=colour, ms=4, ls="none", label=word)
        frequency_axis(axes, (found.omega[shown][0], found.omega[-1]) if shown.sum() > 1 else None)
        axes.set_ylabel(label if kind == "margin" else "worst-case gain")
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


def shares_figure(shares: Mapping[str, float]) -> Figure:
    """Share of each block in the margin, the largest on top: which range to tighten first."""
    ranked = sorted(shares.items(), key=lambda pair: -abs(pair[1]))[:SHOWN_BLOCKS]
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


def replay_figure(replay: Replay, shown: int = 4) -> Figure:
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


def margin_shares(margin: Margin) -> Figure:
    """Shares of a margin's blocks.

    Raises
    ------
    InputError
        The margin has none: its critical pole is not simple, or the loop is ill-posed there.
    """
    if not margin.shares:
        raise InputError("plot('shares')", "a margin without shares of its blocks", "one at a simple critical pole")
    return shares_figure(margin.shares)


def sampled_figure(found: SampledRobustness) -> Figure:
    """Bounds of mu of a sampled loop: those of robust performance, or of stability where there is none."""
    return mu_figure(found.performance or found.stability)
