r"""Input delay: the plant sees the input d seconds late.

.. math:: u'(t) = u(t - d)

The input is held in steps; each step of the delayed input is its mean over that step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.errors import InputError

__all__ = ["EFFECT"]


class InputDelay(Effect):
    """Dead time of a bus, a driver, or a clock that runs ahead of the plant's."""

    id = "input-delay"
    title = "Input delay"
    equation = "u'(t) = u(t - d)"
    site_kind = "input"
    substeps = 2  # the mean over a whole sample leaves positions off by what a fine encoder resolves

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("d", "s", "delay", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"d": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def input(self, u: Array, values: Mapping[str, float], h: float) -> Array:
        if values["d"] < 0.0:
            raise InputError("effect input-delay: d", f"{values['d']:g} s", "a delay of 0 s or more")
        steps = values["d"] / h
        whole = int(min(steps, len(u)))
        part = min(1.0, steps - whole)
        k = np.arange(len(u)) - whole  # before the first sample the first value was held
        return (1.0 - part) * u[np.maximum(k, 0)] + part * u[np.maximum(k - 1, 0)]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "input", 1.0, 1.0, delay=values["d"])


EFFECT = InputDelay()
