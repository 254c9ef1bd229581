"""A discovery drawn and told: its figures, its facts, and its page for ``robustlab data discover --out``."""

from __future__ import annotations

import math
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.identification.naming.discovery_parts import LINEAR, Gap, SetProbability, chance, overall, with_interval
from robustlab.identification.naming.discovery_result import Discovery
from robustlab.identification.naming.residual_force import ForceCurve, ResidualForce
from robustlab.provenance import Provenance
from robustlab.report.drawings import caption_of
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    chosen,
    headroom,
    house_style,
    legend_below,
    new_figure,
    plain_label,
    save_figure,
    stem,
    zero_line,
)
from robustlab.report.html import render
from robustlab.result import plain

Index = NDArray[np.int_]

MODELS = {"nominal": COLOURS["worst"], "refitted": COLOURS["sample"], "updated": COLOURS["nominal"]}
STRETCH = 4  # windows shown of a held-out stretch
APART = 0.06  # of a window, between windows that do not follow each other
SHOWN = 9  # sets of effects
LONG_TITLE = 92
DRAWN = 4000  # samples of a curve
BEYOND = 0.6  # of the measured range, drawn of a model that leaves it
DASHES: dict[str, Any] = {"nominal": (0, (4, 1.5)), "refitted": (0, (1, 1)), "updated": "-"}

FREE, ALONG = "free run", "one run, linear about the recorded motion"
SHORT = {ALONG: "one linear run"}  # above narrow panels

WHOLE = "discovery.discovery_figures"  # of `robustlab.report.drawing_table`
COLUMNS = 2
ORDER = ("speed", "position", "time", "input")  # of the panels
ASIDE = 0.03  # of the bands' ends may lie outside the vertical axis on either side


def discovery_figures(discovery: Discovery) -> dict[str, Figure]:
    """``story``; ``run-q`` and ``stretch-q`` for every output q; ``posterior``; ``force`` where a force is known."""
    d = discovery
    figures = {"story": gap_figure(d)}
    for k, output in enumerate(d.series.get("free_run", {}).get("outputs", {}), start=1):
        if output in d.free_run:
            figures[f"run-{stem(output, k)}"] = free_run_figure(d, output)
    for k, output in enumerate(d.series.get("outputs", {}), start=1):
        figures[f"stretch-{stem(output, k)}"] = stretch_figure(d, output)
    if d.posterior:
        figures["posterior"] = posterior_figure(d)
    if d.residual_force is not None and d.residual_force.curves:
        figures["force"] = force_of(d)
    return figures


def run_in_words(discovery: Discovery) -> str:
    """What the run over a whole record is: a free run, or of a nonlinear plant one that is linear about the record."""
    return ALONG if LINEAR in discovery.free_run_on else FREE


