r"""Viscous friction that differs between the directions: the plant's own, more one way and less the other.

.. math:: f = -\Delta F_v\, |v|

that is, :math:`+\Delta F_v` on the viscous coefficient forwards and :math:`-\Delta F_v` backwards. Over a step the
force is that of the mean of :math:`|v|`; where the velocity runs from :math:`v_0` through zero to :math:`v_1`, this is
:math:`(v_0^2 + v_1^2) / (2 |v_1 - v_0|)`, and the force solves a quadratic equation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law

__all__ = ["EFFECT", "asymmetric_force"]

# The half that pushes along is cut at this share of the velocity per half step: beyond, it would gather speed faster
# than the step can follow (a time constant below the step).
MOST_PUSH = 0.5


@law
def asymmetric_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Force of p = (dF_v,) at the mean of the speed over the step."""
    v0, v1, gv = seen[V0], seen[V], seen[GV]
    free = 0.5 * (v0 + v1)  # mean velocity without the force
    gain = 0.5 * gv * p[0]
    opposing = gain if free > 0.0 else -gain
    force = -p[0] * abs(free) / (1.0 + max(opposing, -MOST_PUSH))
    if v0 * (v1 + gv * force) >= 0.0:
        return force
    way = 1.0 if v1 > v0 else -1.0
    linear, last = way * (v1 - v0) + 2.0 * gain * v1, p[0] * (v0 * v0 + v1 * v1)
    inside = linear * linear - gv * (2.0 * way + p[0] * gv) * last
    if linear <= 0.0 or inside < 0.0:  # the force itself turns the motion within the step
        return force
    return -last / (linear + math.sqrt(inside))


class AsymmetricViscousFriction(Effect):
    """Viscous friction that depends on the direction."""

    id = "asymmetric-viscous-friction"
    title = "Direction-dependent viscous friction"
    equation = "f = -dFv |v|: viscous coefficient +dFv forwards, -dFv backwards"
    site_kind = "joint"
    force = asymmetric_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        unit = f"{scales.force_unit} s/{scales.speed_unit.removesuffix('/s')}" if scales.force_unit else ""
        prior = Prior("linear", 0.0, 0.3 * scales.force / scales.speed)
        return (EffectParameter("dFv", unit, "half of the difference of the directions' coefficients", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of -dFv |v| over v: either sign, at any amplitude.
        size = abs(values["dFv"])
        return Footprint(site.name, "speed", -size, size)


EFFECT = AsymmetricViscousFriction()
