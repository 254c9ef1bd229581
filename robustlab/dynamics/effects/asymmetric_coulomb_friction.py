r"""Dry friction whose level differs between the directions.

.. math:: f = -F_+ \ (v > 0), \qquad f = F_- \ (v < 0), \qquad -F_+ \le f \le F_- \text{ while the joint sticks}

With :math:`\bar F = (F_+ + F_-)/2` and :math:`d = (F_+ - F_-)/2` this is Coulomb friction of the level :math:`\bar F`
and a constant load d, sliding as well as sticking: no record of the motion tells the two apart. What does is to change
the load (turn the machine on its side): the friction keeps its difference, a load goes with gravity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law
from robustlab.dynamics.ports.step_solutions import dry_mean_force

__all__ = ["EFFECT", "uneven_dry_force"]

ROUNDING = 1e-13


@law
def uneven_dry_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Mean over the step of p = (F_+, F_-), exact for a constant drive."""
    level, load = 0.5 * (p[0] + p[1]), 0.5 * (p[0] - p[1])
    force = dry_mean_force(seen[V0], seen[V] - seen[GV] * load, seen[GV], level, 0.0, 1.0) - load
    sticks = -seen[V] / seen[GV]
    return sticks if abs(force - sticks) <= ROUNDING * level else force  # at rest exactly, whatever the load rounded


class AsymmetricCoulombFriction(Effect):
    """Coulomb friction that depends on the direction, with exact sticking."""

    id = "asymmetric-coulomb-friction"
    title = "Direction-dependent Coulomb friction"
    equation = "f = -F_pos for v > 0, F_neg for v < 0, -F_pos <= f <= F_neg at rest"
    independently = "turn the machine on its side: a load changes, friction does not"
    site_kind = "joint"
    force = uneven_dry_force
    refines = "coulomb-friction"
    equals = ("coulomb-friction", "constant-load")

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.1 * scales.force, 1.2)
        return (
            EffectParameter("F_pos", scales.force_unit, "friction level forwards", prior),
            EffectParameter("F_neg", scales.force_unit, "friction level backwards", prior),
        )

    def unrefined(self, values: Mapping[str, float]) -> Mapping[str, float]:
        return {"Fc": 0.5 * (values["F_pos"] + values["F_neg"])}

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # At a sine of the speed amplitude a the first harmonic is that of the mean level, 4 F / (pi a).
        gain = 2.0 * (values["F_pos"] + values["F_neg"]) / (math.pi * amplitude)
        return Footprint(site.name, "speed", 0.0, gain, offset=max(values["F_pos"], values["F_neg"]), describing=gain)


EFFECT = AsymmetricCoulombFriction()
