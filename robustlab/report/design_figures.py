"""Figures of designs: the weighted loop with its peak, S, T and K S with their bounds, controllers, mu, simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustlab.arrays import Array
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    frequency_axis,
    house_style,
    legend_below,
    logarithmic,
    new_figure,
    plain_label,
)

if TYPE_CHECKING:
    from robustlab.analysis.performance_comparison import PerformanceComparison
    from robustlab.dynamics.control.controlled_runs import ControlledRuns
    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.specifications.loop_functions import LoopFunctions
    from robustlab.synthesis.specifications.tracking_problem import TrackingLoop

# Colour, dashes and width of the designs that a figure compares, in their order; a narrow curve shows on a wide one.
DESIGNS = (
    (COLOURS["reference"], (0, (4, 1.5)), 1.4),
    (COLOURS["nominal"], "-", 3.0),
    (COLOURS["worst"], "-", 1.4),
    (COLOURS["good"], (0, (6, 1.5, 1.5, 1.5)), 1.4),
    (COLOURS["limit"], (0, (1.5, 1)), 1.4),
    (COLOURS["sample"], "-", 1.4),
)
NAMED = 6  # more measurements than these are drawn as one kind
CYCLE = ("sample", "nominal", "good", "limit")


@dataclass(frozen=True, eq=False)
class FunctionPanel:
    """One closed-loop function of one or several designs over frequency."""

    name: str  # heading, for example `"S: control error"`
    gains: Mapping[str, Array]  # design -> largest singular value, shape (n_omega,)
    allowed: Array | None = None  # `1 / |W|`, what the weight asks for, shape (n_omega,); None without a weight
    proved: Array | None = None  # `gamma / |W|`, below which the verified gamma keeps the function; None without
    unit: str = ""  # of the gain; empty for a ratio


def functions_figure(omega: Array, panels: Sequence[FunctionPanel], gamma: float | None = None) -> Figure:
    """Gains over frequency against the inverses of the weights, one panel per function."""
    figure, axes_list = new_figure(1, len(panels), width=3.5 * max(2, len(panels)), height=3.5)
    with house_style():
        for axes, panel in zip(axes_list, panels, strict=True):
            _designs(axes, omega, panel.gains)
            if panel.allowed is not None:
                text = "1 / |W|, what is asked for"
                axes.plot(omega, panel.allowed, color=COLOURS["sample"], lw=2.6, label=text, zorder=1)
            if panel.proved is not None:
                text = "γ / |W|, proved" if gamma is None else f"γ / |W|, proved, γ = {gamma:.4g}"
                axes.plot(omega, panel.proved, color=COLOURS["limit"], ls=(0, (5, 2)), label=text)
            frequency_axis(axes, (omega[0], omega[-1]))
            logarithmic(axes.yaxis)
            _span(axes, list(panel.gains.values()), 4.0, [b for b in (panel.allowed, panel.proved) if b is not None])
            axes.set_title(axis_label(panel.name, panel.unit))
        axes_list[0].set_ylabel("largest singular value")
        legend_below(figure, axes_list)
    return figure


def _span(axes: Axes, curves: Sequence[Array], decades: float = 6.0, bounds: Sequence[Array] = ()) -> float:
    """Set the height: not more than so many decades below the highest point, not less than one and a half.

    A bound within two decades above the curves is shown whole. Returns the lower end.
    """
    top = max((float(np.max(c[np.isfinite(c)], initial=0.0)) for c in curves), default=0.0)
    low = min((float(np.min(c[np.isfinite(c) & (c > 0)], initial=np.inf)) for c in curves), default=0.0)
    if top <= 0:
        return 0.0
    low = min(max(low / 2, top * 10.0**-decades), top / 30)
    nearest = max((float(np.min(b[np.isfinite(b)], initial=np.inf)) for b in bounds), default=0.0)
    high = max(5 * top, 3 * nearest) if nearest <= 100 * top else 5 * top
    axes.set_ylim(low, high)
    return low


def loop_picture(design: Synthesis) -> Figure:
    """Singular values of the weighted closed loop with the peak marked, and the controller's gains."""
    from robustlab.synthesis.specifications.loop_functions import loop_curves

    curves = loop_curves(design)
    omega, closed_loop, peak = curves.omega, curves.closed_loop, curves.peak
    heading = "closed loop, channels of Δ included" if design.plant.blocks else "weighted closed loop"
    figure, (loop, gains) = new_figure(1, 2, width=9.6, height=3.7)
    with house_style():
        low = _span(loop, [closed_loop[:, 0], np.array([peak[1]])], 4.0)
        for k, curve in enumerate(c for c in closed_loop.T if c.max() > low):
            first = k == 0
            loop.plot(
                omega, curve, color=COLOURS["nominal" if first else "band"], lw=1.6 if first else 0.8,
                label="largest" if first else "others" if k == 1 else None, zorder=3 if first else 2,
            )  # fmt: skip
        loop.axhline(
            peak[1], color=COLOURS["limit"], ls=(0, (5, 2)), label=f"{plain_label(curves.level)}: {peak[1]:.4g}"
        )
        if omega[0] <= peak[0] <= omega[-1]:
            loop.plot(peak[0], peak[1], "o", color=COLOURS["worst"], ms=6, label=f"peak, {peak[0]:.4g} rad/s", zorder=4)
        loop.set_title(heading)
        loop.set_ylabel("singular values")
        values, names = curves.controller, curves.measurements
        if len(names) <= NAMED:
            _designs(gains, omega, dict(zip(names, values.T, strict=True)))
        else:
            label = f"each of the {len(names)} measurements"
            gains.plot(omega, values, color=COLOURS["nominal"], lw=0.9, label=[label] + ["_"] * (len(names) - 1))
        gains.set_title("controller, gain from each measurement")
        gains.set_ylabel("largest gain")
        logarithmic(gains.yaxis)
        logarithmic(loop.yaxis)
        _span(gains, list(values.T), 8.0)
        for axes in (loop, gains):
            frequency_axis(axes, (omega[0], omega[-1]))
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    return figure


