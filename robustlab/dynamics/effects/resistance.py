r"""Misjudged resistance: the true value is a multiple of the nominal one.

.. math:: R' = s\,R

Of a plant with several motors that of all of them, or of one: the term of its current in its own equation.
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import MotorEffect
from robustlab.dynamics.ports.port_model import PortModel

__all__ = ["EFFECT"]


class Resistance(MotorEffect):
    """The resistance of a circuit, scaled."""

    id = "resistance"
    title = "Misjudged resistance"
    equation = "R' = s R"
    independently = "measure the winding with an ohmmeter, rotor held, in several positions"
    spread = 0.3
    tolerance = 0.05
    quantity = "resistance"

    def terms(self, model: PortModel, current: int) -> list[tuple[int, int]]:
        return [(current, current)]


EFFECT = Resistance()
