r"""Sensor delay: the reading is d seconds old, or its clock runs behind that of the input.

.. math:: y'(t) = y(t - d)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.errors import InputError

__all__ = ["EFFECT"]


class SensorDelay(Effect):
    """Delay of one output.

    Between samples the output follows the cubic through its four neighbours (Lagrange's); before the start of a window
    it goes on backwards along the first two samples. In an open loop the same delay of all outputs is one of all
    inputs.
    """

    id = "sensor-delay"
    title = "Sensor delay"
    equation = "y'(t) = y(t - d)"
    site_kind = "output"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("d", "s", "delay", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"d": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def output(self, y: Array, values: Mapping[str, float], h: float) -> Array:
        if values["d"] < 0.0:
            raise InputError("effect sensor-delay: d", f"{values['d']:g} s", "a delay of 0 s or more")
        n = y.shape[1]
        if n < 4:
            return y
        at = np.arange(n) - values["d"] / h
        left = np.clip(np.floor(at).astype(int), 1, n - 3)
        p = at - left
        before, here, there, after = (y[:, left + k] for k in (-1, 0, 1, 2))
        inside = (
            -p * (p - 1) * (p - 2) / 6 * before
            + (p + 1) * (p - 1) * (p - 2) / 2 * here
            - (p + 1) * p * (p - 2) / 2 * there
            + (p + 1) * p * (p - 1) / 6 * after
        )
        return np.where(at < 0.0, y[:, :1] + at * (y[:, 1:2] - y[:, :1]), inside)

    def lag(self, values: Mapping[str, float]) -> float:
        return values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, delay=values["d"])


EFFECT = SensorDelay()