def performance_picture(found: PerformanceComparison) -> Figure:
    """Upper bound of mu over frequency for each design; the level proved for the whole axis as a thin line."""
    margins = found.margins
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.8)
    with house_style():
        top = 1.0
        for (name, margin), (colour, dashes, width) in zip(margins.items(), _cycle(len(margins)), strict=True):
            proved = 1 / margin.lower if margin.lower > 0 else float("inf")
            said = f"at most {proved:.4g}" if np.isfinite(proved) else "nothing proved"
            label = f"{plain_label(name)}: {said} on the whole axis"
            axes.plot(margin.omega, margin.mu_upper, color=colour, ls=dashes, lw=width, label=label)
            if np.isfinite(proved):
                axes.axhline(proved, color=colour, lw=0.7, alpha=0.7)
                top = max(top, proved)
            if margin.frequency is not None and 0 < margin.upper < np.inf:
                axes.plot(margin.frequency, 1 / margin.upper, "o", color=colour, ms=5)
        axes.plot([], [], "o", color=COLOURS["sample"], ms=5, label="attained by an explicit Δ")
        axes.axhline(1.0, color=COLOURS["limit"], ls=(0, (5, 2)), lw=1.2, label="1: requirement met by every member")
        omega = next(iter(margins.values())).omega
        frequency_axis(axes, (omega[0], omega[-1]))
        axes.set(ylim=(0, 1.1 * top), ylabel="μ of robust performance")
        legend_below(figure, (axes,), 2)
    return figure


def history_picture(design: Any) -> Figure:
    """A D-K search iterate by iterate: mu at single frequencies (NaN: not computed), what was proved, order of K."""
    mu, proved = [s.mu for s in design.history], [s.gamma for s in design.history]
    orders, stages = [s.order for s in design.history], [s.stage for s in design.history]
    steps = np.arange(1, len(proved) + 1)
    figure, (level, order) = new_figure(2, 1, width=8.0, height=2.2, sharex=True)
    with house_style():
        for stage, colour in zip(dict.fromkeys(stages), (COLOURS[c] for c in CYCLE), strict=False):
            mine = np.array([s == stage for s in stages])
            text = f"{plain_label(stage)}: proved"
            level.plot(steps[mine], np.asarray(proved)[mine], "o", color=colour, ms=5, label=text)
        level.plot(steps, proved, color=COLOURS["sample"], lw=0.8, zorder=1)
        level.plot(steps, mu, "x", color=COLOURS["reference"], ms=5, label="μ at single frequencies")
        best = int(np.argmin(proved))
        level.plot(steps[best], proved[best], "o", ms=11, mfc="none", color=COLOURS["worst"], label="smallest")
        level.axhline(1.0, color=COLOURS["limit"], ls=(0, (5, 2)), lw=1.1, label="1: robust performance")
        logarithmic(level.yaxis)
        level.set_ylim(0.7 * min([1.0, *proved]), 1.5 * max([1.0, *(p for p in proved if np.isfinite(p))]))
        level.set_ylabel("bound of μ")
        level.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        order.step(steps, orders, where="mid", color=COLOURS["nominal"])
        order.set(ylabel="order of K", xlabel="iterate", ylim=(0, 1.15 * max(1, *orders)))
        order.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def runs_picture(found: ControlledRuns) -> Figure:
    """Several runs over time, one panel per signal; a limit that is far from all curves is named, not drawn."""
    t, panels = found.t, found.panels
    figure, axes_list = new_figure(len(panels), 1, width=8.6, height=2.2, sharex=True)
    with house_style():
        for axes, panel in zip(axes_list, panels, strict=True):
            for (name, curve), (colour, dashes, width) in zip(
                panel.curves.items(), _cycle(len(panel.curves)), strict=True
            ):
                axes.plot(t, curve, color=colour, ls=dashes, lw=0.8 * width, label=plain_label(name))
            largest = max(float(np.abs(curve).max()) for curve in panel.curves.values())
            axes.set_ylabel(plain_label(panel.label))
            if panel.limit is not None and largest > 0.4 * panel.limit:
                for i, edge in enumerate((-panel.limit, panel.limit)):
                    label = None if i else f"limit: {panel.limit:g}"
                    axes.axhline(edge, color=COLOURS["limit"], ls=(0, (5, 2)), lw=1.2, label=label)
            elif panel.limit is not None:
                axes.set_title(f"the limit of {panel.limit:g} is beyond this panel", fontsize=8.5, fontweight="normal")
        axes_list[-1].set_xlabel("time [s]")
        legend_below(figure, axes_list)
    return figure


