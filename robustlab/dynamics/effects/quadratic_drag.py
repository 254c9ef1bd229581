r"""Quadratic drag: fans, fluids, windage.

.. math:: f = -c\, v |v|

Over a step, at the mean of the velocities at its start and its end: a quadratic equation for the force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law

__all__ = ["EFFECT", "drag_force"]


@law
def drag_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (c,); the mean velocity v solves v + (gv c / 2) v |v| = its value without the drag."""
    free = 0.5 * (seen[V0] + seen[V])
    v = 2.0 * free / (1.0 + math.sqrt(1.0 + 2.0 * seen[GV] * p[0] * abs(free)))
    return -p[0] * v * abs(v)


class QuadraticDrag(Effect):
    """Drag with the square of the speed."""

    id = "quadratic-drag"
    title = "Quadratic drag"
    equation = "f = -c v |v|"
    independently = "let it run down from full speed without drive"
    site_kind = "joint"
    force = drag_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        unit = f"{scales.force_unit}/({scales.speed_unit})2" if scales.force_unit else ""
        prior = Prior("log", 0.1 * scales.force / scales.speed**2, 1.5)
        return (EffectParameter("c", unit, "drag coefficient", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of c v |v| over |v| <= a; its describing function is 8 c a / (3 pi), inside.
        return Footprint(site.name, "speed", 0.0, values["c"] * amplitude)


EFFECT = QuadraticDrag()
