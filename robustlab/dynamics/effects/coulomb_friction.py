r"""Dry friction: a force of constant size against the motion that holds the joint at rest.

.. math:: f = -F_c \operatorname{sgn} v, \qquad |f| \le F_c \text{ and } v = 0 \text{ while the joint sticks}
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law
from robustlab.dynamics.ports.step_solutions import dry_mean_force

__all__ = ["EFFECT", "dry_force"]


@law
def dry_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Mean over the step of p = (F_c,), exact for a constant drive, with sticking and reversals."""
    return dry_mean_force(seen[V0], seen[V], seen[GV], p[0], 0.0, 1.0)


class CoulombFriction(Effect):
    """Coulomb friction with exact sticking."""

    id = "coulomb-friction"
    title = "Coulomb (dry) friction"
    equation = "f = -Fc sgn(v), |f| <= Fc at rest"
    independently = "measure the breakaway force or torque with a spring balance in both directions"
    person = "Coulomb"
    constant_loss = "torque"
    site_kind = "joint"
    force = dry_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.1 * scales.force, 1.2)
        return (EffectParameter("Fc", scales.force_unit, "friction level", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Describing function of the relay for a sinusoidal speed of this amplitude: 4 Fc / (pi a); the sector of all
        # speeds up to the amplitude reaches from there down to nothing at all above it, as damping.
        gain = 4.0 * values["Fc"] / (math.pi * amplitude)
        return Footprint(site.name, "speed", 0.0, gain, offset=values["Fc"], describing=gain)


EFFECT = CoulombFriction()
