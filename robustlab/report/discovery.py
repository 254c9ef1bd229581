"""Figures, summary and page of a discovery for ``robustlab data discover --out``."""

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
from robustlab.identification.missing_effects.discovery_result import Discovery, Gap
from robustlab.identification.missing_effects.residual_force import ForceCurve, ResidualForce
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
    style.legend_below(figure, panels[: len(curves)], 2 if earlier else 3)
    return figure


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
