r"""Lag of the actuator: its output follows the input in first order.

.. math:: T \frac{du'}{dt} = u - u'

The input is held in steps; each step of what comes out is its mean over that step, exact for any length of the step.
Before the first sample the first value was held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.errors import InputError

__all__ = ["EFFECT"]


class ActuatorLag(Effect):
    """First-order lag of a driver, a valve or an inner loop."""

    id = "actuator-lag"
    title = "Lag of the actuator"
    equation = "T du'/dt = u - u'"
    independently = "put command and driver output on an oscilloscope and step the command"
    site_kind = "input"
    time_constant = "T"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("T", "s", "time constant", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"T": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        from scipy.signal import lfilter

        time = values["T"]
        if time < 0.0:
            raise InputError(f"effect {self.id}: T", f"{time:g} s", "a time constant of 0 s or more")
        if time == 0.0 or not len(signal):
            return signal
        left, gone = math.exp(-h / time), -math.expm1(-h / time)
        before = np.asarray(lfilter([0.0, gone], [1.0, -left], signal, zi=signal[:1])[0], dtype=float)
        return signal + (before - signal) * (gone * time / h)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A constant passes as it is. The lag is a state of its own wherever delays are rational ones.
        return Footprint(site.name, "input", 1.0, 1.0)


EFFECT = ActuatorLag()
