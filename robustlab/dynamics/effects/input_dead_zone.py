r"""Dead zone of the driver: it drops a constant voltage, or needs one before anything comes out.

.. math:: u' = u - d \operatorname{sgn} u \ \text{ for } |u| > d, \qquad u' = 0 \ \text{ otherwise}
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site

__all__ = ["EFFECT"]


class InputDeadZone(Effect):
    """Symmetric dead zone or drop of an input."""

    id = "input-dead-zone"
    title = "Dead zone or drop of the driver"
    equation = "u' = u - d sgn(u), 0 for |u| < d"
    independently = "measure the driver's output voltage at small commands"
    constant_loss = "voltage"
    site_kind = "input"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.04 * scales.input, 1.0)
        return (EffectParameter("d", scales.signal_unit, "half width of the dead zone", prior),)

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.sign(signal) * np.maximum(np.abs(signal) - values["d"], 0.0)

    def input_error(self, values: Mapping[str, float]) -> float:
        return values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return Footprint(site.name, "input", 0.0, max(0.0, 1.0 - values["d"] / amplitude))


EFFECT = InputDeadZone()
