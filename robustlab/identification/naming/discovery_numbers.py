"""The numbers of a discovery that requirements may refer to, and which effects and parameters these may name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from robustlab.dynamics.effects.catalogue import catalogue, effect
from robustlab.dynamics.effects.contract import Scales
from robustlab.dynamics.effects.kinds import KINDS
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.identification.naming.named_effects import overall, wave_amplitude


def units_of_effects(exclude: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Effect that may be named, alone and with its place -> its parameters with their units."""
    left_out = {effect(name).id for name in exclude}
    effects: dict[str, dict[str, Any]] = {}
    for name, kind in catalogue().items():
        units: dict[str, Any] = {p.name: p.unit for p in kind.parameters(Scales())}
        if wave_amplitude(dict.fromkeys(units, 0.0)) is not None:
            units["amplitude"] = float
        if isinstance(kind, GroundedEffect):  # at a joint that has no such parameter
            units[kind.symbol] = float
        if name not in left_out:
            effects |= {name: units, f"{name}@*": units}
    return effects


ENDS = {"": "value", "_lower": "lower", "_upper": "upper"}  # of a quantity of a kind


def quantities_of(kind: str) -> dict[str, Any]:
    """What requirements may ask of a kind: each quantity and the ends of its 95 % interval; units go by the place."""
    return {f"{name}{end}": float for name in KINDS[kind].quantities for end in ENDS}


def numbers_of(d: Any) -> dict[str, Any]:
    """What requirements may address (docs/discover.md)."""
    # An effect that was tried but not named has confidence 0 and NaN parameters: a requirement on it is not met, while
    # a misspelt one is refused.
    effects, lower, upper, confidence = (_absent(d) for _ in range(4))
    confidence = dict.fromkeys(confidence, 0.0)
    for e in d.effects:
        # A second effect of the same kind, at another place, is told by that place.
        key = e.name if e.name not in d.names[: d.effects.index(e)] else f"{e.name}@{e.site}"
        effects[key] = {p.name: p.value for p in e.parameters}
        if (amplitude := wave_amplitude(effects[key])) is not None:
            effects[key]["amplitude"] = amplitude
        lower[key] = {p.name: p.lower for p in e.parameters}
        upper[key] = {p.name: p.upper for p in e.parameters}
        confidence[key] = e.confidence
    return {
        **_kinds(d),
        "verdict": d.verdict,
        "complete": d.complete,
        "names": list(d.names),
        "places": [f"{e.name}@{e.site}" for e in d.effects],
        "answer": list(d.answer),
        "kinds": [k.kind for k in d.kinds],
        "count": len(d.effects),
        "gap_before": d.gap_before,
        "gap_refitted": d.gap_refitted,
        "gap_after": d.gap_after,
        "gap_ratio": d.gap_before / d.gap_after if d.gap_after > 0 else math.inf,
        "refitted_ratio": d.gap_refitted / d.gap_after if d.gap_after > 0 else math.inf,
        "gaps": {name: gap.to_json() for name, gap in d.gaps.items()},
        "free_run": {
            "before": overall(d.free_run, "nominal"),
            "refitted": overall(d.free_run, "refitted"),
            "after": overall(d.free_run, "updated"),
            "outputs": {name: gap.to_json() for name, gap in d.free_run.items()},
        },
        "effects": effects,
        "lower": lower,
        "upper": upper,
        "confidence": confidence,
        "nominal": {p.name: p.value for p in d.nominal},
        "next_experiment": {
            "name": d.next_experiment.name if d.next_experiment else "none",
            "separation": d.next_experiment.separation if d.next_experiment else math.nan,
        },
        "structure": dict(d.structure),
        "remaining_lines": [dict(line) for line in d.remaining_lines],
        "line": {over: _strongest_line(d, over) for over in ("position", "time")},
        "seconds": d.seconds,
    }


def _kinds(d: Any) -> dict[str, dict[str, float]]:
    """Every kind with its quantities: no number of one that is not sure; of two places the more probable one."""
    found: dict[str, dict[str, float]] = {
        kind: {"probability": 0.0} | dict.fromkeys(quantities_of(kind), math.nan) for kind in KINDS
    }
    for k in sorted(d.kinds, key=lambda k: k.probability):
        told = {f"{v.name}{end}": getattr(v, part) for v in k.values for end, part in ENDS.items()}
        found[k.kind] |= {"probability": k.probability, **told}
    return found


def _strongest_line(d: Any, over: str) -> dict[str, float]:
    """Period and amplitude of the strongest line that remains over a coordinate; no numbers where there is none."""
    line = next((line for line in d.remaining_lines if line["over"] == over), None)
    return {name: math.nan if line is None else float(line[name]) for name in ("period", "amplitude")}


def _absent(d: Any) -> dict[str, dict[str, float]]:
    """Every effect that was tried, with parameters that are no number."""
    known = catalogue()
    tried = [known[name] for name in d.candidates if name in known]
    found = {effect.id: {p.name: math.nan for p in effect.parameters(Scales())} for effect in tried}
    for values in found.values():
        if wave_amplitude(values) is not None:
            values["amplitude"] = 0.0
    return found
