r"""Saturation of the input: the driver gives no more than :math:`u_{max}` either way.

.. math:: u' = \max(-u_{max}, \min(u_{max}, u))
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site

__all__ = ["EFFECT"]


class InputSaturation(Effect):
    """Symmetric limit of an input, below the largest value that was commanded."""

    id = "input-saturation"
    title = "Saturation of the input"
    equation = "u' = clip(u, -u_max, u_max)"
    independently = "measure the driver's output voltage at full command"
    site_kind = "input"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("share", 0.75 * scales.input, 1.0, top=scales.input)
        return (EffectParameter("u_max", scales.signal_unit, "largest input that acts", prior),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"u_max": share * scales.input} for share in (0.6, 0.8, 0.94))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.clip(signal, -values["u_max"], values["u_max"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "input", min(1.0, values["u_max"] / amplitude), 1.0)


EFFECT = InputSaturation()
