r"""Sensor gain: a wrong scale factor, gear ratio or calibration.

.. math:: y' = s\,y
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site

__all__ = ["EFFECT"]


class SensorGain(Effect):
    """Gain of a sensor."""

    id = "sensor-gain"
    title = "Sensor gain"
    equation = "y' = s y"
    site_kind = "output"
    gain_like = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("s", "", "what is recorded over what is there", Prior("log", 1.0, 0.08)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({"s": 1.08}, {"s": 0.92})

    def output(self, y: Array, values: Mapping[str, float], h: float) -> Array:
        return values["s"] * y

    def shown(self, values: Mapping[str, float]) -> float:
        return values["s"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", values["s"], values["s"])


EFFECT = SensorGain()
