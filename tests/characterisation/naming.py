"""Blind cases of naming on seeds of their own: short records of three machines, one thing missing or nothing.

More cases: a line each in ``HIDDEN``, then ``python tests/characterisation naming --all --record --case NAME``.
"""

from collections.abc import Iterator
from typing import Any

from hidden import make_case

import robustlab as rl

from .cases import Case

RTOL = 2e-2
RTOLS = {"gap_before": 1e-2, "gap_refitted": 1e-2, "gap_after": 1e-2}
SEED = 202900
# Case -> plant, what is hidden, whether the current is seen. Each takes 10 to 20 CPU s.
HIDDEN = {
    "motor, nothing": ("dc-motor", "none", False),
    "axis, nothing": ("servo-axis", "none", False),
    "axis, dry friction": ("servo-axis", "coulomb-friction", False),
    "axis, load": ("servo-axis", "constant-load", False),
    "axis, delay": ("servo-axis", "input-delay", False),
    "axis, saturation": ("servo-axis", "input-saturation", False),
    "motor, dead zone": ("dc-motor", "input-dead-zone", False),
    "motor, drag": ("dc-motor", "quadratic-drag", False),
    "motor, cogging": ("dc-motor", "cogging", False),
    "motor, brushes": ("dc-motor", "brush-drop", True),
    "actuator, dry friction": ("linear-actuator", "coulomb-friction", False),
    "actuator, end stop": ("linear-actuator", "end-stop", False),
}


def cases() -> Iterator[Case]:
    """One a line of the table."""
    for k, (name, (plant, effect, current)) in enumerate(HIDDEN.items()):
        yield Case(name, lambda k=k, p=plant, e=effect, c=current: named(p, e, c, SEED + k), True)


def named(plant: str, effect: str, current: bool, seed: int) -> dict[str, Any]:
    """The verdict, the kinds that are sure, names, values, gaps, and how many sets the search visited."""
    case = make_case(effect, seed, plant=plant, current=current, duration=2.4)
    found = rl.discover(case.plant, case.record, case.held_out)
    return {
        "verdict": found.verdict,
        "complete": found.complete,
        "kinds": sorted(f"{k.kind} @ {k.place}" for k in found.kinds),
        "effects": {f"{e.name} @ {e.site}": {v.name: v.value for v in e.parameters} for e in found.effects},
        "nominal": {v.name: v.value for v in found.nominal},
        "gap_before": found.gap_before,
        "gap_refitted": found.gap_refitted,
        "gap_after": found.gap_after,
        "work": len(found.search),
    }
