"""Effects with values at a place: gain, sector, delay or bound; force laws at a point: force, band at rest, slopes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.effect import Effect, EffectParameter, Footprint, Law, Scales, Site
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.errors import InputError, did_you_mean, unknown_name
from robustlab.statespace import real_array

# Length of the step in s for the evaluation of a law; the position changes by v times this.
INSTANT = 1e-5
# The compliance lets the force change the velocity by this share. Larger: fewer digits lost, slower convergence.
COMPLIANCE_SHARE = 1e-3
# Relative convergence of forces, and largest number of passes.
FORCE_AGREED = 1e-13
FORCE_PASSES = 60
# Velocity (rad/s, m/s, A) next to rest; a law that rises faster counts as a jump.
CREEP = 1e-9
# Initial steps of the differences: in position (rad, m), as a share of the velocity, and at rest (rad/s, m/s). The
# first two are extrapolated to zero.
POSITION_STEP = 1e-4
VELOCITY_STEP = 1e-2
REST_STEP = 1e-6
# Reduction of the step in each level of the extrapolation, and largest number of levels.
SHRINK = 1.4
LEVELS = 10
# Displacement (rad, m) far below sliding, and its slow and quick durations in s.
DISPLACEMENT = 1e-12
SLOW = 1e3
QUICK = 1e-6
# Initial step of the slope of an input or output map as a share of the signal, and least level.
SIGNAL_STEP = 1e-3
LEAST_LEVEL = 1e-3

ANY_TIME = math.inf


def _law_force(law: Law, seen: list[float], z: Array) -> tuple[float, Array]:
    """Return force and memory of a law; ``seen`` in the order of the kernel."""
    after = z.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        parameters = np.array(law.parameters, dtype=np.float64)
        force = float(law.function(parameters, z, after, np.array(seen, dtype=np.float64)))
    return force, after


def steady_force(law: Law, q: float, v: float) -> float:
    """Return the force at the position q and constant velocity ``v != 0``, memory in steady state."""
    force, z, h = 0.0, np.zeros(max(1, law.memory)), INSTANT
    g = 1e-12 * abs(v)
    for _ in range(FORCE_PASSES):
        half = 0.0 if law.memory else 0.5 * v * h
        gq = 0.5 * g * h
        found, z = _law_force(law, [q - half, v, q + half - gq * force, v - g * force, gq, g, h, ANY_TIME], z)
        settled = abs(found - force) <= FORCE_AGREED * abs(found) and (not law.memory or h > 1e3)
        force = found
        if settled:
            break
        g = COMPLIANCE_SHARE * abs(v) / max(abs(force), 1e-30)
        h = 4.0 * h if law.memory else h
    return force


def rest_band(law: Law, q: float) -> tuple[float, float]:
    """Return the smallest and largest holding force at rest at the position q."""
    forward, backward = steady_force(law, q, CREEP), steady_force(law, q, -CREEP)
    return min(forward, backward), max(forward, backward)


def is_set_valued(law: Law, q: float) -> bool:
    """Return whether the force jumps with the direction of motion."""
    if law.memory:
        return False
    low, high = rest_band(law, q)
    slower = abs(steady_force(law, q, -1e-2 * CREEP) - steady_force(law, q, 1e-2 * CREEP))
    return high > low and slower > 0.5 * (high - low)


def holding_force(law: Law, q: float, acceleration: float, mobility: float) -> float:
    """Return the force at a port at rest: that which holds it if possible, else that of the starting motion."""
    h = INSTANT
    seen = [q, 0.0, q, h * acceleration, 0.0, h * mobility, h, ANY_TIME]
    return _law_force(law, seen, np.zeros(max(1, law.memory)))[0]


def slopes(law: Law, q: float, v: float) -> tuple[float, float]:
    """Return ``(df/dq, df/dv)`` at a position and velocity, by central differences."""
    # Ridders, "Accurate computation of F'(x) and F'(x)F''(x)", Advances in Engineering Software 4 (1982).

    def at(position: float, velocity: float) -> float:
        if velocity == 0.0:
            return sum(rest_band(law, position)) / 2.0
        return steady_force(law, position, velocity)

    def by_velocity(step: float) -> float:
        return (at(q, v + step) - at(q, v - step)) / (2.0 * step)

    if law.memory and v == 0.0:
        return _presliding(law, q)
    damping = by_velocity(REST_STEP) if v == 0.0 else extrapolated(by_velocity, VELOCITY_STEP * abs(v))
    return extrapolated(lambda step: (at(q + step, v) - at(q - step, v)) / (2.0 * step), POSITION_STEP), damping


def _presliding(law: Law, q: float) -> tuple[float, float]:
    """Return `slopes` of a law with memory at rest, from a slow and a quick displacement far below sliding."""

    def resisting(h: float, z: Array) -> tuple[float, Array]:
        v, force, after = DISPLACEMENT / h, 0.0, z
        for _ in range(FORCE_PASSES):
            g = COMPLIANCE_SHARE * v / max(abs(force), 1e-30)
            found, after = _law_force(law, [q, v, q + DISPLACEMENT, v - g * force, 0.0, g, h, ANY_TIME], z)
            if abs(found - force) <= FORCE_AGREED * abs(found):
                break
            force = found
        return force, after

    still = np.zeros(max(1, law.memory))
    slow, displaced = resisting(SLOW, still)
    further, _ = resisting(SLOW, displaced)
    quick, _ = resisting(QUICK, still)
    return (further - slow) / DISPLACEMENT, (quick - slow) * QUICK / DISPLACEMENT


def extrapolated(difference: Callable[[float], float], step: float) -> float:
    """Extrapolate a central difference to zero step by Ridders' table."""
    row = [difference(step)]
    best, error = row[0], np.inf
    for level in range(1, LEVELS):
        step /= SHRINK
        next_row, factor = [difference(step)], SHRINK**2
        for k in range(level):
            next_row.append((next_row[k] * factor - row[k]) / (factor - 1.0))
            factor *= SHRINK**2
            found = max(abs(next_row[k + 1] - next_row[k]), abs(next_row[k + 1] - row[k]))
            if found <= error:
                best, error = next_row[k + 1], found
        if abs(next_row[-1] - row[-1]) >= 2.0 * error:
            break
        row = next_row
    return float(best)


