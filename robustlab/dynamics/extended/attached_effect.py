"""An effect at its place, with numbers, and what it is there: a gain of its signal, a sector, a delay, a bound."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Law, Scales, Site
from robustlab.dynamics.extended.law_forces import extrapolated
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.dynamics.tuning import TUNING
from robustlab.errors import InputError, did_you_mean
from robustlab.statespace import real_array

__all__ = ["AttachedEffect", "attach"]

# Amplitude at which footprints are given where none was asked for.
DEFAULT_AMPLITUDE = 1.0
# What a map is asked for a constant signal: so many samples of so many seconds.
ASKED_SAMPLES, ASKED_STEP = 8, 1e-3


@dataclass(frozen=True)
class AttachedEffect:
    """One effect of a plant.

    Raises
    ------
    InputError
        A missing or unknown parameter, NaN, a negative value of a quantity that is positive by nature, a negative
        standard deviation.
    """

    effect: Effect  # of the catalogue
    site: Site  # where it sits
    values: Mapping[str, float]  # name -> value of each of its parameters
    # name -> standard deviation, for those that a fit has determined
    std: Mapping[str, float] = field(default_factory=dict)
    source: str = ""  # where the values come from: a record, a fit, a data sheet

    def __post_init__(self) -> None:
        where = f"effect {self.effect.id}"
        values = {name: _number(where, name, value) for name, value in self.values.items()}
        object.__setattr__(self, "values", self.effect.checked(values))
        for parameter in self.parameters:
            if parameter.name not in self.values:
                needed = ", ".join(p.name for p in self.parameters)
                raise InputError(f"{where} at {self.site}", f"no value for {parameter.name!r}", needed)
            if not parameter.prior.is_signed and self.values[parameter.name] < 0:
                found = f"{parameter.name} = {self.values[parameter.name]:g}"
                raise InputError(where, found, f"no negative {parameter.meaning}")
        std = {name: _number(where, f"standard deviation of {name}", value) for name, value in self.std.items()}
        for name, value in std.items():
            if name not in self.values:
                hint = did_you_mean(name, tuple(self.values))
                raise InputError(f"{where}: std", f"no parameter {name!r}", ", ".join(self.values), hint)
            if value < 0:
                raise InputError(f"{where}: standard deviation of {name}", f"{value:g}", "0 or more")
        object.__setattr__(self, "std", std)

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """The effect's parameters at this kind of site; units are those of the catalogue without a record."""
        return _parameters(self.effect, self.site)

    @property
    def key(self) -> str:
        """Id and site, as `attach` takes them."""
        return f"{self.effect.id}@{self.site.name}"

    @property
    def load_name(self) -> str:
        """Name of an input that stands for it as a bounded force or error."""
        return f"load {self.site.name}: {self.effect.id}"

    @property
    def in_words(self) -> str:
        """Title and site."""
        return f"{self.effect.title} at {self.site.name}"

    @property
    def values_in_words(self) -> str:
        """Equation, values and source."""
        said = ", ".join(f"{name} = {value:.6g}" for name, value in self.values.items())
        if self.amplitude is not None:
            said += f", {self.amplitude[0]} = {self.amplitude[1]:.6g}"
        return f"{self.effect.equation} with {said}" + (f"; {self.source}" if self.source else "")

    @property
    def amplitude(self) -> tuple[str, float, float] | None:
        """Name, value and standard deviation (of uncorrelated parts) of what `Effect.amplitude` names."""
        if not self.effect.amplitude:
            return None
        name, *parts = self.effect.amplitude
        size = math.hypot(*(self.values[p] for p in parts))
        spread = math.hypot(*(self.values[p] * self.std.get(p, 0.0) for p in parts))
        return name, size, spread / size if size else 0.0

    @property
    def on_signal(self) -> bool:
        """True for effects on an input or output."""
        return self.site.kind in ("input", "output")

    @property
    def scale(self) -> float | None:
        """By what it multiplies its signal, or the parameters of its site, if that is all it does."""
        return self.values.get(self.effect.scale)

    @property
    def scale_std(self) -> float:
        """Standard deviation of `scale`; 0 where no fit has determined it."""
        return self.std.get(self.effect.scale, 0.0)

    def laws(self) -> tuple[Law, ...]:
        """Its force laws."""
        return self.effect.laws(self.site, self.values)

    # --- on a constant signal ----------------------------------------------------------------------------------------

    def mapped(self, level: float) -> float:
        """A constant input or output after the effect."""
        if self.site.kind == "input":
            return float(self.effect.input(np.full(ASKED_SAMPLES, level), self.values, ASKED_STEP)[-1])
        return float(self.effect.output(np.full((1, ASKED_SAMPLES), level), self.values, ASKED_STEP)[0, -1])

    def slope(self, level: float) -> float:
        """Slope of `mapped` at a level."""
        step = TUNING.signal_step * max(abs(level), TUNING.least_level)
        return extrapolated(lambda h: (self.mapped(level + h) - self.mapped(level - h)) / (2 * h), step)

    def gain(self, level: float, amplitude: Mapping[str, float]) -> float:
        """Gain of an effect on an input or output about a level of its signal, or the middle of its sector."""
        seen = self.sector(amplitude, ("input", "output"))
        if seen is not None:
            return 0.5 * (seen.gain_lower + seen.gain_upper)
        constant = self.constant_gain  # perhaps with a delay or an offset
        return constant if constant is not None else self.slope(level) or 1.0

    def input_error(self, width: float = 0.0) -> float | None:
        """Bound of what it adds to any input, fitted values ``width`` standard deviations up; None: there is none."""
        return self.effect.input_error({n: v + width * self.std.get(n, 0.0) for n, v in self.values.items()})

    # --- footprints --------------------------------------------------------------------------------------------------

    def footprint(self, amplitude: float = DEFAULT_AMPLITUDE) -> Footprint | None:
        """The effect's footprint at an amplitude of its signal."""
        return self.effect.footprint(self.site, self.values, amplitude)

    def sector(self, amplitude: Mapping[str, float], signals: tuple[str, ...]) -> Footprint | None:
        """The footprint at an amplitude that was asked for its site, if it is a sector in one of these signals."""
        if self.site.name not in amplitude:
            return None
        found = self.footprint(amplitude[self.site.name])
        return found if found is not None and found.signal in signals and found.gain_upper > found.gain_lower else None

    @property
    def delay(self) -> float:
        """Pure delay in s that it stands for."""
        found = self.footprint()
        return 0.0 if found is None else found.delay

    @property
    def time_constant(self) -> float:
        """Time constant in s of a lag of an input; 0 where it is none."""
        return self.values.get(self.effect.time_constant, 0.0)

    @property
    def constant_gain(self) -> float | None:
        """The gain that the footprint has at all amplitudes, or None."""
        seen = [self.footprint(amplitude) for amplitude in (1e-6, 1.0, 1e6)]
        gains = {gain for f in seen if f is not None for gain in (f.gain_lower, f.gain_upper)}
        return gains.pop() if len(gains) == 1 else None

    def corners(self, width: float) -> Iterator[dict[str, float]]:
        """The values at the corners of the ranges of those that are fitted, ``width`` standard deviations."""
        spread = {name: width * std for name, std in self.std.items() if std}
        positive = {p.name for p in self.parameters if not p.prior.is_signed}
        for signs in itertools.product(*[(-1.0, 1.0)] * len(spread)):
            moved = {n: self.values[n] + s * spread[n] for n, s in zip(spread, signs, strict=True)}
            least = {n: max(v, 1e-3 * self.values[n]) if n in positive else v for n, v in moved.items()}
            yield {**self.values, **least}

    def footprints(self, amplitude: float, width: float) -> Iterator[Footprint]:
        """Footprints at the `corners`."""
        for values in self.corners(width):
            found = self.effect.footprint(self.site, values, amplitude)
            if found is not None:
                yield found

    def largest_offset(self, width: float) -> float:
        """Bound of what is no gain of the signal, over the ranges of fitted values; 0 where there is none."""
        return max((f.offset for f in self.footprints(DEFAULT_AMPLITUDE, width)), default=0.0)

    def largest_gain(self, width: float) -> float:
        """Largest gain of the signal, over the ranges of fitted values; 0 where there is none."""
        gains = (max(abs(f.gain_lower), abs(f.gain_upper)) for f in self.footprints(DEFAULT_AMPLITUDE, width))
        return max(gains, default=0.0)

    def to_json(self) -> dict[str, Any]:
        """Id, title, equation, site, source, and the parameters with value, standard deviation and unit."""
        return {
            "id": self.effect.id,
            "title": self.effect.title,
            "equation": self.effect.equation,
            "site": self.site.name,
            "site_kind": self.site.kind,
            "source": self.source,
            "parameters": {
                p.name: {
                    "value": self.values[p.name],
                    "std": self.std.get(p.name),
                    "unit": p.unit,
                    "meaning": p.meaning,
                }
                for p in self.parameters
            },
        }

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.values.items())
        return f"{self.effect.id}@{self.site.name}({values})"


