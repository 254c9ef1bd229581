"""Figures of a comparison: where it disagrees at a glance, over time, over speed, over frequency, residual tests.

And of the linear part of a record and what is beyond it: its frequency response, and the lines of a periodic one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.identification.comparison.comparison_result import Comparison
from robustlab.identification.comparison.error_analysis import Bin
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    chosen,
    headroom,
    house_style,
    logarithmic,
    new_figure,
    plain_label,
    stem,
    zero_line,
)

FEW_LINES = 60  # drawn with a marker each
MOST_INPUTS = 3  # beside each other
SHOWN_BEYOND = 3.0  # times the highest excited line
FEWEST_SHOWN = 20  # lines
BINS_PER_DECADE = 30  # densities are drawn as their means over such bins of frequency
DECADES = 12  # shown below the largest density
CYCLE = [COLOURS[key] for key in ("nominal", "good", "worst")]  # of as many inputs
MEASURED, FREE, WINDOWED = COLOURS["measured"], COLOURS["worst"], COLOURS["nominal"]


def comparison_figures(comparison: Comparison) -> dict[str, Figure]:
    """All figures of a comparison, for every output q; an output whose name is no plain word is called by its number.

    ``where-q``, ``time-q``, ``speed-q`` (where a speed is known), ``spectrum-q`` (where the free run is whole),
    ``response-q`` (where the record gives a frequency response), ``residual-q``; and once ``harmonics`` (where the
    excitation allows the test) and ``outputs`` (where there are several).
    """
    figures: dict[str, Figure] = {}
    for k, output in enumerate(comparison.outputs, start=1):
        name = stem(output, k)
        figures[f"where-{name}"] = where_figure(comparison, output)
        figures[f"time-{name}"] = time_figure(comparison, output)
        if output in comparison.speed:
            figures[f"speed-{name}"] = speed_figure(comparison, output)
        if output in comparison.frequency:
            figures[f"spectrum-{name}"] = spectrum_figure(comparison, output)
        if comparison.linear.get(output):
            figures[f"response-{name}"] = response_figure(comparison, output)
        figures[f"residual-{name}"] = residual_figure(comparison, output)
    if len(comparison.outputs) > 1:
        figures["outputs"] = outputs_figure(comparison)
    if comparison.nonlinearity.signals:
        figures["harmonics"] = harmonics_figure(comparison)
    return figures


def where_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """RMS of the windowed error over time, direction, speed, position and input, on one scale; and frequency.

    The largest of each panel is orange; the green line is the noise of a sample where the record repeats. Panels that
    need a speed or a position which is not recorded are left out.
    """
    output = chosen(list(comparison.outputs), output, "output")
    panels = _where_panels(comparison, output)
    count = len(panels) + (output in comparison.frequency)
    figure, axes = new_figure(1 + (count + 1) // 2, 2, width=8.2, height=2.15)
    w, gap, unit = comparison.windows[output], comparison.outputs[output], comparison.outputs[output].unit
    noise = comparison.against_noise.get(output)
    with house_style():
        wide = _joined(figure, axes)
        _worst_bars(wide, np.append(w.start, w.stop[-1]), w.windowed_rms)
        wide.set_xlabel("time [s]")
        floor = "" if noise is None else f", noise {noise.std:.2g} {unit}"
        where = f"{comparison.model} misses {output} of {comparison.record}: rms {gap.windowed_rms:.3g} {unit}{floor}"
        wide.set_title(plain_label(f"{where}, windows of {comparison.window:.3g} s"))
        used = [wide, *axes[2 : 2 + len(panels)]]
        for panel, (name, of, bins) in zip(used[1:], panels, strict=True):
            _worst_bars(panel, np.array([bins[0].low, *(b.high for b in bins)]), np.array([b.rms for b in bins]))
            panel.set_xlabel(axis_label(name, of))
            worst = max(bins, key=lambda b: b.rms)
            panel.set_title(plain_label(f"largest at {name} {worst.low:.3g} to {worst.high:.3g} {of}".rstrip()))
        if output in comparison.direction:
            _name_directions(used[1], comparison.direction[output])
        for panel in used:
            panel.set_ylabel(axis_label("rms error", unit))
            if noise is not None and noise.std > 0:
                panel.axhline(noise.std, color=COLOURS["good"], lw=1.2, ls=(0, (4, 2)))
        top = 1.1 * max(p.dataLim.y1 for p in used) or 1.0
        for panel in used:
            panel.set_ylim(0.0, top)
        if output in comparison.frequency:
            _band_bars(axes[2 + len(panels)], comparison, output)
        for panel in axes[2 + count :]:
            panel.remove()
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
    amplitudes = comparison.amplitude[output].items()
    return [*panels, *((f"|{name}|", comparison.measured.unit(name), bins) for name, bins in amplitudes)]


def _name_directions(axes: Axes, direction: Mapping[str, Bin]) -> None:
    axes.set_xticks([0.5, 1.5, 2.5], list(direction))
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("direction (title: shares of the squared error)")
    axes.set_title(", ".join(f"{name} {100 * d.share:.0f} %" for name, d in direction.items()))


def _joined(figure: Figure, axes: list[Axes]) -> Axes:
    grid = axes[0].get_gridspec()
    for panel in axes[:2]:
        panel.remove()
    if grid is None:  # made by `subplots`: there is one
        raise ValueError("axes without a grid")
    return figure.add_subplot(grid[0, :])


def _worst_bars(axes: Axes, edges: Array, rms: Array) -> None:
    colours = [FREE if k == int(rms.argmax()) else COLOURS["band"] for k in range(len(rms))]
    width = np.diff(edges)
    axes.bar(edges[:-1] + 0.5 * width, rms, width=0.94 * width, color=colours, lw=0)
    axes.set_xlim(edges[0], edges[-1])


def _band_bars(axes: Axes, comparison: Comparison, output: str) -> None:
    s = comparison.frequency[output]
    _worst_bars(axes, np.arange(len(s.bands), dtype=float), 100 * s.error_share)
    axes.set_xticks(np.arange(len(s.bands)), [f"{edge:.3g}" for edge in s.bands])
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("share of square [%]")
    top = int(s.error_share.argmax())
    axes.set_title(f"free run: {100 * s.error_share[top]:.0f} % at {s.bands[top]:.3g} to {s.bands[top + 1]:.3g} Hz")


def time_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Recorded and simulated output, the error of the free run, the error of the windows with the worst one shaded."""
    output = chosen(list(comparison.outputs), output, "output")
    t, unit = comparison.measured.t, comparison.outputs[output].unit
    y, windowed = (r.outputs[output] for r in (comparison.measured, comparison.windowed))
    run = comparison.simulated
    free = np.zeros(0) if run is None else run.outputs[output]
    n = len(free)
    gap, windows = comparison.outputs[output], comparison.windows[output]
    figure, (above, middle, below) = new_figure(3, 1, width=7.6, height=2.0, sharex=True)
    with house_style():
        above.plot(t[:n], free, color=FREE, lw=1.3, ls=(0, (5, 1.5)), label="simulated, free run")
        above.plot(t, y, color=MEASURED, lw=1.3, label="record")
        above.set_ylabel(axis_label(output, unit))
        above.set_title(plain_label(f"{comparison.model} against {comparison.record}"))
        above.legend(loc="lower left", bbox_to_anchor=(0.0, -0.02), ncols=2)
        headroom(above, below=0.22)
        middle.plot(t[:n], y[:n] - free, color=FREE, lw=1.2)
        middle.set_ylabel(axis_label("error", unit))
        middle.set_title(
            f"free run: rms {gap.rms_percent:.3g} %, peak {gap.peak_percent:.3g} % of the range"
            if comparison.free_run.whole
            else plain_label(f"free run: ends at {comparison.free_run.end:.4g} s")
        )
        below.axvspan(
            windows.start[windows.worst],
            windows.stop[windows.worst],
            color=COLOURS["limit"],
            alpha=0.3,
            lw=0,
            label="worst window",
        )
        below.plot(t, y - windowed, color=WINDOWED, lw=0.9)
        below.set_ylabel(axis_label("error", unit))
        below.set_title(
            f"windows of {comparison.window:.3g} s, each from its best start: "
            f"rms {gap.windowed_rms_percent:.3g} %, peak {gap.windowed_peak_percent:.3g} %"
        )
        headroom(below, above=0.25)
        below.legend(loc="upper left", bbox_to_anchor=(0.0, 1.04))
        below.set_xlabel("time [s]")
        below.set_xlim(t[0], t[-1])
        for axes in (middle, below):
            zero_line(axes)
    return figure


