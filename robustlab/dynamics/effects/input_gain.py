r"""Input gain: the plant gets a multiple of the commanded input.

.. math:: u' = s\,u

A pulse-width modulated driver with dead time :math:`t_d` at the switching frequency f has :math:`s = 1 - 2 t_d f`.
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site

__all__ = ["EFFECT"]


class InputGain(Effect):
    """Gain of the driver or of its command."""

    id = "input-gain"
    title = "Input gain"
    equation = "u' = s u"
    site_kind = "input"
    gain_like = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("s", "", "what acts over what was commanded", Prior("log", 1.0, 0.1)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({"s": 1.1}, {"s": 0.9})

    def input(self, u: Array, values: Mapping[str, float], h: float) -> Array:
        return values["s"] * u

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "input", values["s"], values["s"])


EFFECT = InputGain()
