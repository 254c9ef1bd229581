"""An effect at its place, with numbers, and what it is there: a gain of its signal, a sector, a delay, a bound; and a
force law seen at one instant: its force at a velocity, its band at rest, its slopes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Law, Scales, Site
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.errors import InputError, did_you_mean, unknown_name
from robustlab.statespace import real_array

# Length of the step in s in which a law is asked; positions move through their value by v times this.
INSTANT = 1e-5
# The compliance is chosen so that the force changes the velocity by this share: its rounding costs three digits.
# Larger: fewer digits lost, slower to settle.
COMPLIANCE_SHARE = 1e-3
# Forces agree to this share, after so many passes at most.
FORCE_AGREED = 1e-13
FORCE_PASSES = 60
# Velocity (rad/s, m/s, A) at which "just moving" is looked at; a law that rises faster counts as a jump.
CREEP = 1e-9
# First steps of the differences: in position (rad, m), as a share of the velocity, and at rest (rad/s, m/s).
# Larger: farther from the point, less rounding; extrapolation takes the first two to the limit.
POSITION_STEP = 1e-4
VELOCITY_STEP = 1e-2
REST_STEP = 1e-6
# Each level of the extrapolation shrinks the step by this; so many levels at most.
SHRINK = 1.4
LEVELS = 10
# A displacement (rad, m) at which no bristle or spring gives way, made slowly and quickly (s).
DISPLACEMENT = 1e-12
SLOW = 1e3
QUICK = 1e-6
# Share of the signal over which the slope of an input or output map is taken, and the least level for it.
SIGNAL_STEP = 1e-3
LEAST_LEVEL = 1e-3

ANY_TIME = math.inf


def _asked(law: Law, seen: list[float], z: Array) -> tuple[float, Array]:
    """Force and memory that the law answers with; ``seen`` in the order of the kernel."""
    after = z.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        parameters = np.array(law.parameters, dtype=np.float64)
        force = float(law.function(parameters, z, after, np.array(seen, dtype=np.float64)))
    return force, after


def steady_force(law: Law, q: float, v: float) -> float:
    """Force at the position q while the port moves at the constant velocity ``v != 0``, memory settled."""
    force, z, h = 0.0, np.zeros(max(1, law.memory)), INSTANT
    g = 1e-12 * abs(v)
    for _ in range(FORCE_PASSES):
        half = 0.0 if law.memory else 0.5 * v * h
        gq = 0.5 * g * h
        found, z = _asked(law, [q - half, v, q + half - gq * force, v - g * force, gq, g, h, ANY_TIME], z)
        settled = abs(found - force) <= FORCE_AGREED * abs(found) and (not law.memory or h > 1e3)
        force = found
        if settled:
            break
        g = COMPLIANCE_SHARE * abs(v) / max(abs(force), 1e-30)
        h = 4.0 * h if law.memory else h
    return force


def rest_band(law: Law, q: float) -> tuple[float, float]:
    """Smallest and largest force with which the law may hold its port at rest at the position q."""
    forward, backward = steady_force(law, q, CREEP), steady_force(law, q, -CREEP)
    return min(forward, backward), max(forward, backward)


def is_set_valued(law: Law, q: float) -> bool:
    """True where the force jumps with the direction of motion: the band at rest does not shrink with the speed."""
    if law.memory:
        return False
    low, high = rest_band(law, q)
    slower = abs(steady_force(law, q, -1e-2 * CREEP) - steady_force(law, q, 1e-2 * CREEP))
    return high > low and slower > 0.5 * (high - low)


def holding_force(law: Law, q: float, acceleration: float, mobility: float) -> float:
    """Force at a port at rest: the one that keeps it there if the law has it, else that of the motion that begins."""
    h = INSTANT
    seen = [q, 0.0, q, h * acceleration, 0.0, h * mobility, h, ANY_TIME]
    return _asked(law, seen, np.zeros(max(1, law.memory)))[0]


def slopes(law: Law, q: float, v: float) -> tuple[float, float]:
    """``(df/dq, df/dv)`` at a position and velocity, by central differences of the law's force."""
    # Ridders, "Accurate computation of F'(x) and F'(x)F''(x)", Advances in Engineering Software 4 (1982).

    def at(position: float, velocity: float) -> float:
        if velocity == 0.0:
            return sum(rest_band(law, position)) / 2.0
        return steady_force(law, position, velocity)

    def by_velocity(step: float) -> float:
        return (at(q, v + step) - at(q, v - step)) / (2.0 * step)

    def by_position(step: float) -> float:
        return (at(q + step, v) - at(q - step, v)) / (2.0 * step)

    if law.memory and v == 0.0:
        return _presliding(law, q)
    damping = by_velocity(REST_STEP) if v == 0.0 else extrapolated(by_velocity, VELOCITY_STEP * abs(v))
    return extrapolated(by_position, POSITION_STEP), damping


def _presliding(law: Law, q: float) -> tuple[float, float]:
    """The same for a law with memory at rest: what resists two displacements far below sliding, slow and quick."""

    def resisting(h: float, z: Array) -> tuple[float, Array]:
        v, force, after = DISPLACEMENT / h, 0.0, z
        for _ in range(FORCE_PASSES):
            g = COMPLIANCE_SHARE * v / max(abs(force), 1e-30)
            found, after = _asked(law, [q, v, q + DISPLACEMENT, v - g * force, 0.0, g, h, ANY_TIME], z)
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
    """Limit of a central difference with the step, by the row of Ridders' table with the smallest error."""
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


# Amplitude at which footprints are given where none was asked for.
DEFAULT_AMPLITUDE = 1.0
# What a map is asked for a constant signal: so many samples of so many seconds.
ASKED_SAMPLES, ASKED_STEP = 8, 1e-3


@dataclass(frozen=True)
class AttachedEffect:
    """One effect of a plant."""

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
        return self.effect.laws(self.site, self.values)

    def mapped(self, level: float) -> float:
        """A constant input or output after the effect."""
        if self.site.kind == "input":
            return float(self.effect.input(np.full(ASKED_SAMPLES, level), self.values, ASKED_STEP)[-1])
        return float(self.effect.output(np.full((1, ASKED_SAMPLES), level), self.values, ASKED_STEP)[0, -1])

    def slope(self, level: float) -> float:
        """Slope of `mapped` at a level."""
        step = SIGNAL_STEP * max(abs(level), LEAST_LEVEL)
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

    def footprint(self, amplitude: float = DEFAULT_AMPLITUDE) -> Footprint | None:
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
        e, own = self.effect, {p.name: p for p in self.parameters}
        parameters = {
            name: {"value": self.values[name], "std": self.std.get(name), "unit": p.unit, "meaning": p.meaning}
            for name, p in own.items()
        }
        return {
            "id": e.id,
            "title": e.title,
            "equation": e.equation,
            "site": self.site.name,
            "site_kind": self.site.kind,
            "source": self.source,
            "parameters": parameters,
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
    """The effect named by ``key`` (``"id"`` or ``"id@site"``) with the given values at its only, or named, site."""
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
    raise unknown_name(f"{where}: site {place!r}", "no such place", place, names)
