"""Base class of effects: name, equation, parameters with priors, and the interface to a plant."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, parameter_groups
from robustlab.errors import InputError, did_you_mean

SiteKind = Literal["joint", "current", "input", "output", "parameter"]


@dataclass(frozen=True)
class Prior:
    r"""Distribution of a parameter, as a map from a standard normal z.

    ``"log"``: :math:`c\, e^{s z}`; ``"linear"``: :math:`c + s z`; ``"share"``: a share of ``top``,
    :math:`\mathrm{top} / (1 + e^{-(m + s z)})` with the median ``centre``; ``"between"``: the same between ``bottom``
    and ``top``, of either sign. The centre of ``"log"`` may be negative: the parameter is then negative.
    """

    kind: Literal["log", "linear", "share", "between"]
    centre: float
    spread: float
    top: float = 1.0
    bottom: float = 0.0

    @property
    def is_signed(self) -> bool:
        """False if the parameter is always positive."""
        return self.kind in ("linear", "between") or self.centre < 0.0

    def value(self, z: float) -> float:
        """Return the parameter at the standardised z."""
        if self.kind == "log":
            return self.centre * math.exp(max(-40.0, min(40.0, self.spread * z)))
        if self.kind == "linear":
            return self.centre + self.spread * z
        median = math.log((self.centre - self.bottom) / (self.top - self.centre))
        part = 1.0 / (1.0 + math.exp(-max(-40.0, min(40.0, median + self.spread * z))))
        return self.bottom + (self.top - self.bottom) * part

    def standardised(self, value: float) -> float:
        """Return the z of a parameter value."""
        if self.kind == "log":
            return math.log(value / self.centre) / self.spread
        if self.kind == "linear":
            return (value - self.centre) / self.spread
        median = math.log((self.centre - self.bottom) / (self.top - self.centre))
        return (math.log((value - self.bottom) / (self.top - value)) - median) / self.spread


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect: symbol, unit, meaning in words, and prior."""

    name: str
    unit: str
    meaning: str
    prior: Prior


@dataclass(frozen=True)
class Site:
    """Place of an effect: kind and name."""

    kind: SiteKind
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Scales:
    """Magnitudes in a record, for priors and initial values."""

    # at the site's port: RMS of the driving force, largest speed, range of the position; 1 if unknown
    force: float = 1.0
    speed: float = 1.0
    position: float = 1.0
    # extremes of the position; None if unknown
    lowest: float | None = None
    highest: float | None = None
    inertia: float = 1.0  # force per acceleration at the port
    # possible load shares of a joint's inertia (`robustlab.dynamics.ports.port_model.shares_behind`)
    shares: tuple[float, ...] = ()
    input: float = 1.0  # largest absolute value of the site's input
    output: float = 1.0  # half the range of the site's output
    zero: float = 0.1  # possible offset of a sensor, over `output`
    current: float = 1.0  # largest absolute current
    # sample time and length of the record in s
    dt: float = 1e-3
    duration: float = 1.0
    # strongest spatial frequencies of the residual force in rad^-1 or m^-1, strongest first (empty: not computed)
    orders: tuple[float, ...] = ()
    # strongest lines of the residual force over time in Hz, strongest first (empty: none significant)
    lines: tuple[float, ...] = ()
    side: int = 0  # side of a position beyond which an effect acts: 1 above, -1 below, 0 either
    # units at the site
    force_unit: str = ""
    speed_unit: str = ""
    position_unit: str = ""
    signal_unit: str = ""


@dataclass(frozen=True, eq=False)
class Law:
    """A compiled force law at a port of the (extended) model."""

    function: Any  # compiled by `robustlab.dynamics.ports.law_kernel.law`
    port: str  # name of the port
    parameters: tuple[float, ...]  # argument p of the function
    memory: int = 0  # number of memory cells, initially zero


@dataclass(frozen=True)
class Footprint:
    """Description of an effect for robust design."""

    port: str  # name of the port or signal at which it acts
    signal: str  # its argument: "speed", "position", "input", "output", "current", "force", "time"
    # Sector: the effect is between these two gains (force per speed, and so on) at the given amplitude.
    gain_lower: float
    gain_upper: float
    delay: float = 0.0  # pure delay in s
    offset: float = 0.0  # bound of the part that is no gain of the signal (a constant load)
    # Describing function at this amplitude, for a law whose gain decreases with it; NaN: unknown.
    describing: float = math.nan


# Attributes and parameters of the effects of the catalogue: id -> row.
TABLE = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))
OWN: dict[str, Effect] = {}  # id -> effect, of all loaded modules of effects


