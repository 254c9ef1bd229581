r"""Viscous friction: a misjudged coefficient, or friction at a joint whose equation has none.

.. math:: b' = s\,b \quad\text{(parameter)}, \qquad f = -b\,v \quad\text{(joint)}
"""

from __future__ import annotations

from robustlab.dynamics.effects.contract import EffectParameter, Prior, Scales
from robustlab.dynamics.effects.parameter_effect import GroundedEffect

__all__ = ["EFFECT"]


class ViscousFriction(GroundedEffect):
    """The plant's own coefficient scaled, or viscous friction to ground where the plant has none."""

    id = "viscous-friction"
    title = "Viscous friction, misjudged or missing"
    equation = "b' = s b; f = -b v at a joint without friction"
    independently = "measure the no-load current at several speeds"
    spread = 1.5
    tolerance = 1.0
    quantity = "viscous friction"
    symbol = "b"
    of = "velocity"

    def at_joint(self, scales: Scales) -> EffectParameter:
        unit = f"{scales.force_unit} s/{scales.speed_unit.removesuffix('/s')}" if scales.speed_unit else ""
        prior = Prior("log", 0.1 * scales.force / scales.speed, 1.5)
        return EffectParameter("b", unit, "viscous friction to ground", prior)


EFFECT = ViscousFriction()
