"""Figures of a comparison: error by condition and frequency, over time and over speed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.identification.comparison.comparison import Comparison
from robustlab.identification.comparison.error_analysis import Bin
from robustlab.report import style

FREE, WINDOWED = style.WORST, style.NOMINAL
FREE_RUN: dict[str, Any] = {"color": FREE, "ls": style.DASHED, "label": "simulated, free run"}


@style.house_style()
def where_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """RMS of the windowed error over time, direction, speed and position, on one scale; and frequency.

    The largest of each panel is orange; the green line is the noise of a sample where the record repeats. Panels that
    need a speed or a position which is not recorded are left out.
    """
    output = style.chosen(list(comparison.outputs), output, "output")
    panels = _where_panels(comparison, output)
    spectrum = comparison.frequency.get(output)
    w, gap, unit = comparison.windows[output], comparison.outputs[output], comparison.outputs[output].unit
    noise = comparison.noise.std[output] if comparison.noise else None
    count = 1 + len(panels) + (spectrum is not None)
    figure, axes = style.new_figure((count + 1) // 2, 2, width=8.2, height=2.15)
    _worst_bars(axes[0], np.append(w.start, w.stop[-1]), w.windowed_rms)
    axes[0].set(xlabel="time [s]", title=f"windows of {comparison.window:.3g} s")
    for panel, (name, of, bins) in zip(axes[1:], panels, strict=False):
        _worst_bars(panel, np.array([bins[0].low, *(b.high for b in bins)]), np.array([b.rms for b in bins]))
        worst = max(bins, key=lambda b: b.rms)
        title = f"largest at {name} {worst.low:.3g} to {worst.high:.3g} {of}".rstrip()
        panel.set(xlabel=style.axis_label(name, of), title=style.plain_label(title))
    sides = comparison.direction.get(output)
    if sides:
        axes[1].set_xticks([0.5, 1.5, 2.5], list(sides))
        axes[1].grid(visible=False, axis="x")
        title = ", ".join(f"{name} {100 * d.share:.0f} %" for name, d in sides.items())
        axes[1].set(xlabel="direction (title: shares of the squared error)", title=title)
    used = axes[: 1 + len(panels)]
    top = 1.1 * max(p.dataLim.y1 for p in used) or 1.0
    for panel in used:
        panel.set(ylabel=style.axis_label("rms error", unit), ylim=(0.0, top))
        if noise:
            panel.axhline(noise, color=style.GOOD, lw=1.2, ls=(0, (4, 2)))
    if spectrum is not None:
        share, edges = spectrum.error_share, spectrum.bands
        most = int(share.argmax())
        _worst_bars(axes[count - 1], np.arange(len(edges), dtype=float), 100 * share)
        axes[count - 1].set_xticks(np.arange(len(edges)), [f"{edge:.3g}" for edge in edges])
        title = f"free run: {100 * share[most]:.0f} % at {edges[most]:.3g} to {edges[most + 1]:.3g} Hz"
        axes[count - 1].set(xlabel="frequency [Hz]", ylabel="share of square [%]", title=title)
    for panel in axes[count:]:
        panel.remove()
    floor = "" if noise is None else f", noise {noise:.2g} {unit}"
    where = f"{comparison.model} misses {output} of {comparison.record}: rms {gap.windowed_rms:.3g} {unit}{floor}"
    figure.suptitle(style.plain_label(where), x=0.01, ha="left", fontsize=10, fontweight="bold")
    return figure


def _where_panels(comparison: Comparison, output: str) -> list[tuple[str, str, tuple[Bin, ...]]]:
    motion = comparison.motions[output]
    panels: list[tuple[str, str, tuple[Bin, ...]]] = []
    if output in comparison.direction:
        sides = enumerate(comparison.direction[output].values())
        panels.append(("", "", tuple(Bin(k, k + 1, d.samples, d.mean, d.rms, d.share) for k, d in sides)))
        panels.append(("speed", motion.speed_unit, comparison.speed[output]))
    if output in comparison.position:
        panels.append((motion.position_name, motion.position_unit, comparison.position[output]))
    return panels


def _worst_bars(axes: Axes, edges: Array, rms: Array) -> None:
    colours = [FREE if k == int(rms.argmax()) else style.BAND for k in range(len(rms))]
    width = np.diff(edges)
    axes.bar(edges[:-1] + 0.5 * width, rms, width=0.94 * width, color=colours, lw=0)
    axes.set_xlim(edges[0], edges[-1])


@style.house_style()
def time_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Recorded and simulated output, the error of the free run, the error of the windows with the worst one shaded."""
    output = style.chosen(list(comparison.outputs), output, "output")
    t, gap, windows = comparison.measured.t, comparison.outputs[output], comparison.windows[output]
    y, windowed = (r.outputs[output] for r in (comparison.measured, comparison.windowed))
    free = np.zeros(0) if comparison.simulated is None else comparison.simulated.outputs[output]
    n = len(free)
    figure, (above, middle, below) = style.new_figure(3, 1, width=7.6, height=2.0, sharex=True)
    above.plot(t[:n], free, lw=1.3, **FREE_RUN)
    above.plot(t, y, color=style.MEASURED, lw=1.3, label="record")
    title = style.plain_label(f"{comparison.model} against {comparison.record}")
    above.set(ylabel=style.axis_label(output, gap.unit), title=title)
    above.legend(loc="lower left", bbox_to_anchor=(0.0, -0.02), ncols=2)
    style.headroom(above, below=0.22)
    middle.plot(t[:n], y[:n] - free, color=FREE, lw=1.2)
    end = style.plain_label(f"free run: ends at {comparison.free_run.end:.4g} s")
    whole = f"free run: rms {gap.rms_percent:.3g} %, peak {gap.peak_percent:.3g} % of the range"
    middle.set_title(whole if comparison.free_run.whole else end)
    worst = windows.start[windows.worst], windows.stop[windows.worst]
    below.axvspan(*worst, color=style.LIMIT, alpha=0.3, lw=0, label="worst window")
    below.plot(t, y - windowed, color=WINDOWED, lw=0.9)
    title = (
        f"windows of {comparison.window:.3g} s, each from its best start: "
        f"rms {gap.windowed_rms_percent:.3g} %, peak {gap.windowed_peak_percent:.3g} %"
    )
    below.set(title=title, xlabel="time [s]", xlim=(t[0], t[-1]))
    style.headroom(below, above=0.25)
    below.legend(loc="upper left", bbox_to_anchor=(0.0, 1.04))
    for axes in (middle, below):
        axes.set_ylabel(style.axis_label("error", gap.unit))
        style.zero_line(axes)
    return figure


