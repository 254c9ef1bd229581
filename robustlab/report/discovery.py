"""Figures of a comparison and of a discovery, and the page of a discovery (``robustlab data discover --out``)."""

from __future__ import annotations

import math
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.identification.comparison.comparison import Comparison
from robustlab.identification.comparison.error_analysis import Bin
from robustlab.identification.greybox.residual_force import ForceCurve, ResidualForce
from robustlab.identification.missing_effects.discovery_result import Discovery, Gap
from robustlab.provenance import Provenance
from robustlab.report import style
from robustlab.report.drawings import pictures_of
from robustlab.report.html import render
from robustlab.result import plain

MODELS = {"nominal": style.WORST, "refitted": style.SAMPLE, "updated": style.NOMINAL}
DASHES: dict[str, Any] = {"nominal": (0, (4, 1.5)), "refitted": (0, (1, 1)), "updated": "-"}
BEYOND = 0.6  # of the measured range, drawn above and below it
ORDER = ("speed", "position", "time", "input")  # of the panels
ASIDE = 0.03  # share of the bands' ends outside the vertical axis on either side
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
        f"windows of {comparison.window:.3g} s, each with fitted initial states: "
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
    _rms_bars(axes[0], comparison.speed[output])
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


def _rms_bars(axes: Axes, bins: tuple[Bin, ...]) -> None:
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


@style.house_style()
def gap_figure(discovery: Discovery) -> Figure:
    """For every output: bars of the held-out error of the three models in windows and in free run."""
    d = discovery
    sides = [(d.gaps, f"windows of {d.window:.3g} s")]
    if d.free_run:
        sides.append((d.free_run, d.whole_run))
    figure, axes = style.new_figure(len(d.gaps), len(sides), 8.4, 1.9)
    for k, name in enumerate(d.gaps):
        for panel, (gaps, how) in zip(axes[len(sides) * k :], sides, strict=False):
            if name in gaps:
                _bars(panel, gaps[name], f"{name}: {how}")
            else:
                panel.remove()
    title = fill(style.plain_label(f"{d.headline()}.").replace("->", "→"), 104)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def _bars(axes: Axes, gap: Gap, title: str) -> None:
    """Draw the errors of the three models with their share of the range; a diverging one as a hatched bar."""
    values = [getattr(gap, model) for model in MODELS]
    longest = max((v for v in values if math.isfinite(v)), default=1.0) or 1.0
    for row, (value, (model, colour)) in enumerate(zip(values, MODELS.items(), strict=True)):
        finite = math.isfinite(value)
        end = value if finite else 1.1 * longest
        axes.barh(row, end, color=colour, height=0.62, hatch="" if finite else "///")
        share = f"{100 * value / gap.range:.3g} %" if gap.range > 0 else f"{value:.3g}"
        side: dict[str, Any] = {"xytext": (4, 0), "ha": "left"} if finite else {"xytext": (-4, 0), "ha": "right"}
        text = share if finite else f"{model} diverges"
        axes.annotate(text, (end, row), textcoords="offset points", va="center", fontsize=8.5, **side)
    axes.set_yticks(range(len(values)), list(MODELS))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    label = style.axis_label("rms error", gap.unit)
    axes.set(xlim=(0.0, 1.4 * longest), xlabel=label, title=style.plain_label(title))
    axes.xaxis.set_major_locator(MaxNLocator(3))


def free_run_figure(discovery: Discovery, output: str | None = None) -> Figure:
    """One held-out record simulated from its start to its end: signals above, errors below."""
    d, run = discovery, discovery.series.get("free_run", {})
    output = style.chosen([name for name in run.get("outputs", {}) if name in d.free_run], output, "output")
    signals = {key: np.asarray(values) for key, values in run["outputs"][output].items()}
    title = f"{output} of {run['record']}: {d.whole_run} from the record's start"
    return _signals_and_errors(np.asarray(run["t"]), signals, d.free_run[output], title)


