r"""Stiffness: a misjudged spring, or a spring to ground at a joint that has none.

.. math:: k' = s\,k \quad\text{(parameter)}, \qquad f = -k\,q \quad\text{(joint; zero force at the position's zero)}
"""

from __future__ import annotations

from robustlab.dynamics.effects.contract import EffectParameter, Prior, Scales
from robustlab.dynamics.effects.parameter_effect import GroundedEffect

__all__ = ["EFFECT"]


class Stiffness(GroundedEffect):
    """The plant's own stiffness scaled, or a spring to ground where the plant has none."""

    id = "stiffness"
    title = "Stiffness, misjudged or missing"
    equation = "k' = s k; f = -k q at a joint without a spring"
    independently = "push with known forces and read the displacement"
    spread = 0.4
    tolerance = 0.05
    quantity = "stiffness"
    symbol = "k"
    of = "position"

    def at_joint(self, scales: Scales) -> EffectParameter:
        unit = f"{scales.force_unit}/{scales.position_unit}" if scales.position_unit else ""
        prior = Prior("log", 0.3 * scales.force / scales.position, 1.5)
        return EffectParameter("k", unit, "stiffness of a spring to ground", prior)


EFFECT = Stiffness()
