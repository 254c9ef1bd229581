r"""Misjudged inertia: the true value is a multiple of the nominal one.

.. math:: J' = s\,J
"""

from __future__ import annotations

from robustlab.dynamics.effects.parameter_effect import ParameterEffect

__all__ = ["EFFECT"]


class Inertia(ParameterEffect):
    """All inertias that stand in one equation of motion, scaled together."""

    id = "inertia"
    title = "Misjudged inertia"
    equation = "J' = s J"
    independently = "weigh the parts, or add a known inertia and compare"
    spread = 0.4
    tolerance = 0.05
    quantity = "inertia or mass"


EFFECT = Inertia()
