r"""Sensor delay: the reading is d seconds old, or its clock runs behind that of the input.

.. math:: y'(t) = y(t - d)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.signal_effect import SignalDelay

__all__ = ["EFFECT"]


class SensorDelay(SignalDelay):
    """Delay of one output.

    Between samples the output follows the cubic through its four neighbours (Lagrange's); before the start of a window
    it goes on backwards along the first two samples. In an open loop the same delay of all outputs is one of all
    inputs.
    """

    id = "sensor-delay"
    title = "Sensor delay"
    equation = "y'(t) = y(t - d)"
    independently = "put command and sensor on an oscilloscope with one trigger"
    site_kind = "output"

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        steps, n = self.steps(values, h), signal.shape[1]
        if n < 4:
            return signal
        at = np.arange(n) - steps
        left = np.clip(np.floor(at).astype(int), 1, n - 3)
        p = at - left
        before, here, there, after = (signal[:, left + k] for k in (-1, 0, 1, 2))
        inside = (
            -p * (p - 1) * (p - 2) / 6 * before
            + (p + 1) * (p - 1) * (p - 2) / 2 * here
            - (p + 1) * p * (p - 2) / 2 * there
            + (p + 1) * p * (p - 1) / 6 * after
        )
        return np.where(at < 0.0, signal[:, :1] + at * (signal[:, 1:2] - signal[:, :1]), inside)

    def lag(self, values: Mapping[str, float]) -> float:
        return values["d"]


EFFECT = SensorDelay()