def _measure(kind: str, s: Scales) -> tuple[str, float]:
    """Return unit and size at a site of a quantity of `effects.toml`: ``"F/q"``, ``"dt"``, or a plain unit."""
    force, speed, at = s.force_unit, s.speed_unit, s.position_unit or s.speed_unit.removesuffix("/s")
    known = {
        "F": (force, s.force),
        "v": (speed, s.speed),
        "q": (s.position_unit, s.position),
        "F/q": (f"{force}/{at}" if force and at else "", s.force / s.position),
        "F/v": (f"{force} s/{at}" if force and at else "", s.force / s.speed),
        "F/v2": (f"{force}/({speed})2" if force and speed else "", s.force / s.speed**2),
        "F/q3": (f"{force}/{at}3" if force and at else "", s.force / s.position**3),
        "rad/q": (f"rad/{s.position_unit}" if s.position_unit else "", 1.0),
        "rad/y": (f"rad/{s.signal_unit}" if s.signal_unit else "", 1.0),
        "u": (s.signal_unit, s.input),
        "y": (s.signal_unit, s.output),
        "dt": ("s", s.dt),
        "duration": ("s", s.duration),
    }
    return known.get(kind, (kind, 1.0))


def _prior(size: float, kind: Any, centre: float, spread: float) -> Prior:
    if kind == "share":
        return Prior(kind, centre * size, spread, top=size)
    return Prior(kind, centre * size, spread * size if kind == "linear" else spread)


