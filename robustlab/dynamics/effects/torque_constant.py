r"""Misjudged torque constant: the true value is a multiple of the nominal one.

.. math:: K_m' = s\,K_m, \qquad K_b' = s\,K_b

Of a plant with several motors the constants of all of them, or those of one: what its current does to other states, and
what their speeds do to it.
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import MotorEffect
from robustlab.dynamics.ports.port_model import PortModel

__all__ = ["EFFECT"]


class TorqueConstant(MotorEffect):
    """Torque constant and back-EMF constant, one quantity in SI units, scaled together."""

    id = "torque-constant"
    title = "Misjudged torque constant"
    equation = "K' = s K (torque and back-EMF)"
    independently = "turn the motor from outside and measure its open-circuit voltage per speed"
    spread = 0.12
    tolerance = 0.03
    quantity = "torque constant and back-EMF constant"

    def terms(self, model: PortModel, current: int) -> list[tuple[int, int]]:
        others = [k for k in range(model.own) if k != current]
        return [(k, current) for k in others] + [(current, k) for k in others]


EFFECT = TorqueConstant()
