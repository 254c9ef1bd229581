r"""A sensor that shows the size of its signal and not its sign.

.. math:: y' = |y - c|

c is the value at which it shows nothing; a rectified current or a pulse counter without direction has :math:`c = 0`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site

__all__ = ["EFFECT"]


class MagnitudeSensor(Effect):
    """The absolute value of an output about an offset."""

    id = "magnitude-sensor"
    title = "Sensor without a sign"
    equation = "y' = |y - c|"
    independently = "read the sensor while the machine is moved by hand in both directions"
    site_kind = "output"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, 0.03 * scales.output)
        return (EffectParameter("c", scales.signal_unit, "value at which it shows zero", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.abs(signal - values["c"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", -1.0, 1.0, offset=abs(values["c"]))


EFFECT = MagnitudeSensor()
