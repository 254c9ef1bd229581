r"""Sensor gain: a wrong scale factor, gear ratio or calibration.

.. math:: y' = s\,y
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.dynamics.effects.signal_effect import SignalGain

__all__ = ["EFFECT"]


class SensorGain(SignalGain):
    """Gain of a sensor."""

    id = "sensor-gain"
    title = "Sensor gain"
    equation = "y' = s y"
    independently = "move the axis by a length or angle known from elsewhere (a gauge, counted turns) and compare"
    site_kind = "output"
    spread = 0.08
    meaning = "what is recorded over what is there"
    output = SignalGain.scaled

    def shown(self, values: Mapping[str, float]) -> float:
        return values["s"]


EFFECT = SensorGain()
