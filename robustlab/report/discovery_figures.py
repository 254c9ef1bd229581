"""Figures of a discovery: gap before and after, a held-out stretch, the sets it leaves open, what force is left."""

from __future__ import annotations

import math
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.identification.naming.discovery_parts import SetProbability
from robustlab.identification.naming.discovery_result import Discovery, chance, compared, headline
from robustlab.identification.unnamed.unnamed_effect import ForceCurve, ForceTable, ResidualForce, UnnamedForce
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    headroom,
    house_style,
    legend_below,
    new_figure,
    plain_label,
    stem,
    zero_line,
)

__all__ = ["CAPTIONS", "discovery_figures", "gap_figure", "posterior_figure", "residual_force_figure", "stretch_figure"]


Index = NDArray[np.int_]

MODELS = {"nominal": COLOURS["worst"], "refitted": COLOURS["sample"], "updated": COLOURS["nominal"]}
STRETCH = 4  # windows shown of a held-out stretch
APART = 0.06  # of a window, between windows that do not follow each other
SHOWN = 9  # sets of effects
LONG_TITLE = 92

COLUMNS = 2
ASIDE = 0.03  # of the bands' ends may lie outside the vertical axis on either side

CAPTIONS = {
    "story": "Error on data that the fit never saw: the nominal model, refitted within its tolerances, and updated.",
    "stretch": "A held-out stretch, window by window: record, nominal and updated model, and their errors below.",
    "posterior": "Sets of effects and how probable they are; blue: the smallest collection with 95 %.",
    "force": "The force that the updated model still lacks, over each coordinate, with its 95 % band.",
}


def discovery_figures(discovery: Discovery) -> dict[str, Figure]:
    """``story``; ``stretch-q`` for every output q; ``posterior``; ``force`` where a residual force is known."""
    figures = {"story": gap_figure(discovery)}
    for k, output in enumerate(discovery.series.get("outputs", {}), start=1):
        figures[f"stretch-{stem(output, k)}"] = stretch_figure(discovery, output)
    if discovery.posterior:
        figures["posterior"] = posterior_figure(discovery)
    if discovery.residual_force is not None and discovery.residual_force.curves:
        figures["force"] = residual_force_figure(discovery.residual_force, discovery.unnamed, "missing force")
    return figures


