r"""Backlash: a gap between the drive and its load, who push each other at its flanks and never pull.

With e the depth by which :math:`\delta` has left the gap, :math:`|\delta| \le g/2`, and :math:`m = s (1 - s) J`,

.. math::
    F = -m\,(\omega^2 e + 2 \zeta \omega \dot e) \operatorname{sgn} \delta, \qquad F \operatorname{sgn}\delta \le 0,
    \qquad \omega = 2 \pi f, \quad \zeta = 0.2

f is the frequency of the two inertias on the closed flank. The damping of the flank is that of an impact which gives
back about half of the speed. See `robustlab.dynamics.ports.port_model` for the two sides.

Over a step the flank's force is that of the mean depth, :math:`\omega^2 (e_0 + e_1)/2 + 2 \zeta \omega (e_1 - e_0)/h`:
what it does to the inertias is never more than what the spring had stored, so that no contact creates energy at any
length of step.

References
----------
Nordin, Galic, Gutman, New models for backlash and gear play, Int. J. Adaptive Control and Signal Processing 11 (1997)
49-63; Greenspan, Discrete numerical methods in physics and engineering (1974) for the exact balance of energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Law, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, Q0, STEP, Q, law
from robustlab.dynamics.ports.port_model import PortModel, with_load_side

__all__ = ["EFFECT", "DAMPING", "flank_force"]

DAMPING = 0.2


@law
def flank_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Force per reduced inertia; p = (half gap, omega^2, 2 zeta omega)."""
    side = 1.0 if seen[Q] > 0.0 else -1.0
    depth = side * seen[Q] - p[0]  # at the end of the step, without the force
    if depth <= 0.0:
        return 0.0
    before = max(side * seen[Q0] - p[0], 0.0)
    damper = p[2] / seen[STEP]
    push = 0.5 * p[1] * (depth + before) + damper * (depth - before)
    if push <= 0.0:  # the flanks part faster than the spring follows
        return 0.0
    return -side * push / (1.0 + seen[GQ] * (0.5 * p[1] + damper))


class Backlash(Effect):
    """A gap in the coupling between the drive, which is measured, and its load."""

    id = "backlash"
    title = "Backlash"
    equation = "F = -m (w^2 e + 2 zeta w e') sgn(delta) outside |delta| <= gap/2, w = 2 pi f, m = share (1 - share) J"
    independently = "hold the motor and move the output by hand against a dial gauge"
    site_kind = "joint"
    structural = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (
            EffectParameter("gap", scales.position_unit, "width of the gap", Prior("log", 1e-3 * scales.position, 2.0)),
            EffectParameter("share", "", "load's share of the inertia", Prior("share", 0.35, 0.8)),
            EffectParameter("f", "Hz", "frequency of the closed contact", Prior("log", 120.0, 0.4)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"gap": size * scales.position, "share": 0.35, "f": 120.0} for size in (2e-4, 2e-3, 2e-2))

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        return with_load_side(model, site.name, values["share"], "gap", f"effect {self.id}")

    def laws(self, site: Site, values: Mapping[str, float]) -> tuple[Law, ...]:
        omega = 2.0 * math.pi * values["f"]
        return (Law(flank_force, f"{site.name}.gap", (0.5 * values["gap"], omega**2, 2.0 * DAMPING * omega)),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The load's position follows the drive's within half the gap.
        return Footprint(site.name, "position", 1.0, 1.0, offset=0.5 * values["gap"])


EFFECT = Backlash()
