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
    spread = 0.12
    quantity = "torque constant and back-EMF constant"


EFFECT = TorqueConstant()