def _number(where: str, name: str, value: Any) -> float:
    return float(real_array(name, value, 0, where))


def _parameters(effect: Effect, site: Site) -> tuple[EffectParameter, ...]:
    # Effects that may scale a parameter or act at a joint tell the two by the unit of force.
    return effect.parameters(Scales(force_unit="N" if site.kind in ("joint", "current") else ""))


def attach(
    key: str, given: Mapping[str, Any], plant: AnyPlant, model: PortModel, taken: Iterable[AttachedEffect] = ()
) -> AttachedEffect:
    """The effect named by ``key`` (``"id"`` or ``"id@site"``) with the given values at its only, or named, site.

    Parameters
    ----------
    given
        Name -> value, or (value, standard deviation).
    taken
        Effects that the plant has already.

    Raises
    ------
    InputError
        Unknown effect or site (with the closest name), no site at all, several and none named, the same one twice.
    """
    from robustlab.dynamics.effects.catalogue import effect as named

    name, _, place = key.partition("@")
    effect = named(name)
    where = f"effect {name}"
    if not isinstance(given, Mapping):
        raise InputError(where, f"{given!r}", "a table of its parameters: name -> value or (value, standard deviation)")
    values: dict[str, float] = {}
    std: dict[str, float] = {}
    for parameter, value in given.items():
        if isinstance(value, (tuple, list)):
            if len(value) != 2:
                raise InputError(
                    f"{where}: {parameter}", f"{len(value)} entries", "a value or (value, standard deviation)"
                )
            values[parameter], std[parameter] = value
        else:
            values[parameter] = value
    values = effect.checked({n: _number(where, n, v) for n, v in values.items()})
    sites = [s for s in effect.sites(plant, model) if {p.name for p in _parameters(effect, s)} == set(values)]
    attached = AttachedEffect(effect, _site(where, sites, place, plant), values, std)
    if any(other.effect.id == name and other.site == attached.site for other in taken):
        raise InputError(f"{where} at {attached.site}", "given twice", "each effect once at a site")
    return attached


def _site(where: str, sites: list[Site], place: str, plant: AnyPlant) -> Site:
    names = [site.name for site in sites]
    if not sites:
        raise InputError(where, f"{plant.name} has no place for it", "a plant with such a joint, input or parameter")
    if not place:
        if len(sites) == 1:
            return sites[0]
        head, shown = where.removeprefix("effect "), ", ".join(names)
        raise InputError(
            where, f"{len(sites)} places where it may sit: {shown}", "one", f'name it: "{head}@{names[0]}"'
        )
    for site in sites:
        if place == site.name or (site.kind == "parameter" and place in site.name.split("+")):
            return site
    raise InputError(
        f"{where}: site {place!r}", "no such place", f"one of {', '.join(names)}", did_you_mean(place, names)
    )