# Default amplitude of footprints.
DEFAULT_AMPLITUDE = 1.0
# Number and step in s of the samples of a constant signal for the evaluation of a map.
MAP_SAMPLES, MAP_STEP = 8, 1e-3


@dataclass(frozen=True)
class AttachedEffect:
    """One effect of a plant."""

    effect: Effect
    site: Site
    values: Mapping[str, float]  # name -> value of each parameter
    std: Mapping[str, float] = field(default_factory=dict)  # name -> standard deviation of fitted values
    source: str = ""  # of the values: a record, a fit, a data sheet

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
        """Parameters at this kind of site; units are those of the catalogue without a record."""
        return _parameters(self.effect, self.site)

    @property
    def key(self) -> str:
        return f"{self.effect.id}@{self.site.name}"

    @property
    def load_name(self) -> str:
        """Name of the input that replaces it as a bounded force or error."""
        return f"load {self.site.name}: {self.effect.id}"

    @property
    def in_words(self) -> str:
        return f"{self.effect.title} at {self.site.name}"

    @property
    def values_in_words(self) -> str:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in self.values.items())
        if self.amplitude is not None:
            values += f", {self.amplitude[0]} = {self.amplitude[1]:.6g}"
        return f"{self.effect.equation} with {values}" + (f"; {self.source}" if self.source else "")

    @property
    def amplitude(self) -> tuple[str, float, float] | None:
        """Name, value and standard deviation (for uncorrelated parts) of `Effect.amplitude`."""
        if not self.effect.amplitude:
            return None
        name, *parts = self.effect.amplitude
        size = math.hypot(*(self.values[p] for p in parts))
        spread = math.hypot(*(self.values[p] * self.std.get(p, 0.0) for p in parts))
        return name, size, spread / size if size else 0.0

    @property
    def on_signal(self) -> bool:
        return self.site.kind in ("input", "output")

    @property
    def scale(self) -> float | None:
        """Factor of the signal or the parameters of its site, for an effect that only multiplies."""
        return self.values.get(self.effect.scale)

    @property
    def scale_std(self) -> float:
        return self.std.get(self.effect.scale, 0.0)

    def laws(self) -> tuple[Law, ...]:
        return self.effect.laws(self.site, self.values)

    def mapped(self, level: float) -> float:
        """Return a constant input or output after the effect."""
        if self.site.kind == "input":
            return float(self.effect.input(np.full(MAP_SAMPLES, level), self.values, MAP_STEP)[-1])
        return float(self.effect.output(np.full((1, MAP_SAMPLES), level), self.values, MAP_STEP)[0, -1])

    def slope(self, level: float) -> float:
        """Return the slope of `mapped` at a level."""
        step = SIGNAL_STEP * max(abs(level), LEAST_LEVEL)
        return extrapolated(lambda h: (self.mapped(level + h) - self.mapped(level - h)) / (2 * h), step)

    def gain(self, level: float, amplitude: Mapping[str, float]) -> float:
        """Return the gain of an effect on an input or output at a level of its signal, or the middle of its sector."""
        seen = self.sector(amplitude, ("input", "output"))
        if seen is not None:
            return 0.5 * (seen.gain_lower + seen.gain_upper)
        constant = self.constant_gain
        return constant if constant is not None else self.slope(level) or 1.0

    def input_error(self, width: float = 0.0) -> float | None:
        """Return a bound of its error on any input, with fitted values ``width`` standard deviations up, or None."""
        return self.effect.input_error({n: v + width * self.std.get(n, 0.0) for n, v in self.values.items()})

    def footprint(self, amplitude: float = DEFAULT_AMPLITUDE) -> Footprint | None:
        return self.effect.footprint(self.site, self.values, amplitude)

    def sector(self, amplitude: Mapping[str, float], signals: tuple[str, ...]) -> Footprint | None:
        """Return the footprint at the amplitude given for its site, if it is a sector of one of these signals."""
        if self.site.name not in amplitude:
            return None
        found = self.footprint(amplitude[self.site.name])
        return found if found is not None and found.signal in signals and found.gain_upper > found.gain_lower else None

    @property
    def delay(self) -> float:
        return self.values.get(self.effect.delay, 0.0)

    @property
    def time_constant(self) -> float:
        """Time constant in s of a lag of an input, else 0."""
        return self.values.get(self.effect.time_constant, 0.0)

    @property
    def constant_gain(self) -> float | None:
        """Gain of the footprint if equal at all amplitudes, else None."""
        seen = [self.footprint(amplitude) for amplitude in (1e-6, 1.0, 1e6)]
        gains = {gain for f in seen if f is not None for gain in (f.gain_lower, f.gain_upper)}
        return gains.pop() if len(gains) == 1 else None

    def corners(self, width: float) -> Iterator[dict[str, float]]:
        """Yield the values at the corners of the ranges of fitted ones, ``width`` standard deviations wide."""
        spread = {name: width * std for name, std in self.std.items() if std}
        positive = {p.name for p in self.parameters if not p.prior.is_signed}
        for signs in itertools.product(*[(-1.0, 1.0)] * len(spread)):
            moved = {n: self.values[n] + s * spread[n] for n, s in zip(spread, signs, strict=True)}
            least = {n: max(v, 1e-3 * self.values[n]) if n in positive else v for n, v in moved.items()}
            yield {**self.values, **least}

    def footprints(self, amplitude: float, width: float) -> Iterator[Footprint]:
        for values in self.corners(width):
            found = self.effect.footprint(self.site, values, amplitude)
            if found is not None:
                yield found

    def largest_offset(self, width: float) -> float:
        return max((f.offset for f in self.footprints(DEFAULT_AMPLITUDE, width)), default=0.0)

    def largest_gain(self, width: float) -> float:
        """Return the largest gain of the signal over the ranges of fitted values."""
        gains = (max(abs(f.gain_lower), abs(f.gain_upper)) for f in self.footprints(DEFAULT_AMPLITUDE, width))
        return max(gains, default=0.0)

    def to_json(self) -> dict[str, Any]:
        parameters = {
            p.name: {"value": self.values[p.name], "std": self.std.get(p.name), "unit": p.unit, "meaning": p.meaning}
            for p in self.parameters
        }
        texts = {name: getattr(self.effect, name) for name in ("id", "title", "equation")}
        place = {"site": self.site.name, "site_kind": self.site.kind, "source": self.source}
        return {**texts, **place, "parameters": parameters}

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.values.items())
        return f"{self.effect.id}@{self.site.name}({values})"


