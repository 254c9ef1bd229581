r"""Sensor bias: a constant in the reading.

.. math:: y' = y + b

Where the plant can rest at any value of the output without another output moving (the angle of a free shaft), the bias
is nothing but another zero of that angle: it is offered only at outputs where it can be seen.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel

__all__ = ["EFFECT"]


class SensorBias(Effect):
    """Zero error of a sensor."""

    id = "sensor-bias"
    title = "Sensor bias"
    equation = "y' = y + b"
    independently = "read the sensor at a known reference"
    site_kind = "output"

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        """Outputs k for which no equilibrium A x = 0 has C x = e_k: no free initial state takes the bias."""
        offered = []
        n = model.A.shape[-1]
        a, c = model.A.reshape(-1, n), model.C.reshape(-1, len(plant.outputs), n)[0]  # along a motion at every point
        both = np.vstack([a / max(np.abs(a).max(initial=0.0), 1.0), c])
        for k, signal in enumerate(plant.outputs):
            wanted = np.zeros(len(both))
            wanted[len(a) + k] = 1.0
            x = np.linalg.lstsq(both, wanted, rcond=None)[0]
            if np.abs(both @ x - wanted).max() > 1e-9:
                offered.append(Site("output", signal.name))
        return tuple(offered)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, scales.zero * scales.output)
        return (EffectParameter("b", scales.signal_unit, "reading at zero", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return signal + values["b"]

    def bias(self, values: Mapping[str, float]) -> float:
        return values["b"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=abs(values["b"]))


EFFECT = SensorBias()
