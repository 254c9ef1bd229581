r"""Misjudged resistance: the true value is a multiple of the nominal one.

.. math:: R' = s\,R
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import ParameterEffect

__all__ = ["EFFECT"]


class Resistance(ParameterEffect):
    """The resistance of a circuit, scaled."""

    id = "resistance"
    title = "Misjudged resistance"
    equation = "R' = s R"
    independently = "measure the winding with an ohmmeter, rotor held, in several positions"
    spread = 0.3
    tolerance = 0.05
    quantity = "resistance"


EFFECT = Resistance()
