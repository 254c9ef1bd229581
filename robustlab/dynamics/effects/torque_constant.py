r"""Misjudged torque constant: the true value is a multiple of the nominal one.

.. math:: K_m' = s\,K_m, \qquad K_b' = s\,K_b
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import ParameterEffect

__all__ = ["EFFECT"]


class TorqueConstant(ParameterEffect):
    """Torque constant and back-EMF constant, one quantity in SI units, scaled together."""

    id = "torque-constant"
    title = "Misjudged torque constant"
    equation = "K' = s K (torque and back-EMF)"
    independently = "turn the motor from outside and measure its open-circuit voltage per speed"
    spread = 0.12
    tolerance = 0.03
    quantity = "torque constant and back-EMF constant"


EFFECT = TorqueConstant()
