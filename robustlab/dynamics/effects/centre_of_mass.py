r"""A centre of mass that is not where the plant has it.

.. math:: c' = c + (x, y, z)
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import MisplacedEffect

__all__ = ["EFFECT"]


class CentreOfMass(MisplacedEffect):
    """Shift of a body's centre of mass."""

    id = "centre-of-mass"
    title = "Misplaced centre of mass"
    equation = "c' = c + (x, y, z)"
    independently = "balance the body on an edge in two positions, or hang it from two points"
    components = ("x", "y", "z")
    unit = "m"
    spread = 0.03
    tolerance = 0.0
    quantity = "shift of the centre of mass"


EFFECT = CentreOfMass()