def _number(where: str, name: str, value: Any) -> float:
    return float(real_array(name, value, 0, where))


def _parameters(effect: Effect, site: Site) -> tuple[EffectParameter, ...]:
    # The unit of force distinguishes a force at a joint from a factor of a parameter.
    return effect.parameters(Scales(force_unit="N" if site.kind in ("joint", "current") else ""))


def attach(key: str, given: Mapping[str, Any], plant: AnyPlant, model: PortModel) -> AttachedEffect:
    """Return the effect ``"id"`` or ``"id@site"`` with the given values at its only, or named, site."""
    from robustlab.dynamics.effects.catalogue import effect as named

    name, _, place = key.partition("@")
    effect = named(name)
    where = f"effect {name}"
    if not isinstance(given, Mapping):
        raise InputError(where, f"{given!r}", "a table of its parameters: name -> value or (value, standard deviation)")
    values: dict[str, float] = {}
    std: dict[str, float] = {}
    for parameter, value in given.items():
        if not isinstance(value, (tuple, list)):
            values[parameter] = value
            continue
        if len(value) != 2:
            raise InputError(f"{where}: {parameter}", f"{len(value)} entries", "a value or (value, standard deviation)")
        values[parameter], std[parameter] = value
    values = effect.checked({n: _number(where, n, v) for n, v in values.items()})
    sites = [s for s in effect.sites(plant, model) if {p.name for p in _parameters(effect, s)} == set(values)]
    names = [site.name for site in sites]
    if not sites:
        raise InputError(where, f"{plant.name} has no place for it", "a plant with such a joint, input or parameter")
    if not place and len(sites) > 1:
        found = f"{len(sites)} places where it may sit: {', '.join(names)}"
        raise InputError(where, found, "one", f'name it: "{name}@{names[0]}"')
    for site in sites:
        if place in ("", site.name) or (site.kind == "parameter" and place in site.name.split("+")):
            return AttachedEffect(effect, site, values, std)
    raise unknown_name(f"{where}: site {place!r}", "no such place", place, names)