@style.house_style()
def _signals_and_errors(x: Array, signals: dict[str, Array], gap: Gap, title: str) -> Figure:
    """Draw record and models over time, the errors of all three, and that of the updated one on its own scale."""
    figure, (above, middle, below) = style.new_figure(3, 1, width=7.8, height=2.0, sharex=True)
    measured = signals["measured"]
    above.plot(x, measured, color=style.MEASURED, lw=2.4, alpha=0.45, label="record")
    for model, colour in MODELS.items():
        above.plot(x, signals[model], color=colour, lw=1.2, ls=DASHES[model], label=model)
        middle.plot(x, measured - signals[model], color=colour, lw=1.0)
    below.plot(x, measured - signals["updated"], color=MODELS["updated"], lw=1.0)
    _keep_near(above, measured)
    _keep_near(middle, measured - signals["refitted"], measured - signals["updated"], np.zeros(1))
    above.set(ylabel=style.axis_label(gap.output, gap.unit), title=style.plain_label(title))
    above.legend(loc="lower left", bbox_to_anchor=(0.0, -0.03), ncols=4)
    style.headroom(above, below=0.22)
    rms = ", ".join(f"{model} {getattr(gap, model):.3g}" for model in MODELS).replace("inf", "diverges")
    middle.set_title(style.plain_label(f"record minus simulation: rms {rms} {gap.unit}"))
    span = float(np.nanmin(x)), float(np.nanmax(x))
    below.set(title="updated alone, on a scale of its own", xlabel="time [s]", xlim=span)
    for panel in (middle, below):
        style.zero_line(panel)
        panel.set_ylabel(style.axis_label("error", gap.unit))
    return figure


def _keep_near(axes: Axes, *shown: Array) -> None:
    """Limit the axis to these curves and a margin."""
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (-1.0, 1.0)
    room = BEYOND * (high - low) or 1.0
    old = axes.get_ylim()
    axes.set_ylim(max(old[0], low - room), min(old[1], high + room))


@style.house_style()
def force_of(discovery: Discovery) -> Figure:
    """The missing force over speed, position, time and input, before and after; the share that each explains."""
    residual, before = discovery.residual_force, discovery.missing_force
    if residual is None or not residual.curves:
        raise InputError("plot('force')", "no force is known", "a discovery that smoothed the missing force")
    curves = sorted(
        residual.curves.values(),
        key=lambda curve: next((k for k, name in enumerate(ORDER) if curve.coordinate.startswith(name)), len(ORDER)),
    )
    earlier = before.curves if before is not None else {}
    figure, panels = style.new_figure(math.ceil((len(curves) + 1) / 2), 2, width=8.4, height=2.7)
    height = _limits([*curves, *earlier.values()])
    for panel, curve in zip(panels, curves, strict=False):
        style.zero_line(panel)
        name, old = style.plain_label(curve.coordinate), earlier.get(curve.coordinate)
        share = f"{100 * curve.share:.0f} %"
        if old is not None:
            _curve(panel, old, style.WORST, 0.2, style.WORST, "refitted, ")
            share = f"{100 * old.share:.0f} % → {share}"
        _curve(panel, curve, style.BAND, 0.35, style.NOMINAL, "updated, " if earlier else "")
        edge = 0.05 * float(np.ptp(curve.x)) or 1.0
        panel.set(
            title=f"{name}: explains {share}",
            xlim=(float(curve.x.min()) - edge, float(curve.x.max()) + edge),
            ylim=height,
            xlabel=style.axis_label(curve.coordinate, curve.unit),
            ylabel=style.axis_label("missing force", residual.unit),
        )
    _shares(panels[len(curves)], residual, before)
    for panel in panels[len(curves) + 1 :]:
        panel.set_visible(False)
    return style.legend_below(figure, panels[: len(curves)], 2 if earlier else 3)


def _limits(curves: list[ForceCurve]) -> tuple[float, float]:
    """Return one scale for all panels, without single bins that have a giant band."""
    ends = np.concatenate([end for c in curves for end in (c.low, c.high)])
    middles = np.concatenate([c.value for c in curves])
    low, high = np.quantile(ends, [ASIDE, 1.0 - ASIDE])
    low, high = min(float(low), float(middles.min()), 0.0), max(float(high), float(middles.max()), 0.0)
    edge = 0.06 * (high - low) or 1.0
    return low - edge, high + edge


