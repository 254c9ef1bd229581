"""The page and the facts of a discovery, for ``robustlab data discover --out`` and for recipes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robustlab.identification.naming.discovery_result import (
    Discovery,
    chance,
    compared,
    headline,
    in_words,
    overall,
    with_interval,
)
from robustlab.provenance import Provenance
from robustlab.report.discovery_figures import CAPTIONS, discovery_figures, run_in_words
from robustlab.report.figures import save_figure
from robustlab.report.html import render
from robustlab.result import plain

TONES = {
    "named": ("good", "✓"),
    "no missing effect": ("good", "✓"),
    "ambiguous": ("warn", "?"),
    "unknown": ("warn", "?"),
}
MEANINGS = {
    "named": "The named effects are the answer with 95 % or more, and help on data that the fit never saw.",
    "no missing effect": "What differs lies within the tolerances of the parameters and the noise of the sensors.",
    "ambiguous": "Something is missing that more than one effect explains equally well; see the next experiment.",
    "unknown": "Something is missing that no effect of the catalogue explains; see the force that remains.",
}


def facts(d: Discovery) -> list[tuple[str, str, str]]:
    """Label, value and source of the key numbers: effects with parameters and rivals, gap of each output."""
    found = [
        ("Verdict", d.verdict if d.complete else f"{d.verdict}, incomplete: structure remains", MEANINGS[d.verdict])
    ]
    for e in d.effects:
        values = "; ".join(f"{p.name} = {with_interval(p)}" for p in e.parameters)
        found.append((in_words(e), values, e.equation))
        rivals = f"; cannot be told from: {', '.join(e.rivals)}" if e.rivals else ""
        found.append((f"{e.name}: probability", f"{chance(e.confidence)}{rivals}", "of all sets that contain it"))
    for r in d.rivals:
        if r.instead_of == "none":
            values = "; ".join(f"{p.name} = {with_interval(p)}" for p in r.parameters)
            found.append((f"Not excluded: {r.title}", values, "tolerances of other parameters may hide it"))
    for gaps, how, on in ((d.gaps, "windows", d.held_out), (d.free_run, run_in_words(d), d.free_run_on)):
        for g in gaps.values():
            sizes = f"nominal {g.nominal:.4g}, refitted {g.refitted:.4g}, updated {g.updated:.4g} {g.unit}".rstrip()
            change = compared(g.refitted, g.updated, "refitted")
            found.append((f"{g.output}: rms on held-out data, {how}", f"{sizes}; {change}", on))
    return found


def story(d: Discovery) -> list[tuple[str, str, str]]:
    """Where, what, how sure, and the gap before and after: label, value and remark of each."""
    places = list(dict.fromkeys(e.site for e in d.effects))
    what = [(e.title, "; ".join(with_interval(p) for p in e.parameters)) for e in d.effects]
    sure = [f"{chance(e.confidence)}{f' {e.title}' if len(d.effects) > 1 else ''}" for e in d.effects]
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


def caption(name: str) -> str:
    """Caption of a figure of `discovery_figures`; of one output it begins with the output's name."""
    kind, _, output = name.partition("-")
    return f"{output}: {CAPTIONS[kind][0].lower()}{CAPTIONS[kind][1:]}" if output else CAPTIONS[kind]


def write_page(d: Discovery, folder: Path, provenance: Provenance) -> list[Path]:
    """Write the figures into ``folder/figures`` and ``folder/report.html``; the paths written, the page last."""
    figures = discovery_figures(d)
    files = [path for name, figure in figures.items() for path in save_figure(figure, folder / "figures", name)]
    tone, mark = TONES[d.verdict] if d.complete or d.verdict != "named" else ("warn", "!")
    page = {
        "verdict": {"tone": tone, "mark": mark, "headline": headline(d), "detail": MEANINGS[d.verdict]},
        "requirements": [],
        "steps": [_step(d, figures)],
        "recipe": {
            "name": "data discover",
            "title": f"What {d.plant} lacks",
            "description": "",
            "text": "",
            "overrides": {},
        },
        "seconds": d.seconds,
        "seed": 0,
        "provenance": provenance.to_json(),
    }
    path = folder / "report.html"
    path.write_text(render(page, folder), encoding="utf-8")
    return [*files, path]


def _step(d: Discovery, figures: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": "discover",
        "do": "discover",
        "title": f"{d.plant} against {', '.join(d.records)}",
        "status": str(d.status),
        "trustworthy": d.status.trustworthy,
        "summary": headline(d),
        "error": "",
        "numbers": plain(d.to_json()),
        "facts": [dict(zip(("label", "value", "source"), fact, strict=True)) for fact in facts(d)],
        "notes": [f.message for f in d.findings],
        "text": d.summary(details=True),
        "story": [dict(zip(("label", "value", "source"), part, strict=True)) for part in story(d)],
        "figures": [{"stem": name, "caption": caption(name)} for name in figures],
    }