def gap_figure(discovery: Discovery) -> Figure:
    """For every output: bars of the held-out error of the three models, and beside them its traces over time."""
    d = discovery
    figure, axes = new_figure(len(d.gaps), 2, width=9.2, height=2.7, gridspec_kw={"width_ratios": [1.0, 2.1]})
    with house_style():
        for k, (name, gap) in enumerate(d.gaps.items()):
            bars, traces = axes[2 * k], axes[2 * k + 1]
            values = [getattr(gap, model) for model in MODELS]
            bars.barh(list(MODELS), values, color=list(MODELS.values()), height=0.62)
            bars.invert_yaxis()
            bars.grid(visible=False, axis="y")
            for row, value in enumerate(values):
                share = f"{100 * value / gap.range:.3g} %" if gap.range > 0 else f"{value:.3g}"
                bars.annotate(share, (value, row), (4, 0), textcoords="offset points", va="center", fontsize=8.5)
            bars.set_xlim(0.0, 1.28 * (max(values) or 1.0))
            bars.set_xlabel(axis_label("rms error", gap.unit))
            bars.set_title(plain_label(f"{name}: {compared(gap.nominal, gap.updated, 'nominal')}"))
            bars.xaxis.set_major_locator(MaxNLocator(4))
            signals = d.series.get("outputs", {}).get(name)
            if signals is None:
                traces.remove()
                continue
            axis = _Windows.of(d)
            for model, colour in MODELS.items():
                error = np.asarray(signals["measured"]) - np.asarray(signals[model])
                traces.plot(*axis.broken(error), color=colour, lw=1.0, label=model)
            axis.label(traces)
            zero_line(traces)
            traces.set_ylabel(axis_label("error", gap.unit))
            traces.set_title("record minus simulation, held-out windows")
            if k == 0:
                traces.legend(loc="lower left", bbox_to_anchor=(0.0, -0.03), ncols=3, columnspacing=1.2)
                headroom(traces, below=0.2)
        figure.suptitle(_wrapped(plain_label(headline(d))), x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def stretch_figure(discovery: Discovery, output: str) -> Figure:
    """Some held-out windows around the one that the nominal model misses most: signals above, errors below."""
    d = discovery
    signals, gap = d.series["outputs"][output], d.gaps[output]
    measured = np.asarray(signals["measured"])
    whole = _Windows.of(d)
    miss = [
        float(np.nanmean(part**2)) if np.isfinite(part).any() else 0.0
        for part in whole.cut(measured - signals["nominal"])
    ]
    first = min(max(int(np.argmax(miss)) - STRETCH // 2, 0), max(len(miss) - STRETCH, 0))
    axis = whole.some(first, STRETCH)
    figure, (above, middle, below) = new_figure(3, 1, width=7.8, height=2.0, sharex=True)
    with house_style():
        above.plot(*axis.broken(measured), color=COLOURS["measured"], lw=2.4, alpha=0.45, label="record")
        for model, line in (("nominal", (0, (4, 1.5))), ("updated", "-")):
            values = np.asarray(signals[model])
            above.plot(*axis.broken(values), color=MODELS[model], lw=1.3, ls=line, label=model)
            middle.plot(*axis.broken(measured - values), color=MODELS[model], lw=1.1)
        above.set_ylabel(axis_label(output, gap.unit))
        above.set_title(plain_label(f"{output}, held out: each window starts from its best fitted state"))
        above.legend(loc="lower left", bbox_to_anchor=(0.0, -0.03), ncols=3)
        headroom(above, below=0.2)
        below.plot(*axis.broken(measured - np.asarray(signals["updated"])), color=MODELS["updated"], lw=1.0)
        middle.set_title(plain_label(f"record minus simulation: nominal (rms {gap.nominal:.3g} {gap.unit})"))
        below.set_title(plain_label(f"updated alone, on a scale of its own (rms {gap.updated:.3g} {gap.unit})"))
        for panel in (middle, below):
            zero_line(panel)
            panel.set_ylabel(axis_label("error", gap.unit))
        axis.label(below)
    return figure


def posterior_figure(discovery: Discovery) -> Figure:
    """Bars of the probability of the best sets of effects, with their log evidence behind the first."""
    shown = discovery.posterior[:SHOWN]
    open_ones = len(discovery.collection)
    figure, (axes,) = new_figure(1, 1, width=7.8, height=1.0 + 0.28 * len(shown))
    with house_style():
        for row, entry in enumerate(shown):
            colour = COLOURS["nominal"] if row < open_ones else COLOURS["sample"]
            axes.barh(row, 100 * entry.probability, color=colour, height=0.62)
            behind = f", log evidence {entry.evidence:.3g}" if row else ""
            apart = f", {entry.distance:.2g} σ apart" if row and math.isfinite(entry.distance) else ""
            axes.annotate(
                f"{chance(entry.probability)}{behind}{apart}".replace("-", "−"),
                (100 * entry.probability, row), (4, 0), textcoords="offset points", va="center", fontsize=8,
            )  # fmt: skip
        axes.set_yticks(range(len(shown)), [fill(plain_label(_set_name(entry)), 44) for entry in shown])
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_xlim(0.0, 145.0)
        axes.set_xticks([0, 25, 50, 75, 100])
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("probability [%]")
    return figure


def residual_force_figure(residual: ResidualForce, unnamed: UnnamedForce | None = None, name: str = "force") -> Figure:
    """Residual force over each coordinate; below it, what share of it each explains.

    Parameters
    ----------
    residual
        Curves and shares.
    unnamed
        The map fitted to it, drawn over the same coordinates where it has a component that is no dry pair.
    name
        What the force is called on the axes.
    """
    curves = list(residual.curves.values())
    rows = math.ceil((len(curves) + 1) / COLUMNS)
    figure, panels = new_figure(rows, COLUMNS, width=8.4, height=2.7)
    with house_style():
        low, high = _limits(curves)
        for panel, curve in zip(panels, curves, strict=False):
            _curve(panel, curve)
            if unnamed is not None:
                for table in unnamed.components:
                    if table.coordinate == curve.coordinate and table.kind != "dry":
                        _table(panel, table)
            panel.set_ylim(low, high)
            panel.set_xlabel(axis_label(curve.coordinate, curve.unit))
            panel.set_ylabel(axis_label(name, residual.unit))
        _shares(panels[len(curves)], residual, unnamed)
        for panel in panels[len(curves) + 1 :]:
            panel.set_visible(False)
        if curves:
            legend_below(figure, panels[: len(curves)], 3)
    return figure


# --- parts -----------------------------------------------------------------------------------------------------------


class _Windows:
    """The time axis of windows side by side: gaps between them are drawn as short ones, and lines break there.

    ``start`` and ``stop`` are the samples of each window among the series, ``x`` where each sample is drawn.
    """

    def __init__(self, t: Array, start: Index, stop: Index) -> None:
        self.t, self.start, self.stop = t, start, stop
        dt = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        self.x = np.empty(len(t))
        end = float(t[start[0]])
        self.gaps = False
        for a, b in zip(start, stop, strict=True):
            jump = a > start[0] and abs(t[a] - t[a - 1] - dt) > 0.5 * dt
            self.gaps = self.gaps or bool(jump)
            length = float(t[b - 1] - t[a]) + dt
            begin = end + (APART * length if jump else 0.0)
            self.x[a:b] = begin + (t[a:b] - t[a])
            end = begin + length

    @classmethod
    def of(cls, d: Discovery) -> _Windows:
        """All windows of the series."""
        t = np.asarray(d.series["t"], dtype=float)
        dt = float(np.median(np.diff(t))) if len(t) > 1 else d.window
        length = max(1, round(d.window / dt))
        start = np.arange(0, len(t), length)
        return cls(t, start, np.minimum(start + length, len(t)))

    def some(self, first: int, count: int) -> _Windows:
        """A few of the windows, from the first."""
        return _Windows(self.t, self.start[first : first + count], self.stop[first : first + count])

    def cut(self, values: Array) -> list[Array]:
        """The values window by window."""
        return [np.asarray(values)[a:b] for a, b in zip(self.start, self.stop, strict=True)]

    def broken(self, values: Array) -> tuple[Array, Array]:
        """Curve with a break (NaN) after each window: every window has its own start."""
        x = [part for a, b in zip(self.start, self.stop, strict=True) for part in (self.x[a:b], [np.nan])]
        y = [part for a, b in zip(self.start, self.stop, strict=True) for part in (np.asarray(values)[a:b], [np.nan])]
        return np.concatenate(x), np.concatenate(y)

    def label(self, axes: Axes) -> None:
        """Ticks with true times, at window starts where windows are left out between them."""
        axes.set_xlim(float(self.x[self.start[0]]), float(self.x[self.stop[-1] - 1]))
        axes.set_xlabel("time [s]")
        if not self.gaps:
            return
        every = -(-len(self.start) // 8)
        chosen = self.start[::every]
        axes.xaxis.set_major_locator(FixedLocator(self.x[chosen].tolist()))
        labels = {float(self.x[a]): f"{self.t[a]:.3g}" for a in chosen}
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: labels.get(float(value), "")))
        axes.set_xlabel("start of the window [s] (windows between them were fitted)")


def _set_name(entry: SetProbability) -> str:
    unnamed = [f"unnamed {entry.unnamed}"] if entry.unnamed else []
    return " + ".join([*entry.effects, *unnamed]) or "nothing missing"


def _wrapped(text: str, width: int = LONG_TITLE) -> str:
    return fill(text.replace("->", "→"), width)


def _limits(curves: list[ForceCurve]) -> tuple[float, float]:
    """One scale for all panels; single bins with a giant band do not set it."""
    ends = np.concatenate([np.concatenate([c.low, c.high]) for c in curves] or [np.zeros(1)])
    middles = np.concatenate([c.value for c in curves] or [np.zeros(1)])
    low, high = np.quantile(ends, [ASIDE, 1.0 - ASIDE])
    low, high = min(float(low), float(middles.min()), 0.0), max(float(high), float(middles.max()), 0.0)
    edge = 0.06 * (high - low) or 1.0
    return low - edge, high + edge


def _curve(panel: Axes, curve: ForceCurve) -> None:
    zero_line(panel)
    # A line across zero speed would hide the jump there.
    sides = (curve.x < 0, curve.x >= 0) if curve.coordinate.lower().startswith("speed") else (curve.x == curve.x,)
    for k, side in enumerate(sides):
        panel.fill_between(
            curve.x[side], curve.low[side], curve.high[side], color=COLOURS["band"], alpha=0.35, lw=0,
            label="95 % band" if k == 0 else None,
        )  # fmt: skip
        panel.plot(
            curve.x[side], curve.value[side], "o-", ms=2.8, lw=1.2, color=COLOURS["nominal"],
            label="mean over a bin" if k == 0 else None,
        )  # fmt: skip
    if len(sides) == 2:
        panel.axvline(0.0, color="#888888", lw=0.8)
    chance = "p < 0.005" if curve.p_value < 0.005 else f"p = {curve.p_value:.2g}"
    panel.set_title(f"{plain_label(curve.coordinate)}: explains {100 * curve.share:.0f} % ({chance})")


def _table(panel: Axes, table: ForceTable) -> None:
    halves = table.sides() if table.kind == "speed" else ((table.grid, table.value),)
    for k, (grid, value) in enumerate(halves):
        label = "part of the unnamed map" if k == 0 else None
        panel.plot(grid, value, color=COLOURS["worst"], ls=(0, (5, 1.5)), lw=1.4, label=label)


def _shares(panel: Axes, residual: ResidualForce, unnamed: UnnamedForce | None) -> None:
    rows = [(f"f({name})", curve.share, COLOURS["nominal"]) for name, curve in residual.curves.items()]
    rows += [(f"+ sgn(v) f({name})", share, COLOURS["band"]) for name, share in residual.dry_share.items()]
    rows.append(("all together", residual.joint_share, COLOURS["good"]))
    if unnamed is not None:
        rows.append(("unnamed map", unnamed.gain, COLOURS["worst"]))
    rows.append(("noise of the estimate", residual.noise_share, COLOURS["sample"]))
    place = np.arange(len(rows))[::-1]
    panel.barh(place, [100 * share for _, share, _ in rows], color=[colour for *_, colour in rows], height=0.65)
    for y, (_, share, _) in zip(place, rows, strict=True):
        panel.text(100 * share + 1.5, float(y), f"{100 * share:.0f}", va="center", fontsize=8)
    panel.set_yticks(place, [plain_label(label) for label, *_ in rows], fontsize=8)
    panel.set_xlim(0, 112)
    panel.set_xticks([0, 25, 50, 75, 100])
    panel.grid(axis="y", visible=False)
    panel.set_xlabel("share of the variance, held-out [%]")
    panel.set_title("what explains it")
