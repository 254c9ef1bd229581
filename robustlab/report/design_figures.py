"""Figures of designs: the weighted loop with its peak, S, T and K S with their bounds, controllers, mu, simulations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.report import style
from robustlab.synthesis.specifications.loop_functions import frequencies, loop_functions

if TYPE_CHECKING:
    from robustlab.analysis.performance import PerformanceComparison
    from robustlab.dynamics.control.platform import ControlledRuns
    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.specifications.loop_functions import LoopFunctions
    from robustlab.synthesis.specifications.tracking import TrackingLoop

# Colour, dashes and width of the compared designs in their order; a narrow curve is visible on a wide one.
DESIGNS: tuple[dict[str, Any], ...] = (
    {"color": style.MEASURED, "ls": (0, (4, 1.5)), "lw": 1.4},
    {"color": style.NOMINAL, "ls": "-", "lw": 3.0},
    {"color": style.WORST, "ls": "-", "lw": 1.4},
    {"color": style.GOOD, "ls": (0, (6, 1.5, 1.5, 1.5)), "lw": 1.4},
    {"color": style.LIMIT, "ls": (0, (1.5, 1)), "lw": 1.4},
    {"color": style.SAMPLE, "ls": "-", "lw": 1.4},
)
NAMED = 6  # more measurements than these are drawn as one kind
HEADINGS = {"S": "S: relative error", "KS": "K S: control", "T": "T: relative output"}
PICTURE_HEADINGS = {"S": "S: r → error", "T": "T: r → y", "KS": "K S: r → u", "SG": "S G: d → y"}


@style.house_style()
def functions_figure(
    omega: Array, panels: Mapping[str, tuple[Array, Array | None]], gamma: float | None, label: str
) -> Figure:
    """Gains over frequency, one panel per heading, with `1 / |W|` where there is a weight, and gamma times that."""
    figure, axes_list = style.new_figure(1, len(panels), width=3.5 * max(2, len(panels)), height=3.5)
    for axes, (heading, (gain, allowed)) in zip(axes_list, panels.items(), strict=True):
        axes.plot(omega, gain, color=style.NOMINAL, label=style.plain_label(label), zorder=3)
        bounds: list[Array] = []
        if allowed is not None:
            bounds.append(allowed)
            axes.plot(omega, allowed, color=style.SAMPLE, lw=2.6, label="1 / |W|, required", zorder=1)
            if gamma is not None:
                bounds.append(gamma * allowed)
                text = f"γ / |W|, proved, γ = {gamma:.4g}"
                axes.plot(omega, bounds[-1], color=style.LIMIT, ls=style.DASHED, label=text)
        _over_frequency(axes, omega, [gain], 4.0, bounds)
        axes.set_title(heading)
    axes_list[0].set_ylabel("largest singular value")
    return style.legend_below(figure, axes_list)


def _over_frequency(
    axes: Axes, omega: Array, curves: Iterable[Array], decades: float, bounds: Sequence[Array] = ()
) -> float:
    """Set logarithmic axes over at most so many decades, at least one and a half; return the lower end.

    A bound within two decades above the curves is included.
    """
    style.frequency_axis(axes, (omega[0], omega[-1]))
    style.logarithmic(axes.yaxis)
    every = np.concatenate([np.ravel(curve) for curve in curves])
    every = every[np.isfinite(every) & (every > 0)]
    if not len(every):
        return 0.0
    top = float(every.max())
    low = min(max(float(every.min()) / 2, top * 10.0**-decades), top / 30)
    nearest = max((float(np.min(b[np.isfinite(b)], initial=np.inf)) for b in bounds), default=0.0)
    axes.set_ylim(low, max(5 * top, 3 * nearest) if nearest <= 100 * top else 5 * top)
    return low


@style.house_style()
def loop_picture(design: Synthesis) -> Figure:
    """Singular values of the weighted closed loop with the peak marked, and the controller's gains."""
    at = float(getattr(design, "peak_frequency", np.nan))
    omega = frequencies(design.closed_loop, around=at)
    values = np.linalg.svd(frequency_response(design.closed_loop, omega), compute_uv=False).astype(np.float64)
    peak, level = (at, float(design.gamma)), "γ, verified"
    if not np.isfinite(at):  # gamma is another norm or of another loop
        highest = int(values[:, 0].argmax())
        peak, level = (float(omega[highest]), float(values[highest, 0])), "highest of the curve"
    figure, (loop, gains) = style.new_figure(1, 2, width=9.6, height=3.7)
    low = _over_frequency(loop, omega, [values[:, 0], np.array([peak[1]])], 4.0)
    loop.plot(omega, values[:, 0], color=style.NOMINAL, label="largest", zorder=3)
    others = values[:, 1:][:, values[:, 1:].max(axis=0, initial=0.0) > low]
    if others.size:
        labels = ["others", *["_"] * (others.shape[1] - 1)]
        loop.plot(omega, others, color=style.BAND, lw=0.8, label=labels, zorder=2)
    loop.axhline(peak[1], color=style.LIMIT, ls=style.DASHED, label=f"{style.plain_label(level)}: {peak[1]:.4g}")
    if omega[0] <= peak[0] <= omega[-1]:
        loop.plot(peak[0], peak[1], "o", color=style.WORST, ms=6, label=f"peak, {peak[0]:.4g} rad/s", zorder=4)
    title = "closed loop, channels of Δ included" if design.plant.blocks else "weighted closed loop"
    loop.set(title=title, ylabel="singular values")
    names = [s.name for s in design.plant.measurements]
    controller = np.linalg.norm(frequency_response(design.K, omega), axis=1)  # in control per measurement units
    if len(names) <= NAMED:
        for name, gain, how in zip(names, controller.T, DESIGNS[len(names) == 1 :], strict=False):
            gains.plot(omega, gain, label=style.plain_label(name), **how)
    else:
        labels = [f"each of the {len(names)} measurements", *["_"] * (len(names) - 1)]
        gains.plot(omega, controller, color=style.NOMINAL, lw=0.9, label=labels)
    _over_frequency(gains, omega, controller.T, 8.0)
    gains.set(title="controller, gain from each measurement", ylabel="largest gain")
    for axes in (loop, gains):
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    return figure


