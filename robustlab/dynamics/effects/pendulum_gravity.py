r"""Gravity of a pendulum: a weight off the axis of a joint that turns.

.. math:: f = -(G \sin q + H \cos q) = -m g l\, \sin(q - q_0), \qquad m g l = \sqrt{G^2 + H^2}, \quad
   q_0 = -\operatorname{atan2}(H, G)

:math:`q_0` is the reading of the position at which the weight hangs straight down; the encoder's zero need not be
there. The period is a turn by nature and no parameter: over a short stroke it is this that tells gravity from a cogging
of any period. Over a step the force is that of `robustlab.dynamics.effects.cogging`: its work is exactly the difference
of the potential.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.cogging import cogging_force
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.port_model import Port

__all__ = ["EFFECT"]


class PendulumGravity(Effect):
    """Torque of a weight about a joint that turns."""

    id = "pendulum-gravity"
    title = "Gravity of a pendulum"
    equation = "f = -(G sin(q) + H cos(q)), m g l = sqrt(G^2 + H^2)"
    independently = "weigh the load at a known distance from the axis, or turn the axis upright"
    site_kind = "joint"
    needs_position = True
    force = cogging_force

    def fits(self, port: Port) -> bool:
        return super().fits(port) and port.position_unit == "rad"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, 0.5 * scales.force)
        return (
            EffectParameter("G", scales.force_unit, "m g l times the cosine of the position of rest", prior),
            EffectParameter("H", scales.force_unit, "-m g l times the sine of the position of rest", prior),
        )

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return -values["H"], -values["G"], 1.0

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Its slope over the position, a stiffness of either sign, lies within m g l; so does its size.
        size = math.hypot(values["G"], values["H"])
        return Footprint(site.name, "position", -size, size, offset=size)


EFFECT = PendulumGravity()