def gap_figure(discovery: Discovery) -> Figure:
    """For every output: bars of the held-out error of the three models in windows and in free run; errors over time."""
    d = discovery
    ratios = [1.0, 1.0, 1.9] if d.free_run else [1.0, 2.1]
    figure, axes = new_figure(len(d.gaps), len(ratios), 10.0, 2.7, gridspec_kw={"width_ratios": ratios})
    with house_style():
        for k, (name, gap) in enumerate(d.gaps.items()):
            *bars, traces = axes[len(ratios) * k : len(ratios) * (k + 1)]
            _bars(bars[0], gap, f"{name}: windows of {d.window:.3g} s")
            if name in d.free_run:
                _bars(bars[1], d.free_run[name], f"{name}: {SHORT.get(run_in_words(d), FREE)}")
                bars[1].set_yticklabels([])
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
            traces.set_title("record minus simulation, windows")
            if k == 0:
                traces.legend(loc="lower left", bbox_to_anchor=(0.0, -0.03), ncols=3, columnspacing=1.2)
                headroom(traces, below=0.2)
        title = _wrapped(plain_label(f"{d.headline()}."), 104)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def free_run_figure(discovery: Discovery, output: str | None = None) -> Figure:
    """One held-out record simulated from its start to its end: signals above, errors below."""
    d, run = discovery, discovery.series.get("free_run", {})
    output = chosen([name for name in run.get("outputs", {}) if name in d.free_run], output, "output")
    every = max(1, len(run["t"]) // DRAWN)
    t = np.asarray(run["t"])[::every]
    signals = {key: np.asarray(values)[::every] for key, values in run["outputs"][output].items()}
    how = "one run from the record's start" if run_in_words(d) == FREE else run_in_words(d)
    start = f"{output} of {run['record']}: {how}"
    return _signals_and_errors(t, signals, d.free_run[output], start)


def stretch_figure(discovery: Discovery, output: str | None = None) -> Figure:
    """Some held-out windows around the one that the nominal model misses most: signals above, errors below."""
    d = discovery
    output = chosen(list(d.series.get("outputs", {})), output, "output")
    signals = {key: np.asarray(values) for key, values in d.series["outputs"][output].items()}
    whole = _Windows.of(d)
    miss = [
        float(np.nanmean(part**2)) if np.isfinite(part).any() else 0.0
        for part in whole.cut(signals["measured"] - signals["nominal"])
    ]
    first = min(max(int(np.argmax(miss)) - STRETCH // 2, 0), max(len(miss) - STRETCH, 0))
    axis = whole.some(first, STRETCH)
    start = f"{output}, held out: each window starts from its best fitted state"
    x = axis.broken(signals["measured"])[0]
    figure = _signals_and_errors(x, {k: axis.broken(v)[1] for k, v in signals.items()}, d.gaps[output], start)
    with house_style():
        axis.label(figure.axes[-1])
    return figure


def posterior_figure(discovery: Discovery) -> Figure:
    """Bars of the probability of the best sets of effects, with their log evidence behind the first."""
    if not discovery.posterior:
        raise InputError("plot('posterior')", "no sets of effects were weighed", "a finished discovery")
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


def force_of(discovery: Discovery) -> Figure:
    """The missing force over speed, position, time and input, before and after; what share of it each explains."""
    residual, before = discovery.residual_force, discovery.missing_force
    if residual is None or not residual.curves:
        raise InputError("plot('force')", "no force is known", "a discovery that smoothed the missing force")
    curves = sorted(residual.curves.values(), key=_place)
    earlier = before.curves if before is not None else {}
    rows = math.ceil((len(curves) + 1) / COLUMNS)
    figure, panels = new_figure(rows, COLUMNS, width=8.4, height=2.7)
    with house_style():
        low, high = _limits([*curves, *earlier.values()])
        for panel, curve in zip(panels, curves, strict=False):
            zero_line(panel)
            if curve.coordinate in earlier:
                _curve(panel, earlier[curve.coordinate], COLOURS["worst"], COLOURS["worst"], "refitted, ")
            _curve(panel, curve, COLOURS["nominal"], COLOURS["band"], "updated, " if earlier else "")
            panel.set_title(_explains(curve, earlier.get(curve.coordinate)))
            edge = 0.05 * float(np.ptp(curve.x)) or 1.0
            panel.set_xlim(float(curve.x.min()) - edge, float(curve.x.max()) + edge)
            panel.set_ylim(low, high)
            panel.set_xlabel(axis_label(curve.coordinate, curve.unit))
            panel.set_ylabel(axis_label("missing force", residual.unit))
        _shares(panels[len(curves)], residual, before)
        for panel in panels[len(curves) + 1 :]:
            panel.set_visible(False)
        if curves:
            legend_below(figure, panels[: len(curves)], 2 if earlier else 3)
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


def _bars(axes: Axes, gap: Gap, title: str) -> None:
    """Errors of the three models with their share of the range; of one that diverges a hatched bar to the end."""
    values = [getattr(gap, model) for model in MODELS]
    longest = max((v for v in values if math.isfinite(v)), default=1.0) or 1.0
    for row, (value, (model, colour)) in enumerate(zip(values, MODELS.items(), strict=True)):
        finite = math.isfinite(value)
        axes.barh(row, value if finite else 1.1 * longest, color=colour, height=0.62, hatch="" if finite else "///")
        share = f"{100 * value / gap.range:.3g} %" if gap.range > 0 else f"{value:.3g}"
        at = (value if finite else 1.1 * longest, row)
        text = share if finite else f"{model} diverges"
        place: dict[str, Any] = {"xytext": (4, 0), "ha": "left"} if finite else {"xytext": (-4, 0), "ha": "right"}
        axes.annotate(text, at, textcoords="offset points", va="center", fontsize=8.5, **place)
    axes.set_yticks(range(len(values)), list(MODELS))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlim(0.0, 1.4 * longest)
    axes.set_xlabel(axis_label("rms error", gap.unit))
    axes.set_title(plain_label(title))
    axes.xaxis.set_major_locator(MaxNLocator(3))


def _signals_and_errors(x: Array, signals: dict[str, Array], gap: Gap, title: str) -> Figure:
    """Record and models over time; errors of all three; error of the updated one on a scale of its own."""
    figure, (above, middle, below) = new_figure(3, 1, width=7.8, height=2.0, sharex=True)
    measured = signals["measured"]
    with house_style():
        above.plot(x, measured, color=COLOURS["measured"], lw=2.4, alpha=0.45, label="record")
        for model, colour in MODELS.items():
            above.plot(x, signals[model], color=colour, lw=1.2, ls=DASHES[model], label=model)
            middle.plot(x, measured - signals[model], color=colour, lw=1.0)
        _keep_near(above, measured)
        _keep_near(middle, measured - signals["refitted"], measured - signals["updated"], np.zeros(1))
        above.set_ylabel(axis_label(gap.output, gap.unit))
        above.set_title(plain_label(title))
        above.legend(loc="lower left", bbox_to_anchor=(0.0, -0.03), ncols=4)
        headroom(above, below=0.22)
        below.plot(x, measured - signals["updated"], color=MODELS["updated"], lw=1.0)
        rms = ", ".join(f"{model} {getattr(gap, model):.3g}" for model in MODELS).replace("inf", "diverges")
        middle.set_title(plain_label(f"record minus simulation: rms {rms} {gap.unit}"))
        below.set_title("updated alone, on a scale of its own")
        for panel in (middle, below):
            zero_line(panel)
            panel.set_ylabel(axis_label("error", gap.unit))
        below.set_xlabel("time [s]")
        below.set_xlim(float(np.nanmin(x)), float(np.nanmax(x)))
    return figure


def _keep_near(axes: Axes, *shown: Array) -> None:
    """Limits that hold these curves, and of others no more than is readable beside them."""
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (-1.0, 1.0)
    room = BEYOND * (high - low) or 1.0
    old = axes.get_ylim()
    axes.set_ylim(max(old[0], low - room), min(old[1], high + room))


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


def _curve(panel: Axes, curve: ForceCurve, colour: str, band: str, whose: str) -> None:
    # A line across zero speed would hide the jump there.
    sides = (curve.x < 0, curve.x >= 0) if curve.coordinate.lower().startswith("speed") else (curve.x == curve.x,)
    for k, side in enumerate(sides):
        panel.fill_between(
            curve.x[side], curve.low[side], curve.high[side], color=band, alpha=0.35 if band != colour else 0.2, lw=0,
            label=f"{whose}95 % band" if k == 0 else None,
        )  # fmt: skip
        panel.plot(
            curve.x[side], curve.value[side], "o-", ms=2.8, lw=1.2, color=colour,
            label=f"{whose}mean over a bin" if k == 0 else None,
        )  # fmt: skip
    if len(sides) == 2:
        panel.axvline(0.0, color="#888888", lw=0.8)


def _place(curve: ForceCurve) -> int:
    return next((k for k, name in enumerate(ORDER) if curve.coordinate.startswith(name)), len(ORDER))


def _explains(curve: ForceCurve, earlier: ForceCurve | None) -> str:
    name = plain_label(curve.coordinate)
    if earlier is not None:
        return f"{name}: explains {100 * earlier.share:.0f} % → {100 * curve.share:.0f} %"
    return f"{name}: explains {100 * curve.share:.0f} %"


def _shares(panel: Axes, residual: ResidualForce, before: ResidualForce | None) -> None:
    rows = [(f"f({name})", curve.share, COLOURS["nominal"]) for name, curve in residual.curves.items()]
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
    fell = "" if before is None else f" (rms {before.rms:.3g} → {residual.rms:.3g} {residual.unit})"
    panel.set_title(f"what explains it{fell}")


TONES = {
    "named": ("good", "✓"),
    "no missing effect": ("good", "✓"),
    "ambiguous": ("warn", "?"),
    "unknown": ("warn", "?"),
}
MEANINGS = {
    "named": "What is named has 95 % or more, in whatever form, and helps on data that the fit never saw.",
    "no missing effect": "What differs lies within the tolerances of the parameters and the noise of the sensors.",
    "ambiguous": "Something is missing that effects of several kinds explain equally well; see the next experiment.",
    "unknown": "Something is missing that no effect of the catalogue explains; see the force that remains.",
}


def story(d: Discovery) -> list[tuple[str, str, str]]:
    """Where, what, how sure, and the gap before and after: label, value and remark of each."""
    places = list(dict.fromkeys(e.site for e in d.effects))
    open_forms = [k for k in d.kinds if not k.settled]
    members = {m.name for k in open_forms for m in k.members}
    own = [e for e in d.effects if e.name not in members]
    what = [(k.title, "; ".join(f"{v.name} {with_interval(v)}" for v in k.values)) for k in open_forms]
    what += [(e.title, "; ".join(with_interval(p) for p in e.parameters)) for e in own]
    of_each = [(k.probability, k.title) for k in open_forms] + [(e.confidence, e.title) for e in own]
    sure = [f"{chance(p)}{f' {title}' if len(of_each) > 1 else ''}" for p, title in of_each]
    rivals = ", ".join(dict.fromkeys(r.title for r in d.rivals))
    doubt = f"not excluded: {rivals}" if rivals else "no rival is left"
    left = "nothing more is seen" if d.complete else "something else remains"
    none = "no effect of the catalogue" if d.verdict == "unknown" else "nothing that these records show"
    run = ""
    if d.free_run:
        before, after = (overall(d.free_run, model) for model in ("nominal", "updated"))
        run = f"; in one free run {_share(before)} → {_share(after)}"
    return [
        ("Where", ", ".join(places) or "no place", f"in {d.plant}"),
        ("What is missing", ", ".join(t for t, _ in what) or none, "; ".join(v for _, v in what if v)),
        ("How sure", "; ".join(sure) or d.verdict, f"{doubt}; {left}"),
        (
            "Gap before → after",
            f"{_share(d.gap_before)} → {_share(d.gap_after)}",
            f"rms error on held-out data, share of the range; refitted without it {_share(d.gap_refitted)}{run}",
        ),
    ]


def _share(percent: float) -> str:
    return f"{percent:.2g} %" if math.isfinite(percent) and percent < 99.5 else f"{percent:.0f} %"


def write_page(d: Discovery, folder: Path, provenance: Provenance) -> list[Path]:
    """Write the figures into ``folder/figures`` and ``folder/report.html``; the paths written, the page last."""
    figures = discovery_figures(d)
    files = [path for name, figure in figures.items() for path in save_figure(figure, folder / "figures", name)]
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
                "story": [dict(zip(("label", "value", "source"), part, strict=True)) for part in story(d)],
                "figures": [{"stem": name, "caption": caption_of(WHOLE, name)} for name in figures],
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
