"""What every effect is: a name, an equation, parameters with priors, and the way it enters a plant."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
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
    and ``top``, of either sign. The centre of ``"log"`` may be negative: the parameter is then negative by nature.
    """

    kind: Literal["log", "linear", "share", "between"]
    centre: float
    spread: float
    top: float = 1.0
    bottom: float = 0.0

    @property
    def is_signed(self) -> bool:
        """False where the parameter is positive by nature."""
        return self.kind in ("linear", "between") or self.centre < 0.0

    def value(self, z: float) -> float:
        """The parameter at the standardised z."""
        if self.kind == "log":
            return self.centre * math.exp(max(-40.0, min(40.0, self.spread * z)))
        if self.kind == "linear":
            return self.centre + self.spread * z
        median = math.log((self.centre - self.bottom) / (self.top - self.centre))
        part = 1.0 / (1.0 + math.exp(-max(-40.0, min(40.0, median + self.spread * z))))
        return self.bottom + (self.top - self.bottom) * part

    def standardised(self, value: float) -> float:
        """The z of a parameter value."""
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
    """Where an effect sits: the kind of place and its name."""

    kind: SiteKind
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Scales:
    """Magnitudes seen in a record, for priors and starting values."""

    # force, speed, position: at the site's port: RMS of the force that moves it, largest speed, range of the position;
    # 1 where not known
    force: float = 1.0
    speed: float = 1.0
    position: float = 1.0
    # lowest, highest: extremes of the position; None where not known
    lowest: float | None = None
    highest: float | None = None
    inertia: float = 1.0  # force per acceleration at the port
    # Of a joint of a nonlinear plant: shares of that inertia that may hang behind its drive, as parameters tell them
    # (`robustlab.dynamics.ports.split_joint.shares_behind`)
    shares: tuple[float, ...] = ()
    input: float = 1.0  # largest absolute value of the site's input
    output: float = 1.0  # half the range of the site's output
    zero: float = 0.1  # by how much a sensor's zero may be off, over `output`
    current: float = 1.0  # largest absolute current
    # dt, duration: sample time and length of the record in s
    dt: float = 1e-3
    duration: float = 1.0
    # strongest spatial frequencies of the residual force in rad^-1 or m^-1, strongest first (empty: not looked at)
    orders: tuple[float, ...] = ()
    # strongest lines of the residual force over time in Hz, strongest first (empty: none is significant)
    lines: tuple[float, ...] = ()
    side: int = 0  # of a trial of an effect that acts beyond one position: 1 above it, -1 below, 0 on either side
    # force_unit, speed_unit, position_unit, signal_unit: units at the site
    force_unit: str = ""
    speed_unit: str = ""
    position_unit: str = ""
    signal_unit: str = ""


@dataclass(frozen=True, eq=False)
class Law:
    """A compiled force law at a port of the (extended) model."""

    function: Any  # compiled by `robustlab.dynamics.ports.law_kernel.law`
    port: str  # name of the port
    parameters: tuple[float, ...]  # what the function is given as p
    memory: int = 0  # number of its memory cells; they start at zero


@dataclass(frozen=True)
class Footprint:
    """What robust design must know of an effect."""

    port: str  # name of the port or signal at which it acts
    signal: str  # what it acts on there: "speed", "position", "input", "output", "current", "force", "time"
    # Sector: the effect lies between these two gains (force per speed, and so on) at the amplitude asked for.
    gain_lower: float
    gain_upper: float
    delay: float = 0.0  # pure delay in s that it stands for
    offset: float = 0.0  # bound of the part that is no gain of the signal at all (a constant load)
    # Gain of the describing function at just this amplitude, of a law whose gain only falls with it; NaN: not known.
    describing: float = math.nan


# What an effect of the catalogue is, and its parameters: id -> row.
TABLE = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))
OWN: dict[str, Effect] = {}  # id -> effect, of all modules of effects that are loaded