def speed_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Windowed error over speed and direction, and over the same speed what would have to be added at the input or
    joint that explains the error.
    """
    output = chosen(list(comparison.speed), output, "output")
    motion, unit = comparison.motions[output], comparison.outputs[output].unit
    own = [d for d in comparison.located if d.speed_source == motion.speed_source]
    figure, axes = new_figure(1, 1 + len(own), width=4.4 * (1 + len(own)), height=3.4)
    with house_style():
        _bars(axes[0], comparison.speed[output], motion.speed_unit)
        axes[0].set_ylabel(axis_label("windowed error", unit))
        axes[0].set_title(f"error of {plain_label(output)} in windows of {comparison.window:.3g} s")
        for panel, d in zip(axes[1:], own, strict=True):
            some = slice(None, None, max(1, len(d.value) // 1000))
            speed, value = np.zeros(0) if d.speed is None else d.speed[some], d.value[some]
            zero_line(panel)
            panel.axvline(0.0, color="#888888", lw=0.8)
            for colour, way in ((FREE, speed < 0), (WINDOWED, speed >= 0)):
                panel.plot(speed[way], value[way], "o", ms=3.0, alpha=0.6, color=colour, mew=0)
            panel.set_ylabel(axis_label("what is lacking", d.unit))
            panel.set_title(plain_label(d.place))
        for panel in axes:
            panel.set_xlabel(axis_label("speed", motion.speed_unit))
    return figure


def spectrum_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Power spectral densities of recorded output, free run and error; below, the coherence of
    the inputs (of many those with the largest) with the error.
    """
    output = chosen(list(comparison.frequency), output, "output")
    s, unit = comparison.frequency[output], comparison.outputs[output].unit or "unit"
    f = s.frequency[1:]  # frequency 0 has no place on a logarithmic axis
    figure, (above, below) = new_figure(2, 1, width=7.6, height=2.7, sharex=True)
    with house_style():
        curves = (
            (s.measured, MEASURED, "-", "record"),
            (s.simulated, FREE, (0, (5, 1.5)), "simulated, free run"),
            (s.error, WINDOWED, "-", "error of the free run"),
        )
        top = max(float(density[1:].max()) for density, *_ in curves)
        for density, colour, line, label in curves:
            if density[1:].any():
                above.loglog(*_smoothed(f, density[1:]), color=colour, ls=line, lw=1.3, label=label)
        if top > 0:
            above.set_ylim(bottom=max(above.get_ylim()[0], top * 10.0**-DECADES))
        above.set_ylabel(f"density [{plain_label(unit)}²/Hz]")
        above.set_title("where in frequency")
        if top > 0:
            above.legend(loc="lower left", ncols=1)
            logarithmic(above.yaxis)
        most = sorted(s.coherence, key=lambda name: -float(s.coherence[name].mean()))[:MOST_INPUTS]
        drawn = {name: coherence for name, coherence in s.coherence.items() if name in most}
        for (name, coherence), colour in zip(drawn.items(), CYCLE, strict=False):
            label = f"{plain_label(name)} with the error (mean over narrow bands)"
            below.semilogx(*_smoothed(f, coherence[1:]), color=colour, lw=1.2, label=label)
        below.axhline(
            s.coherence_level,
            color=COLOURS["limit"],
            ls=(0, (4, 2)),
            lw=1.2,
            label="99 % of independent signals lie below",
        )
        below.set_ylim(0.0, 1.3)
        below.set_yticks([0.0, 0.5, 1.0])
        below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        below.set_ylabel("coherence")
        below.set_xlabel("frequency [Hz]")
        below.legend(loc="upper left", ncols=2)
        below.set_xlim(f[0], f[-1])
    return figure


