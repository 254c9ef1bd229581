r"""Quantisation: the reading comes in steps.

.. math:: y' = \mathrm{lsb} \cdot \operatorname{round}(y / \mathrm{lsb})

It is bounded noise that the data sheet tells, never the name of what a model lacks: ``nameable`` is False.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.errors import InputError

__all__ = ["EFFECT"]


class Quantisation(Effect):
    """Rounding to the least significant bit of a sensor."""

    id = "quantisation"
    title = "Quantisation"
    equation = "y' = lsb round(y / lsb)"
    site_kind = "output"
    nameable = False

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 1e-3 * scales.output, 1.5)
        return (EffectParameter("lsb", scales.signal_unit, "step of the reading", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["lsb"] <= 0.0:
            raise InputError("effect quantisation: lsb", f"{values['lsb']:g}", "a positive step")
        return values["lsb"] * np.round(signal / values["lsb"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=0.5 * values["lsb"])


EFFECT = Quantisation()