def _measure(kind: str, s: Scales) -> tuple[str, float]:
    """Unit and size at a site of a quantity as `effects.toml` has it: ``"F/q"``, ``"dt"``, or a unit by itself."""
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
    """The prior of a row of `effects.toml`, whose numbers are in units of the size."""
    if kind == "share":
        return Prior(kind, centre * size, spread, top=size)
    return Prior(kind, centre * size, spread * size if kind == "linear" else spread)


class Effect:
    """One physical effect; all that is known of it stands here: who looks for effects, fits them, builds sets of them
    or advises on experiments asks the effect. Those of the catalogue have their texts and parameters in `effects.toml`.
    """

    id: str  # name in the catalogue
    title: str  # in words
    equation: str  # one line, in the field's notation, with the symbols of the parameters
    site_kind: SiteKind  # where it sits
    # What to do to settle it without any record of the plant's motion, as an instruction; empty: nothing is known.
    independently: str = ""
    # After whom the title begins, empty otherwise: a name keeps its capital within a sentence.
    person: str = ""
    # Id of the parent on top of which alone it is looked for. A refinement contains its parent.
    refines: str | None = None
    # Ids of effects that together do exactly the same: `discover` tells it by their names.
    equals: tuple[str, ...] = ()
    nameable: bool = True  # False for what is known noise and never a name (quantisation)
    needs_position: bool = False  # True where it sits only at joints whose position is a state
    # True where its period over the position is a parameter; it is then tried at each strong spatial line
    # (``scales.orders`` holds the one line of a trial).
    spatial: bool = False
    # Of an effect that is periodic in time: the parameter that is its frequency in Hz; it is then tried at each line
    # (``scales.lines`` holds the one).
    timed: str = ""
    # True where stretched parameters of the plant can take its place (a gain, a wrong parameter), so that only their
    # tolerances tell the two apart.
    gain_like: bool = False
    # Of an effect that multiplies a signal, or parameters of the plant, and does no more: the parameter by which.
    scale: str = ""
    delay: str = ""  # of an effect that delays a signal: the parameter that is the delay in s
    time_constant: str = ""  # of an effect that lags an input in first order: the parameter that is its T in s
    # Name of the amplitude that one speaks of, and the two parameters, in its unit, that are its cosine and sine part.
    amplitude: tuple[str, ...] = ()
    # Parameter of which a record may tell only the least: beyond that the effect goes on as before.
    told_from_below: str = ""
    # Balance of a steady point from which it takes an amount of its own.
    constant_loss: Literal["", "torque", "voltage"] = ""
    # Relative tolerance of the plant's parameters with the role `id`, where the plant states none.
    tolerance: float = 0.10
    # True where it splits the joint in two (backlash, a flexible coupling); a plant carries one of these.
    structural: bool = False
    # True where its memory outlasts a window (heat), so that windows cannot be simulated out of order.
    long_memory: bool = False
    # Its force law at the port of its site (`robustlab.dynamics.ports.law_kernel.law`), and that law's memory cells.
    force: Any = None
    memory: int = 0
    # The table's rows of its parameters, and of one from which several starts are made: values in units of its size.
    rows: Mapping[str, tuple[Any, ...]] = {}
    started: Mapping[str, tuple[float, ...]] = {}

    def __init_subclass__(cls, row: str = "") -> None:
        """``row``: its id, where it is one of the catalogue."""
        if row:
            cls.id = row
            for name, value in TABLE[row].items():
                setattr(cls, name, tuple(value) if isinstance(value, list) else value)
            OWN[row] = cls()

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        """Parameters with priors at these magnitudes."""
        return self._of_rows(self.rows, scales)

    def _of_rows(self, rows: Mapping[str, tuple[Any, ...]], scales: Scales) -> tuple[EffectParameter, ...]:
        own, found = self.priors(scales), []
        for name, (kind, meaning, *prior) in rows.items():
            unit, size = _measure(kind, scales)
            found.append(EffectParameter(name, unit, meaning, own[name] if name in own else _prior(size, *prior)))
        return tuple(found)

    def priors(self, scales: Scales) -> dict[str, Prior]:
        """Priors of parameters whose rows have none."""
        return {}

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        """All places of this plant where the effect can sit; empty where it makes no sense."""
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
        """False for ports that lack what the effect needs."""
        split_again = self.structural and "." in port.name
        return not split_again and (port.position is not None or not self.needs_position)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """Values from which a fit begins: the centres of the priors, one parameter at several values."""
        centres = {p.name: p.prior.value(0.0) for p in self.parameters(scales)}
        return tuple({**centres, name: x} for name, tried in self.tried(scales).items() for x in tried) or (centres,)

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        """The parameter of which several values are tried, and these."""
        sizes = {name: _measure(self.rows[name][0], scales)[1] for name in self.started}
        return {name: tuple(x * sizes[name] for x in values) for name, values in self.started.items()}

    def variants(self, scales: Scales) -> tuple[Scales, ...]:
        """The magnitudes at which it is tried, each a candidate of its own: one for each line, where it has one."""
        if self.spatial and scales.orders:
            return tuple(replace(scales, orders=(k,)) for k in scales.orders)
        if self.timed and scales.lines:
            return tuple(replace(scales, lines=(f,)) for f in scales.lines)
        return (scales,)

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        """Whether the record visits the effect's own scale; where it does not the effect is its limit there (a spring,
        a slope, nothing), which competes by its own name.
        """
        return True

    def begun(self, values: Mapping[str, float], later: float) -> Mapping[str, float]:
        """Parameters as a record tells them that begins later by so many seconds."""
        return values

    def unrefined(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Parameters of the effect that this one refines, as far as its own tell; those of one name by default."""
        return values

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        """Plant parameter -> factor."""
        return {}

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        """The linear equations with the effect."""
        return model

    def laws(self, site: Site, values: Mapping[str, float]) -> tuple[Law, ...]:
        return () if self.force is None else (Law(self.force, site.name, self.arguments(values), self.memory),)

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """What the force law is given as p: all parameters, in their order."""
        return tuple(values[name] for name in self._names)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters(Scales()))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        """What the plant sees of an input (n,), given in steps of h seconds."""
        return signal

    def input_error(self, values: Mapping[str, float]) -> float | None:
        """Bound of ``|input(u) - u|`` for every input u; None where there is none."""
        return None

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return signal

    def lag(self, values: Mapping[str, float]) -> float:
        """Time in s by which the recorded outputs, and states told from them, lie behind the plant."""
        return 0.0

    def shown(self, values: Mapping[str, float]) -> float:
        """What is recorded of an output over what is there; 1 where the output is not scaled as a whole."""
        return 1.0

    def bias(self, values: Mapping[str, float]) -> float:
        """What is recorded of an output where nothing is there."""
        return 0.0

    def resting(self, values: Mapping[str, float], pull: Array) -> Array:
        """Of an effect that splits the joint in two: where the drive rests relative to its load, for the relative
        accelerations ``pull`` (n,) that the two would have with nothing between them.
        """
        return np.zeros_like(pull)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        """Sector, delay or bound of the effect at this amplitude of its signal; None where the model has it all."""
        return None

    def checked(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values by name, all there and finite."""
        return self._checked(values, [p.name for p in self.parameters(Scales())])

    def _checked(self, values: Mapping[str, float], names: list[str]) -> dict[str, float]:
        for name in values:
            if name not in names:
                raise InputError(
                    f"effect {self.id}: {name!r}", "no such parameter", f"{', '.join(names)}", did_you_mean(name, names)
                )
        missing = [name for name in names if name not in values]
        if missing:
            raise InputError(f"effect {self.id}", f"no value for {missing[0]!r}", f"{', '.join(names)}")
        checked = {name: float(values[name]) for name in names}
        for name, value in checked.items():
            if not np.isfinite(value):
                raise InputError(f"effect {self.id}: {name}", f"{value}", "a finite number")
        return checked