def residual_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Autocorrelation of the recursive residual and its correlation with each input, with 99 % bands; of many inputs
    with those that explain most of it.
    """
    output = chosen(list(comparison.residual), output, "output")
    tests = comparison.residual[output]
    most = sorted(tests.inputs, key=lambda name: -tests.inputs[name].explained_share)[:MOST_INPUTS]
    drawn = {name: test for name, test in tests.inputs.items() if name in most}
    figure, axes = new_figure(1, 1 + len(drawn), width=4.4 * (1 + len(drawn)), height=3.2)
    with house_style():
        w = tests.whiteness
        _stems(axes[0], w.lags, w.autocorrelation, w.band)
        axes[0].set_title(f"residual of {plain_label(output)} with itself")
        axes[0].set_ylabel("correlation")
        axes[0].set_ylim(min(-0.1, 1.1 * float(w.autocorrelation.min())), 1.05)
        for panel, (name, test) in zip(axes[1:], drawn.items(), strict=True):
            _stems(panel, test.lags, test.correlation, test.band)
            panel.set_title(f"residual of {plain_label(output)} with input {plain_label(name)}")
            size = 1.15 * max(test.band, float(np.abs(test.correlation).max()))
            panel.set_ylim(-size, size)
        for panel in axes:
            panel.set_xlabel("lag [samples]")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center")
    return figure


def outputs_figure(comparison: Comparison) -> Figure:
    """RMS of the windowed error of all outputs, in percent of their ranges and, of a nonlinear plant, in multiples of
    their sensors' scatter.
    """
    gaps = comparison.outputs
    noise = comparison.sensor_noise
    scales = [("rms error [% of range]", [g.windowed_rms_percent for g in gaps.values()])]
    if noise:
        scales.append(("rms error / scatter", [g.windowed_rms / noise[name] for name, g in gaps.items()]))
    figure, axes = new_figure(len(scales), 1, width=7.6, height=2.2, sharex=True)
    with house_style():
        for panel, (label, values) in zip(axes, scales, strict=True):
            _worst_bars(panel, np.arange(len(gaps) + 1) - 0.5, np.nan_to_num(np.array(values)))
            panel.set_ylabel(label)
        if noise:
            axes[1].axhline(1.0, color=COLOURS["good"], lw=1.2, ls=(0, (4, 2)))
            axes[1].set_title("in multiples of what the samples scatter about a smooth motion (green)")
        head = f"{comparison.model} against {comparison.record}: windows of {comparison.window:.3g} s"
        axes[0].set_title(plain_label(head))
        axes[-1].set_xticks(range(len(gaps)), [plain_label(name) for name in gaps])
        axes[-1].set_xlabel("output")
    return figure


def response_figure(comparison: Comparison, output: str | None = None) -> Figure:
    """Magnitude, phase and coherence of the recorded response from each input, beside the model's."""
    output = chosen([y for y, row in comparison.linear.items() if row], output, "output")
    row = comparison.linear[output]
    figure, axes = new_figure(
        3, len(row), width=max(7.6, 4.6 * len(row)), height=2.2, sharex="col", gridspec_kw={"height_ratios": [3, 2, 2]}
    )
    with house_style():
        for j, (u, g) in enumerate(row.items()):
            above, middle, below = axes[j :: len(row)]
            few = len(g.frequency) <= FEW_LINES
            f, marker = g.frequency, "o" if few else ""
            # Of many lines, those whose deviation is larger than they are say nothing.
            size = np.where(few | (g.std < np.abs(g.response)), np.abs(g.response), np.nan)
            bottom = 0.3 * float(np.nanmin(np.append(size[size > 0], np.abs(g.model).min() or np.nan)))
            if g.noise_std is not None and (g.noise_std > 0).any():
                bottom = min(bottom, 0.5 * float(g.noise_std[g.noise_std > 0].min()))
            above.fill_between(
                f, np.maximum(size - 2 * g.std, bottom), size + 2 * g.std, color=COLOURS["band"], alpha=0.35, lw=0
            )
            above.fill_between([], [], [], color=COLOURS["band"], alpha=0.35, lw=0, label="± 2 std")
            above.plot(f, size, color=COLOURS["measured"], marker=marker, ms=3, lw=1.2, label="record")
            above.plot(f, np.abs(g.model), color=COLOURS["worst"], ls=(0, (5, 1.5)), lw=1.4, label="model")
            for level, key, label in (
                (g.nonlinear_std, "limit", "nonlinear distortion"),
                (g.noise_std, "good", "noise"),
            ):
                if level is not None and (level > 0).any():
                    above.plot(f, np.where(level > 0, level, np.nan), color=COLOURS[key], lw=1.2, label=label)
            logarithmic(above.yaxis)
            above.set_ylim(bottom, 3.0 * float(np.nanmax(np.append(size, np.abs(g.model)))))
            units = comparison.outputs[output].unit or "1", comparison.measured.unit(u) or "1"
            above.set_ylabel(plain_label(f"magnitude [{units[0]}/{units[1]}]"))
            above.set_title(plain_label(f"{u} to {output}: best linear approximation ({g.method})"))
            above.legend(loc="best", ncols=2)
            for values, colour, line in (
                (np.where(np.isfinite(size), g.response, np.nan), COLOURS["measured"], "-"),
                (g.model, COLOURS["worst"], (0, (5, 1.5))),
            ):
                middle.plot(f, _near(np.angle(g.model), np.angle(values)), color=colour, ls=line, lw=1.2)
            middle.set_ylabel("phase [degrees]")
            below.plot(f, g.coherence, color=COLOURS["nominal"], marker=marker, ms=3, lw=1.2)
            below.set_ylim(-0.03, 1.05)
            below.set_ylabel("coherence")
            below.set_xlabel("frequency [Hz]")
            below.set_xscale("log")
            below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            below.xaxis.set_minor_formatter(NullFormatter())
            below.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
            if len(f) > 1:
                below.set_xlim(f[0], f[-1])
    return figure