class Effect:
    """One physical effect; those of the catalogue have their texts and parameters in `effects.toml`."""

    id: str  # name in the catalogue
    title: str
    equation: str  # one line, with the symbols of the parameters
    site_kind: SiteKind
    # Instruction for an independent check without a record of the motion; empty: none.
    independently: str = ""
    # Person's name at the start of the title, which keeps its capital within a sentence.
    person: str = ""
    # Id of the effect that this one contains and refines.
    refines: str | None = None
    # Ids of effects whose sum is equivalent; `discover` reports those.
    equals: tuple[str, ...] = ()
    nameable: bool = True  # False for known noise (quantisation)
    needs_position: bool = False  # True if it applies only to joints whose position is a state
    # True if its period over the position is a parameter; one trial for each strong spatial line (``scales.orders``).
    spatial: bool = False
    # Parameter with the frequency in Hz of an effect periodic in time; one trial for each line (``scales.lines``).
    timed: str = ""
    # True if other values of the plant's parameters can replace it (a gain, a wrong parameter), within tolerances.
    gain_like: bool = False
    # Parameter that is the gain of an effect that only multiplies a signal or parameters of the plant.
    scale: str = ""
    delay: str = ""  # parameter with the delay in s
    time_constant: str = ""  # parameter with the time constant in s of a first-order lag of an input
    # Name of the amplitude, and the two parameters with its cosine and sine part.
    amplitude: tuple[str, ...] = ()
    # Parameter for which a record may determine only a lower bound.
    told_from_below: str = ""
    # Balance at constant speed to which it adds a constant loss.
    constant_loss: Literal["", "torque", "voltage"] = ""
    # Default relative tolerance of the plant's parameters with the role `id`.
    tolerance: float = 0.10
    # True if it splits the joint in two (backlash, a flexible coupling); at most one for each plant.
    structural: bool = False
    # True if its memory outlasts a window (heat), so that windows must be simulated in order.
    long_memory: bool = False
    # Its force law at the port of its site (`robustlab.dynamics.ports.law_kernel.law`), and that law's memory cells.
    force: Any = None
    memory: int = 0
    # Table rows of its parameters, and of one parameter the initial values in units of its size.
    rows: Mapping[str, tuple[Any, ...]] = {}
    started: Mapping[str, tuple[float, ...]] = {}

    def __init_subclass__(cls, ids: str = "") -> None:
        """Register effects of the catalogue with these ids."""
        for name in ids.split():
            OWN[name] = cls(name)

    def __init__(self, name: str = "") -> None:
        """Set the attributes of an effect of the catalogue."""
        if name:
            self.id = name
            for attribute, value in TABLE[name].items():
                setattr(self, attribute, tuple(value) if isinstance(value, list) else value)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        """Return the parameters with priors at these magnitudes."""
        return self._of_rows(self.rows, scales)

    def _of_rows(self, rows: Mapping[str, tuple[Any, ...]], scales: Scales) -> tuple[EffectParameter, ...]:
        own = self.priors(scales)
        return tuple(
            EffectParameter(name, unit, meaning, own.get(name) or _prior(size, *prior))
            for name, (kind, meaning, *prior) in rows.items()
            for unit, size in [_measure(kind, scales)]
        )

    def priors(self, scales: Scales) -> dict[str, Prior]:
        """Return priors of parameters whose rows have none."""
        return {}

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        """Return all possible places of the effect in this plant."""
        if self.site_kind == "input":
            return tuple(Site("input", s.name) for s in plant.inputs)
        if self.site_kind == "output":
            return tuple(Site("output", s.name) for s in plant.outputs)
        if self.site_kind == "parameter":
            return tuple(Site("parameter", label) for role, label, _ in parameter_groups(plant) if role == self.id)
        return tuple(
            Site(self.site_kind, p.name) for p in model.ports.values() if p.kind == self.site_kind and self.fits(p)
        )

    def fits(self, port: Port) -> bool:
        """Return whether the effect can act at a port."""
        split_again = self.structural and "." in port.name
        return not split_again and (port.position is not None or not self.needs_position)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """Return initial values of a fit: the centres of the priors, one parameter at several values."""
        centres = {p.name: p.prior.value(0.0) for p in self.parameters(scales)}
        return tuple({**centres, name: x} for name, tried in self.tried(scales).items() for x in tried) or (centres,)

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        """Return the parameter with several initial values, and these."""
        sizes = {name: _measure(self.rows[name][0], scales)[1] for name in self.started}
        return {name: tuple(x * sizes[name] for x in values) for name, values in self.started.items()}

    def variants(self, scales: Scales) -> tuple[Scales, ...]:
        """Return the magnitudes of each candidate: one for each line of a periodic effect."""
        if self.spatial and scales.orders:
            return tuple(replace(scales, orders=(k,)) for k in scales.orders)
        if self.timed and scales.lines:
            return tuple(replace(scales, lines=(f,)) for f in scales.lines)
        return (scales,)

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        """Return whether the record covers the effect's scale; outside it the effect equals a simpler one."""
        return True

    def begun(self, values: Mapping[str, float], later: float) -> Mapping[str, float]:
        """Return the parameters for a record that begins ``later`` seconds later."""
        return values

    def unrefined(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Return parameters of the refined effect; by default those of the same name."""
        return values

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        """Return plant parameter -> factor."""
        return {}

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        """Return the linear equations with the effect."""
        return model

    def laws(self, site: Site, values: Mapping[str, float]) -> tuple[Law, ...]:
        return () if self.force is None else (Law(self.force, site.name, self.arguments(values), self.memory),)

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Return the argument p of the force law: all parameters in their order."""
        return tuple(values[name] for name in self._names)

    def names_of(self, values: Mapping[str, float]) -> Sequence[str]:
        """Return the names of all parameters at a place where these values are given."""
        return self._names

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters(Scales()))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        """Return the effective input (n,) of a commanded one, in steps of h seconds."""
        return signal

    def input_error(self, values: Mapping[str, float]) -> float | None:
        """Return a bound of ``|input(u) - u|`` for every input u, or None."""
        return None

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return signal

    def lag(self, values: Mapping[str, float]) -> float:
        """Return the time in s by which the recorded outputs lag behind the plant."""
        return values[self.delay] if self.delay and self.site_kind == "output" else 0.0

    def shown(self, values: Mapping[str, float]) -> float:
        """Return the ratio of a recorded output to the true one; 1 if the output is not scaled."""
        return values[self.scale] if self.scale and self.site_kind == "output" else 1.0

    def bias(self, values: Mapping[str, float]) -> float:
        """Return the recorded value of a zero output."""
        return 0.0

    def resting(self, values: Mapping[str, float], pull: Array) -> Array:
        """Return the equilibrium of the drive relative to its load for free relative accelerations ``pull`` (n,)."""
        return np.zeros_like(pull)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        """Return sector, delay or bound at this amplitude of its signal; None if the linear model is exact."""
        return None

    def checked(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values by name; raise an error if one is missing or unknown."""
        names = self.names_of(values)
        for name in values:
            if name not in names:
                hint = did_you_mean(name, list(names))
                raise InputError(f"effect {self.id}: {name!r}", "no such parameter", ", ".join(names), hint)
        missing = next((name for name in names if name not in values), None)
        if missing is not None:
            raise InputError(f"effect {self.id}", f"no value for {missing!r}", ", ".join(names))
        return {name: float(values[name]) for name in names}