def _designs(axes: Axes, omega: Array, gains: Mapping[str, Array]) -> None:
    for (name, gain), (colour, dashes, width) in zip(
        gains.items(), _cycle(len(gains), only=len(gains) == 1), strict=True
    ):
        axes.plot(omega, gain, color=colour, ls=dashes, lw=width, label=plain_label(name), zorder=3)


def _cycle(n: int, only: bool = False) -> list[tuple[str, Any, float]]:
    """Colour, dashes and width of n designs; a single one is drawn as the nominal curve."""
    if only:
        return [(COLOURS["nominal"], "-", 1.6)]
    return [DESIGNS[k % len(DESIGNS)] for k in range(n)]


HEADINGS = {"S": "S: relative error", "KS": "K S: control", "T": "T: relative output"}


PICTURE_HEADINGS = {"S": "S: r → error", "T": "T: r → y", "KS": "K S: r → u", "SG": "S G: d → y"}


def functions_picture(design: Synthesis) -> Figure:
    """S, T, K S and S G of the loop at what the controller measures, against 1 / |W| and gamma / |W| where known."""
    from robustlab.synthesis.specifications.loop_functions import loop_functions

    return gangs_picture(loop_functions(design), around=getattr(design, "peak_frequency", None))


def tracking_picture(loop: TrackingLoop) -> Figure:
    """S, K S and T of a tracking problem against what the weights ask for, and what gamma proves."""
    from robustlab.synthesis.specifications.loop_functions import frequencies

    omega = frequencies(loop.design.closed_loop)
    gains, allowed = loop.problem.gains(loop.design.K, omega), loop.problem.bounds(omega)
    units = {s.unit for s in loop.problem.plant.controls}
    panels = []
    for function, heading in HEADINGS.items():
        bound = allowed.get(function)
        proved = None if bound is None or loop.gamma is None else loop.gamma * bound
        unit = next(iter(units)) if function == "KS" and len(units) == 1 else ""
        panels.append(FunctionPanel(heading, {loop.design.method: gains[function]}, bound, proved, unit))
    return functions_figure(omega, panels, loop.gamma)


def gangs_picture(loop: LoopFunctions, around: float | None = None) -> Figure:
    """The gang of four of a loop; ``around``: a frequency in rad/s that has to be seen."""
    from robustlab.synthesis.specifications.loop_functions import FUNCTIONS, frequencies

    omega = frequencies(loop.S, around=around)
    panels = []
    for name in FUNCTIONS:
        proved = loop.bound(name, omega)
        finite = proved is not None and bool(np.isfinite(proved).all())
        panels.append(
            FunctionPanel(
                PICTURE_HEADINGS[name],
                {"closed loop": loop.gain(name, omega)},
                proved / loop.gamma if proved is not None and finite else None,
                proved if finite else None,
            )
        )
    return functions_figure(omega, panels, loop.gamma if loop.weights else None)


def mu_picture(design: Any) -> Figure:
    """Bounds of mu of a D-K design over frequency, proved on the whole axis once more from its closed loop alone."""
    from robustlab.mu_analysis import robust_performance
    from robustlab.report.robustness_figures import mu_figure
    from robustlab.synthesis.specifications.loop_functions import frequencies
    from robustlab.uncertainty.lft import UncertainModel

    loop = UncertainModel(design.closed_loop, [b for b in design.blocks if b.name != "performance"])
    omega = frequencies(design.closed_loop, 160)
    return mu_figure(robust_performance(loop, omega=omega, accuracy=1e-3, tolerance=float("inf")))