def harmonics_figure(comparison: Comparison) -> Figure:
    """Lines of every judged signal: excited, even and odd ones that are not, over the noise."""
    test = comparison.nonlinearity
    if not test.signals:
        raise InputError("plot('harmonics')", test.reason or "no test", "a periodic excitation")
    figure, axes = new_figure(len(test.signals), 1, width=7.6, height=2.6, sharex=True)
    kinds = ((0, "excited", "measured", "o"), (1, "even", "worst", "s"), (2, "odd, not excited", "nominal", "D"))
    with house_style():
        for panel, (name, s) in zip(axes, test.signals.items(), strict=True):
            excited = s.frequency[s.kind == 0]
            shown = s.frequency <= max(SHOWN_BEYOND * excited.max(), FEWEST_SHOWN * s.frequency[0])
            for kind, label, colour, marker in kinds:
                some = shown & (s.kind == kind) & (s.amplitude > 0)
                panel.plot(
                    s.frequency[some], s.amplitude[some], marker, ms=4, mew=0, color=COLOURS[colour], label=label
                )
            some = shown & (s.noise > 0)
            panel.plot(s.frequency[some], s.noise[some], "-", lw=1.0, color=COLOURS["good"], label="noise alone")
            logarithmic(panel.yaxis)
            top = float(s.amplitude[shown].max())
            panel.set_ylim(bottom=max(panel.get_ylim()[0], 1e-9 * top), top=5.0 * top)
            unit = comparison.measured.units.get(name, "")
            panel.set_ylabel(axis_label("amplitude", unit))
            panel.set_title(plain_label(f"{name}: {s.words()} of its power is nonlinear"))
        axes[0].legend(loc="upper right", ncols=4)
        axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _near(reference: Array, angle: Array) -> Array:
    """Angles in degrees, each within half a turn of the unwrapped ``reference``."""
    unwrapped = np.unwrap(reference)
    return np.degrees(unwrapped + np.angle(np.exp(1j * (angle - unwrapped))))


