r"""Voltage drop of brushes: a constant voltage against the current.

.. math:: f = -V_b \operatorname{sgn} i, \qquad |f| \le V_b \text{ and } i = 0 \text{ while no current breaks through}

The same law as dry friction, at a current.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.coulomb_friction import dry_force

__all__ = ["EFFECT"]


class BrushDrop(Effect):
    """Constant voltage drop against the current."""

    id = "brush-drop"
    title = "Brush voltage drop"
    equation = "f = -Vb sgn(i), |f| <= Vb at i = 0"
    independently = "measure voltage and current at the terminals with the rotor held"
    constant_loss = "voltage"
    site_kind = "current"
    force = dry_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.05 * scales.force, 1.2)
        return (EffectParameter("Vb", scales.force_unit, "voltage drop", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Describing function of the relay at a sine of the current amplitude a: 4 Vb / (pi a).
        gain = 4.0 * values["Vb"] / (math.pi * amplitude)
        return Footprint(site.name, "current", 0.0, gain, offset=values["Vb"], describing=gain)


EFFECT = BrushDrop()