@style.house_style()
def speed_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Windowed error over speed and direction, and the signal missing at the input or joint that explains it."""
    output = style.chosen(list(comparison.speed), output, "output")
    motion, unit = comparison.motions[output], comparison.outputs[output].unit
    own = [d for d in comparison.located if d.speed_source == motion.speed_source]
    figure, axes = style.new_figure(1, 1 + len(own), width=4.4 * (1 + len(own)), height=3.4)
    _bars(axes[0], comparison.speed[output])
    title = f"error of {style.plain_label(output)} in windows of {comparison.window:.3g} s"
    axes[0].set(ylabel=style.axis_label("windowed error", unit), title=title)
    for panel, d in zip(axes[1:], own, strict=True):
        some = slice(None, None, max(1, len(d.value) // 1000))
        speed, value = np.zeros(0) if d.speed is None else d.speed[some], d.value[some]
        style.zero_line(panel)
        panel.axvline(0.0, color="#888888", lw=0.8)
        for colour, way in ((FREE, speed < 0), (WINDOWED, speed >= 0)):
            panel.plot(speed[way], value[way], "o", ms=3.0, alpha=0.6, color=colour, mew=0)
        panel.set(ylabel=style.axis_label("what is lacking", d.unit), title=style.plain_label(d.place))
    for panel in axes:
        panel.set_xlabel(style.axis_label("speed", motion.speed_unit))
    return figure


def _bars(axes: Axes, bins: tuple[Bin, ...]) -> None:
    """RMS per bin as bars and the mean as dots; backward and forward in two colours."""
    for b in bins:
        middle, width = 0.5 * (b.low + b.high), b.high - b.low
        colour = style.SAMPLE if b.low < 0 < b.high else (FREE if middle < 0 else WINDOWED)
        axes.bar(middle, b.rms, width=0.94 * width, color=colour, alpha=0.55, lw=0)
        if b.samples:
            axes.plot(middle, b.mean, "o", color=style.MEASURED, ms=3.5)
    axes.plot([], [], "s", color=FREE, alpha=0.55, label="rms backward")
    axes.plot([], [], "s", color=WINDOWED, alpha=0.55, label="rms forward")
    axes.plot([], [], "o", color=style.MEASURED, ms=3.5, label="mean")
    style.zero_line(axes)
    style.headroom(axes, above=0.22)
    axes.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.3)