def _curve(panel: Axes, curve: ForceCurve, band: str, alpha: float, colour: str, whose: str) -> None:
    # A line across zero speed would hide the jump there.
    sides = (curve.x < 0, curve.x >= 0) if curve.coordinate.lower().startswith("speed") else (curve.x == curve.x,)
    for k, side in enumerate(sides):
        x, low, high, value = (part[side] for part in (curve.x, curve.low, curve.high, curve.value))
        label = (f"{whose}95 % band", f"{whose}mean over a bin") if k == 0 else (None, None)
        panel.fill_between(x, low, high, color=band, alpha=alpha, lw=0, label=label[0])
        panel.plot(x, value, "o-", ms=2.8, lw=1.2, color=colour, label=label[1])
    if len(sides) == 2:
        panel.axvline(0.0, color="#888888", lw=0.8)


def _shares(panel: Axes, residual: ResidualForce, before: ResidualForce | None) -> None:
    rows = [(f"f({name})", 100 * curve.share, style.NOMINAL) for name, curve in residual.curves.items()]
    rows.append(("noise of the estimate", 100 * residual.noise_share, style.SAMPLE))
    place = np.arange(len(rows))[::-1]
    bars = panel.barh(place, [share for _, share, _ in rows], color=[colour for *_, colour in rows], height=0.65)
    panel.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
    panel.set_yticks(place, [style.plain_label(label) for label, *_ in rows], fontsize=8)
    fell = "" if before is None else f" (rms {before.rms:.3g} → {residual.rms:.3g} {residual.unit})"
    panel.set(xlim=(0, 112), xticks=[0, 25, 50, 75, 100], title=f"what explains it{fell}")
    panel.set_xlabel("share of the variance, held-out [%]")
    panel.grid(axis="y", visible=False)


TONES = {
    "named": ("good", "✓"),
    "no missing effect": ("good", "✓"),
    "ambiguous": ("warn", "?"),
    "unknown": ("warn", "?"),
}
MEANINGS = {
    "named": "The named effects have a probability of 95 % or more, in any form, and reduce the held-out error.",
    "no missing effect": "The differences are within the tolerances of the parameters and the noise of the sensors.",
    "ambiguous": "Effects of several kinds explain the missing part equally well; see the next experiment.",
    "unknown": "Something is missing that no effect of the catalogue explains; see the residual force.",
}


def write_page(d: Discovery, folder: Path, provenance: Provenance) -> list[Path]:
    """Write ``folder/figures`` and ``folder/report.html``; return the paths, the page last."""
    pictures = dict(pictures_of(d))
    files = [path for name, p in pictures.items() for path in style.save_figure(p.figure, folder / "figures", name)]
    tone, mark = TONES[d.verdict] if d.complete or d.verdict != "named" else ("warn", "!")
    page = {
        "verdict": {"tone": tone, "mark": mark, "headline": f"{d.headline()}.", "detail": MEANINGS[d.verdict]},
        "requirements": [],
        "steps": [
            {
                "name": "discover", "do": "discover", "title": f"{d.plant} against {', '.join(d.records)}",
                "status": str(d.status), "trustworthy": d.status.trustworthy, "summary": f"{d.headline()}.",
                "error": "", "numbers": plain(d.to_json()), "text": d.tables(),
                "facts": [{"label": label, "value": value, "source": ""} for label, value in d.facts()],
                "notes": [f.message for f in d.findings],
                "figures": [{"stem": name, "caption": p.caption} for name, p in pictures.items()],
            }
        ],
        "recipe": {
            "name": "data discover", "title": f"What {d.plant} lacks", "description": "", "text": "", "overrides": {},
        },
        "seconds": d.seconds, "seed": 0, "provenance": provenance.to_json(),
    }  # fmt: skip
    path = folder / "report.html"
    path.write_text(render(page, folder), encoding="utf-8")
    return [*files, path]
