r"""Stribeck friction: dry friction whose level falls from breakaway to sliding as the joint gathers speed.

.. math::
    f = -\left(F_c + \Delta F\, e^{-(v/v_s)^2}\right) \operatorname{sgn} v,
    \qquad |f| \le F_c + \Delta F \text{ at rest}

References
----------
Armstrong-Helouvry, Dupont, Canudas de Wit, *A survey of models, analysis tools and compensation methods for the control
of machines with friction*, Automatica 30 (1994), eq. 5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law
from robustlab.dynamics.ports.step_solutions import dry_mean_force

__all__ = ["EFFECT", "stribeck_force"]


@law
def stribeck_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Mean over the step of p = (F_c, dF, v_s), with sticking, breakaway and reversals."""
    return dry_mean_force(seen[V0], seen[V], seen[GV], p[0], p[1], p[2])


class StribeckFriction(Effect):
    """Coulomb friction with a higher level at rest and at low speed."""

    id = "stribeck-friction"
    title = "Stribeck friction"
    equation = "f = -(Fc + dF exp(-(v/vs)^2)) sgn(v), |f| <= Fc + dF at rest"
    independently = "measure the breakaway force and the force at a slow constant speed with a spring balance"
    person = "Stribeck"
    site_kind = "joint"
    force = stribeck_force
    refines = "coulomb-friction"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        force, speed = scales.force, scales.speed
        return (
            EffectParameter("Fc", scales.force_unit, "friction level at speed", Prior("log", 0.1 * force, 1.2)),
            EffectParameter("dF", scales.force_unit, "breakaway above that level", Prior("log", 0.1 * force, 1.2)),
            EffectParameter("vs", scales.speed_unit, "Stribeck velocity", Prior("log", 0.02 * speed, 1.2)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        level = 0.1 * scales.force
        return tuple({"Fc": level, "dF": level, "vs": share * scales.speed} for share in (0.005, 0.03))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Describing function at a sine of this speed amplitude a, with D Dawson's integral and r = a / vs:
        # 4 (Fc + dF D(r) / r) / (pi a). The force always opposes the motion.
        from scipy.special import dawsn

        ratio = amplitude / values["vs"]
        gain = 4.0 * (values["Fc"] + values["dF"] * float(dawsn(ratio)) / ratio) / (math.pi * amplitude)
        level = values["Fc"] + values["dF"]
        return Footprint(site.name, "speed", 0.0, gain, offset=level, describing=gain)


EFFECT = StribeckFriction()
