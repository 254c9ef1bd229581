r"""A base that does not stand level: gravity acts in another direction than the plant says.

.. math:: t' = t + (x, y)
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import MisplacedEffect

__all__ = ["EFFECT"]


class GravityDirection(MisplacedEffect):
    """Tilt of a machine's base about two axes."""

    id = "gravity-direction"
    title = "Base that is not level"
    equation = "t' = t + (x, y)"
    independently = "lay a level on the base, along both axes"
    components = ("x", "y")
    unit = "rad"
    spread = 0.05
    tolerance = 0.0
    quantity = "tilt of the base"


EFFECT = GravityDirection()