def _smoothed(f: Array, values: Array) -> tuple[Array, Array]:
    """Means over bins of equal width on a logarithmic axis; where frequencies are sparse, each is its own bin."""
    index = np.floor(BINS_PER_DECADE * np.log10(f / f[0])).astype(int)
    count = np.bincount(index)
    filled = count > 0
    means = [np.bincount(index, weights=x)[filled] / count[filled] for x in (f, values)]
    return means[0], means[1]


def _bars(axes: Axes, bins: tuple[Bin, ...], unit: str) -> None:
    """RMS per bin as bars and the mean as dots; backward and forward in two colours."""
    for b in bins:
        middle, width = 0.5 * (b.low + b.high), b.high - b.low
        colour = COLOURS["sample"] if b.low < 0 < b.high else (FREE if middle < 0 else WINDOWED)
        axes.bar(middle, b.rms, width=0.94 * width, color=colour, alpha=0.55, lw=0)
        if b.samples:
            axes.plot(middle, b.mean, "o", color=MEASURED, ms=3.5)
    axes.plot([], [], "s", color=FREE, alpha=0.55, label="rms backward")
    axes.plot([], [], "s", color=WINDOWED, alpha=0.55, label="rms forward")
    axes.plot([], [], "o", color=MEASURED, ms=3.5, label="mean")
    zero_line(axes)
    headroom(axes, above=0.22)
    axes.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.3)


def _stems(axes: Axes, lags: NDArray[np.int_], values: Array, band: float) -> None:
    axes.axhspan(-band, band, color=COLOURS["band"], alpha=0.3, lw=0, label="99 % band if the model were right")
    axes.vlines(lags, 0.0, values, color=COLOURS["nominal"], lw=1.1)
    axes.plot(lags, values, "o", color=COLOURS["nominal"], ms=2.6)
    zero_line(axes)
