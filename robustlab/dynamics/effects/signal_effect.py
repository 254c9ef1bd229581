"""Effects that are a gain or a delay of one signal, on its way in or out."""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.errors import InputError

__all__ = ["SignalDelay", "SignalGain"]


class SignalGain(Effect):
    """The signal times s.

    Attributes
    ----------
    spread
        Standard deviation of log s.
    meaning
        Of s, in words.
    """

    gain_like = True
    scale = "s"
    spread: float
    meaning: str

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        """The gain s."""
        return (EffectParameter("s", "", self.meaning, Prior("log", 1.0, self.spread)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """One above and one below 1."""
        return ({"s": 1.0 + self.spread}, {"s": 1.0 - self.spread})

    def scaled(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        """``s signal``."""
        return values["s"] * signal

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        """The gain s, at every amplitude."""
        return Footprint(site.name, self.site_kind, values["s"], values["s"])


class SignalDelay(Effect):
    """The signal d seconds late."""

    delay = "d"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        """The delay d."""
        return (EffectParameter("d", "s", "delay", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """Short, longer and long, in samples of the record."""
        return tuple({"d": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def steps(self, values: Mapping[str, float], h: float) -> float:
        """The delay in steps of h seconds.

        Raises
        ------
        InputError
            A negative one.
        """
        if values["d"] < 0.0:
            raise InputError(f"effect {self.id}: d", f"{values['d']:g} s", "a delay of 0 s or more")
        return values["d"] / h

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        """The gain 1, late."""
        return Footprint(site.name, self.site_kind, 1.0, 1.0, delay=values["d"])