@style.house_style()
def performance_picture(found: PerformanceComparison) -> Figure:
    """Upper bound of mu over frequency for each design; the level proved for the whole axis as a thin line."""
    figure, (axes,) = style.new_figure(1, 1, width=8.0, height=3.8)
    top, omega = 1.0, np.zeros(0)
    for (name, margin), how in zip(found.margins.items(), cycle(DESIGNS), strict=False):
        omega = margin.omega
        proved = 1 / margin.lower if margin.lower > 0 else float("inf")
        bound = f"at most {proved:.4g}" if np.isfinite(proved) else "nothing proved"
        label = f"{style.plain_label(name)}: {bound} on the whole axis"
        axes.plot(omega, margin.mu_upper, label=label, **how)
        if np.isfinite(proved):
            axes.axhline(proved, color=how["color"], lw=0.7, alpha=0.7)
            top = max(top, proved)
        if margin.frequency is not None and 0 < margin.upper < np.inf:
            axes.plot(margin.frequency, 1 / margin.upper, "o", color=how["color"], ms=5)
    axes.plot([], [], "o", color=style.SAMPLE, ms=5, label="attained by an explicit Δ")
    axes.axhline(1.0, color=style.LIMIT, ls=style.DASHED, lw=1.2, label="1: requirement met by every member")
    style.frequency_axis(axes, (omega[0], omega[-1]))
    axes.set(ylim=(0, 1.1 * top), ylabel="μ of robust performance")
    return style.legend_below(figure, (axes,), 2)


@style.house_style()
def runs_picture(found: ControlledRuns) -> Figure:
    """Several runs over time, one panel per signal; a limit far from all curves is in the title."""
    figure, axes_list = style.new_figure(len(found.panels), 1, width=8.6, height=2.2, sharex=True)
    for axes, panel in zip(axes_list, found.panels, strict=True):
        for (name, curve), how in zip(panel.curves.items(), cycle(DESIGNS), strict=False):
            axes.plot(found.t, curve, label=style.plain_label(name), **{**how, "lw": 0.8 * how["lw"]})
        largest = max(float(np.abs(curve).max()) for curve in panel.curves.values())
        axes.set_ylabel(style.plain_label(panel.label))
        if panel.limit is not None and largest > 0.4 * panel.limit:
            for edge, label in ((-panel.limit, None), (panel.limit, f"limit: {panel.limit:g}")):
                axes.axhline(edge, color=style.LIMIT, ls=style.DASHED, lw=1.2, label=label)
        elif panel.limit is not None:
            axes.set_title(f"the limit of {panel.limit:g} is beyond this panel", fontsize=8.5, fontweight="normal")
    axes_list[-1].set_xlabel("time [s]")
    return style.legend_below(figure, axes_list)


def functions_picture(design: Synthesis) -> Figure:
    """S, T, K S and S G of the loop at the measurements, against 1 / |W| and gamma / |W| where known."""
    return gangs_picture(loop_functions(design), around=getattr(design, "peak_frequency", None))


def tracking_picture(loop: TrackingLoop) -> Figure:
    """S, K S and T of a tracking problem against the bounds of the weights and those proved by gamma."""
    omega = frequencies(loop.design.closed_loop)
    gains, allowed = loop.problem.gains(loop.design.K, omega), loop.problem.bounds(omega)
    units = {s.unit for s in loop.problem.plant.controls}
    unit = units.pop() if len(units) == 1 else ""
    panels = {
        style.axis_label(heading, unit if name == "KS" else ""): (gains[name], allowed.get(name))
        for name, heading in HEADINGS.items()
    }
    return functions_figure(omega, panels, loop.gamma, loop.design.method)


def gangs_picture(loop: LoopFunctions, around: float | None = None) -> Figure:
    """The gang of four of a loop; ``around``: a frequency in rad/s to include."""
    omega = frequencies(loop.S, around=around)
    panels: dict[str, tuple[Array, Array | None]] = {}
    for name, heading in PICTURE_HEADINGS.items():
        proved = loop.bound(name, omega)
        allowed = proved / loop.gamma if proved is not None and np.isfinite(proved).all() else None
        panels[heading] = loop.gain(name, omega), allowed
    return functions_figure(omega, panels, loop.gamma, "closed loop")
