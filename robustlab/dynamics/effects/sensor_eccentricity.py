r"""Eccentric or tilted encoder: the reading runs ahead and behind once a turn.

.. math:: y' = y + c \cos k y + s \sin k y

It moves the reading and not the plant: unlike a torque ripple it does not fade with the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.spatial_wave import order_prior
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel

__all__ = ["EFFECT"]

POSITION_UNITS = ("rad", "m")


class SensorEccentricity(Effect):
    """Periodic error of a position sensor."""

    id = "sensor-eccentricity"
    title = "Eccentric or misaligned position sensor"
    equation = "y' = y + c cos(k y) + s sin(k y)"
    independently = "turn slowly against a second encoder"
    site_kind = "output"
    amplitude = ("e", "c", "s")
    spatial = True

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return tuple(Site("output", s.name) for s in plant.outputs if s.unit in POSITION_UNITS)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        order = self._orders(scales)[0]
        seen = order_prior(replace(scales, position=2.0 * scales.output))
        line = seen if scales.orders else Prior("log", order, 3e-3)  # once a turn is known
        size = Prior("linear", 0.0, 0.01 / order)
        per = f"rad/{scales.signal_unit}" if scales.signal_unit else ""
        return (
            EffectParameter("c", scales.signal_unit, "error in phase with cos k y", size),
            EffectParameter("s", scales.signal_unit, "error in phase with sin k y", size),
            EffectParameter("k", per, "spatial frequency", line),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"c": 0.003 / k, "s": 0.003 / k, "k": k} for k in self._orders(scales)[:3])

    @staticmethod
    def _orders(scales: Scales) -> tuple[float, ...]:
        """Once a turn for angles, once over the range of a length, where the record shows nothing else."""
        return scales.orders or ((math.pi / scales.output,) if scales.signal_unit == "m" else (1.0,))

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        phase = values["k"] * signal
        return signal + values["c"] * np.cos(phase) + values["s"] * np.sin(phase)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=math.hypot(values["c"], values["s"]))


EFFECT = SensorEccentricity()
