"""Effects become uncertainty: the linear model of a plant with effects, and a block for all that it is not."""
# Gelb, Vander Velde, *Multiple-Input Describing Functions* (1968), chapter 2; Wang, Lundström, Skogestad,
# "Representation of uncertain time delays in the H-infinity framework", Int. J. Control 59 (1994); Březina 2010,
# section 4.2.

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, cast, get_args

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.delays.approximation import checked_order
from robustlab.delays.model import covering
from robustlab.dynamics.effects.contract import Footprint
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import ExtendedPlant, without_signals
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant, tied_plant
from robustlab.dynamics.ports.port_model import Port, port_model
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.result import Status
from robustlab.shown import AllFields, Facts, Part, Shown, listed, number
from robustlab.statespace import Signal, StateSpaceModel, real_array
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel, product

# The nominal member of a set must be the plant's own linear model to this share of its largest response.
NOMINAL_EXACT = 1e-8

# Amplitudes at which a sector that is the same is taken for one of all amplitudes.
STRETCHES = (0.5, 1.0, 2.0)

Amplitude = float | tuple[float, float]
Dry = Literal["gain", "load", "both"]


@dataclass(frozen=True, eq=False)
class ForceSector:
    """A law as a gain: ``f = -k s`` with k in [low, high]; of the signal ``force`` ``f = k T``."""

    effect: AttachedEffect
    port: Port
    signal: str
    low: float
    high: float
    valid: str
    approximate: bool

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> float:
        return 0.5 * (self.high - self.low)

    @property
    def row(self) -> Array:
        """The state's combination that the gain multiplies, (n_x,)."""
        if self.signal == "force":
            return np.zeros_like(self.port.velocity)
        row = self.port.position if self.signal == "position" else self.port.velocity
        assert row is not None
        return row

    @property
    def unit(self) -> str:
        """Of the gain."""
        if self.signal == "force":
            return ""
        below = self.port.position_unit if self.signal == "position" else self.port.speed_unit
        return f"{self.port.unit}/({below})"


@dataclass(frozen=True)
class NoiseInput(AllFields):
    """An input of the set that stands for a bounded error: its signal is at most one."""

    name: str  # of the input
    # bound, unit: what one stands for
    bound: float
    unit: str
    origin: str  # where it comes from


@dataclass(frozen=True, eq=False)
class ForceParts:
    """What stands in for all laws of a plant."""

    # sectors, bounded: the gains; the bounded forces as inputs, each with its port
    sectors: tuple[ForceSector, ...]
    bounded: tuple[tuple[NoiseInput, Port], ...]
    # index of a law -> row (n_x,) with which the nominal member has ``f = -row x`` in place of its slope
    stand_in: Mapping[int, Array]
    left_out: Mapping[str, str]  # effect at its place -> why only its slope at the point is in the model


def force_parts(
    plant: ExtendedPlant, amplitude: Mapping[str, Amplitude], dry: Dry | None = None, width: float = 2.0
) -> ForceParts:
    """Choose for every force law what stands in for it."""
    sectors: list[ForceSector] = []
    bounded: list[tuple[NoiseInput, Port]] = []
    left: dict[str, str] = {}
    stand_in: dict[int, Array] = {}
    missing: dict[str, str] = {}
    for j, (e, _, port) in enumerate(plant.laws):
        seen = e.footprint()
        reason = _no_part(e, seen, port)
        if reason or seen is None:
            left[f"{e!r}"] = reason
            continue
        key = signal_name(plant, port, seen.signal)
        as_gain, as_load = _ways(e, seen, key in amplitude, dry)
        if as_gain and key not in amplitude and not _same_everywhere(e):
            if seen.signal == "position" and not seen.offset:
                left[f"{e!r}"] = f"only its slope at the point is in the model: give an amplitude of {key}"
            else:
                missing[key] = e.effect.title
            continue
        row = np.zeros_like(port.velocity)
        if as_gain:
            found = _sector(e, port, seen, amplitude.get(key), width)
            row = found.middle * found.row
            if found.radius > 0:
                sectors.append(found)
        if as_load:
            (name,) = free_names([e.load_name], [load.name for load, _ in bounded])
            words = f"{e.in_words} as a bounded force, for every motion; {e.values_in_words}"
            bounded.append((NoiseInput(name, e.largest_offset(width), port.unit, words), port))
        stand_in[j] = row
    if missing:
        name, title = next(iter(missing.items()))
        raise InputError(
            "effect_blocks", f"{title} at {name} without an amplitude", f"amplitude for {', '.join(missing)}",
            'the amplitude of the signal there at which the effect is described; dry="load" for friction needs none',
        )  # fmt: skip
    return ForceParts(tuple(sectors), tuple(bounded), stand_in, left)


def signal_name(plant: ExtendedPlant, port: Port, signal: str) -> str:
    """The name under which the amplitude of what a law sees is given: its joint, or the state of its position."""
    if signal != "position" or port.position is None:
        return port.name
    return plant.states[int(np.flatnonzero(port.position)[0])].name


def check_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> None:
    """Every amplitude is positive (a pair: increasing) and has an effect at its place."""
    joints = {signal_name(plant, port, s) for _, _, port in plant.laws for s in ("speed", "position")}
    known = tuple(dict.fromkeys([*(e.site.name for e in plant.effects), *sorted(joints)]))
    for name, value in amplitude.items():
        where = f"effect_blocks: amplitude {name!r}"
        if name not in known:
            raise unknown_name(where, "no effect there", name, known)
        pair = _pair(value)
        if not (len(pair) == 2 and all(_is_positive(a) for a in pair) and pair[0] <= pair[1]):
            raise InputError(where, f"{value!r}", "a positive number, or (least, largest) of two")
        if name not in joints and pair[0] != pair[1]:
            raise InputError(where, f"{value!r} at a driver or sensor", "one positive number")


def _is_positive(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < math.inf


def _pair(value: Amplitude) -> tuple[float, ...]:
    return tuple(value) if isinstance(value, (tuple, list)) else (value, value)


def _no_part(e: AttachedEffect, seen: Footprint | None, port: Port) -> str:
    """Why nothing can stand in for a law, or nothing."""
    if seen is None or seen.signal not in ("speed", "current", "position", "force", "time"):
        return "only its slope at the point is in the model"
    if e.effect.structural:
        return "it divides the joint: no force of one joint stands for it"
    if seen.signal == "force" and np.count_nonzero(port.force) != 1:
        return "only its slope at the point is in the model: its joint shares its inertia with others"
    return ""


def _ways(e: AttachedEffect, seen: Footprint, known: bool, dry: Dry | None) -> tuple[bool, bool]:
    """Whether the law becomes a gain, and whether a bounded force."""
    has_gain = seen.signal == "force" or any(
        f is not None and f.gain_upper > f.gain_lower
        for a in STRETCHES
        for f in [e.footprint(1e3 * a)]
    ) or seen.gain_upper > seen.gain_lower  # fmt: skip
    if not seen.offset:
        return True, False
    if not has_gain:
        return False, True
    mode = dry or ("gain" if known else "load")
    if mode == "both" and seen.signal == "position":  # it does not oppose a speed: |e| would be F + k |s|
        mode = "load"
    return mode != "load", mode != "gain"


def _same_everywhere(e: AttachedEffect) -> bool:
    found = [e.footprint(a) for a in STRETCHES]
    return len({(f.gain_lower, f.gain_upper) for f in found if f is not None}) == 1 and found[0] is not None


def _sector(e: AttachedEffect, port: Port, seen: Footprint, amplitude: Amplitude | None, width: float) -> ForceSector:
    ends = _pair(1.0 if amplitude is None else amplitude)
    all_of = [f for a in ends for f in e.footprints(a, width)]
    low, high = min(f.gain_lower for f in all_of), max(f.gain_upper for f in all_of)
    dry = bool(seen.offset)
    if dry and ends[0] < ends[1]:
        at_largest = [f.describing for f in e.footprints(ends[1], width)]
        low = max(low, min(at_largest)) if np.isfinite(at_largest).all() else low
    unit = port.position_unit if seen.signal == "position" else port.speed_unit
    if seen.signal == "force":
        valid = "a gain that may change at every instant, for every motion"
    elif amplitude is None:
        valid = "at every amplitude, as a gain that may change with the motion"
    elif dry:
        reach = f"of amplitude {ends[0]:.4g} {unit} and more"
        if ends[0] < ends[1]:
            reach = f"of amplitudes {ends[0]:.4g} to {ends[1]:.4g} {unit}"
        valid = f"harmonic balance, for oscillations {reach}"
    else:
        valid = f"up to {ends[1]:.4g} {unit}, as a gain that may change with the motion"
    return ForceSector(e, port, seen.signal, low, high, valid, dry and seen.signal != "force")


def force_columns(
    plant_matrices: Sequence[Array], ports: Sequence[Port], sectors: Sequence[ForceSector]
) -> tuple[Array, Array, Array]:
    """Columns of G for a force at each port; rows of C and of D (over u and those forces) for what the sectors see."""
    e, f, g = plant_matrices
    push = e @ np.array([p.force for p in ports]).T if ports else np.zeros((len(f), 0))
    c, d = np.zeros((len(sectors), len(f))), np.zeros((len(sectors), g.shape[1] + len(ports)))
    for k, s in enumerate(sectors):
        if s.signal != "force":
            c[k] = s.row
            continue
        dual = push[:, k] / float(push[:, k] @ push[:, k])
        others = push.copy()
        others[:, k] = 0.0
        c[k], d[k] = dual @ f, np.concatenate([dual @ g, dual @ others])
    return push, c, d


def free_names(names: list[str], taken: Sequence[str]) -> list[str]:
    """The names, with primes where they are taken already."""
    found: list[str] = []
    for name in names:
        while name in taken or name in found:
            name += "'"
        found.append(name)
    return found


@dataclass(frozen=True, eq=False)
class EffectBlocks(Shown):
    """A plant with effects as an uncertain model.

    Attributes
    ----------
    model
        Its inputs are those of ``noise``, then the plant's.
    noise
        Inputs for bounded errors.
    left_out
        Effect at its place -> why it is in no block.
    approximate
        Names of the blocks that hold by harmonic balance only: for oscillations, not for every motion.
    status
        CONVERGED: the nominal member was found to be the plant's own linear model.
    """

    model: UncertainModel
    noise: tuple[NoiseInput, ...]
    left_out: Mapping[str, str]
    approximate: tuple[str, ...] = ()
    status: Status = Status.CONVERGED

    @property
    def origins(self) -> dict[str, str]:
        return {b.name: b.origin for b in self.model.blocks}

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know."""
        names = ", ".join(self.approximate)
        harmonic = f"{names}: holds by harmonic balance, for oscillations that its line names, not for every motion."
        told = {
            harmonic: self.approximate,
            "Inputs for bounded errors come first; one stands for the bound that their line names.": self.noise,
            "What is proved for this set says nothing about the effects that are not in it.": self.left_out,
        }
        return tuple(text for text, there in told.items() if there)

    quantities: ClassVar[Mapping[str, Any]] = {
        **UncertainModel.quantities, "count": "1", "inputs": "1", "left_out": "1", "bound": {"*": float},
        "range": {"*": {"low": float, "high": float}},
    }  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        ranges = {b.name: {"low": b.parameter.low, "high": b.parameter.high} for b in self.model.blocks if b.parameter}
        counts = {"count": len(self.model.blocks), "inputs": len(self.noise), "left_out": len(self.left_out)}
        return {**self.model.numbers(), **counts, "range": ranges, "bound": {n.name: n.bound for n in self.noise}}

    def headline(self) -> str:
        return (
            f"uncertain model: blocks {len(self.model.blocks)}, inputs for bounded errors {len(self.noise)},"
            f" effects left out {len(self.left_out)}"
        )

    def facts(self) -> Facts:
        """The set, its inputs for errors, and each effect that is left out."""
        return [
            ("set", repr(self.model)),
            ("blocks", listed(self.origins)),
            *((f"input {n.name}", f"at most {number(n.bound, n.unit)}, {n.origin}") for n in self.noise),
            *((f"not in it: {name}", reason) for name, reason in self.left_out.items()),
            ("harmonic balance only", listed(self.approximate)),
        ]

    def details(self) -> list[Part]:
        return self.model.details()

    def to_json(self) -> dict[str, Any]:
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        return {"type": "EffectBlocks", **self.model.to_json(), **own, "origins": self.origins}


def effect_blocks(
    plant: Any,
    outputs: Sequence[str] | None = None,
    *,
    sigmas: float = 2.0,
    amplitude: Mapping[str, Amplitude] | None = None,
    dry: Dry | None = None,
    pade: int = 2,
    unnamed: tuple[float, str] | None = None,
    tied: Sequence[tuple[str, tuple[str, ...]]] = (),
) -> EffectBlocks:
    """The uncertain model of a plant with or without effects."""
    width = float(real_array("sigmas", sigmas, 0, "effect_blocks"))
    checks.number("effect_blocks: sigmas", width, "0 or more", at_least=0)
    checks.whole("effect_blocks: pade", pade, 1, 8)
    if isinstance(plant, LinearPlant):
        if amplitude:
            raise InputError("effect_blocks: amplitude", f"{plant.name} has no effects", "none")
        loads = _unnamed(port_model(plant), unnamed)
        inner = tied_plant(plant, tied)
        whole = _told(with_forces(inner, [port for _, port in loads]).uncertain(), inner)
        return _kept(_with_noise(plant, whole, loads, ()), outputs)
    if not isinstance(plant, ExtendedPlant):
        raise InputError("effect_blocks", type(plant).__name__, "a linear plant, with or without effects")
    if dry not in (None, *get_args(Dry)):
        raise InputError("effect_blocks: dry", f"{dry!r}", f"one of {', '.join(get_args(Dry))}")
    return _kept(_of_extended(plant, width, dict(amplitude or {}), dry, pade, unnamed, tied), outputs)


def _kept(made: EffectBlocks, outputs: Sequence[str] | None) -> EffectBlocks:
    if outputs is None:
        return made
    m, (_, p) = made.model.M, made.model.delta_shape
    kept = drop_unconnected(m.select(m.input_names, [*m.output_names[:p], *outputs]))
    return dataclasses.replace(made, model=UncertainModel(kept, made.model.blocks))


def _of_extended(
    plant: ExtendedPlant,
    width: float,
    amplitude: dict[str, Amplitude],
    dry: Dry | None,
    pade: int,
    unnamed: tuple[float, str] | None,
    tied: Sequence[tuple[str, tuple[str, ...]]],
) -> EffectBlocks:
    check_amplitudes(plant, amplitude)
    parts = force_parts(plant, amplitude, dry, width)
    levels = _signal_amplitudes(plant, amplitude)
    linear = plant.linear_model(None, levels, stand_in=parts.stand_in)
    point = linear.operating_point
    assert point is not None
    loads = [*parts.bounded, *_unnamed(plant.model, unnamed)]
    drivers = _driver_errors(plant, amplitude, width)
    inner = tied_plant(without_signals(plant, linear, width), tied)
    ways = [*(s.port for s in parts.sectors), *(port for _, port in loads)]
    whole = _told(with_forces(inner, ways, parts.sectors).uncertain(), inner)
    whole, approximate = _with_sectors(whole, parts.sectors, len(plant.inputs))
    signals = plant.signal_levels(point.x, point.u)
    for e, k, level in reversed([s for s in signals if s[0].site.kind == "input"]):
        for gadget in _gadgets(e, level, levels, width, pade):
            whole = product(whole, _at_channel(gadget, whole.inputs, k, e.key))
    for e, k, level in [s for s in signals if s[0].site.kind == "output"]:
        for gadget in _gadgets(e, level, levels, width, pade):
            whole = product(_at_channel(gadget, whole.outputs, k, e.key), whole)
    made = _with_noise(plant, whole, loads, signals, width, drivers)
    _check(plant.linear_model(None, levels, pade, stand_in=parts.stand_in), plant.name, made)
    left = {**parts.left_out, **_left_out(signals)}
    return dataclasses.replace(made, left_out=left, approximate=tuple(approximate))


def _signal_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> dict[str, float]:
    """The amplitudes of drivers and sensors; those with a sector must have one."""
    missing = {
        e.site.name: e.effect.title
        for e in plant.effects
        if e.on_signal
        and e.scale is None
        and e.site.name not in amplitude
        and e.sector({e.site.name: 1.0}, ("input", "output")) is not None
        and not _is_bounded_error(plant, e)
    }
    if missing:
        name, title = next(iter(missing.items()))
        raise InputError(
            "effect_blocks", f"{title} at {name} without an amplitude", f"amplitude for {', '.join(missing)}",
            "the amplitude of the signal there at which the effect is to be described",
        )  # fmt: skip
    places = {e.site.name for e in plant.effects if e.on_signal}
    return {n: float(a[1] if isinstance(a, (tuple, list)) else a) for n, a in amplitude.items() if n in places}


def _is_bounded_error(plant: ExtendedPlant, e: AttachedEffect) -> bool:
    """Whether a driver adds no more than a bounded error to an input that nothing else scales."""
    others = [o for o in plant.effects if o.site == e.site and o is not e and o.scale is not None]
    return e.site.kind == "input" and e.input_error() is not None and not others


def _driver_errors(
    plant: ExtendedPlant, amplitude: Mapping[str, Amplitude], width: float
) -> list[tuple[NoiseInput, int]]:
    """A driver without an amplitude as what it adds to its input at most, and the number of the input."""
    found = []
    for e in plant.effects:
        if e.site.name in amplitude or not _is_bounded_error(plant, e):
            continue
        k = [s.name for s in plant.inputs].index(e.site.name)
        bound = e.input_error(width)
        assert bound is not None
        words = f"{e.in_words} as a bounded error, for every motion; {e.values_in_words}"
        found.append((NoiseInput(e.load_name, bound, plant.inputs[k].unit, words), k))
    return found


def _unnamed(model: Any, given: tuple[float, str] | None) -> list[tuple[NoiseInput, Any]]:
    """An input for a force that nothing explains, at the first joint."""
    if given is None:
        return []
    port = next((p for p in model.ports.values() if p.kind == "joint"), None)
    if port is None:
        raise InputError("effect_blocks: unnamed", "a plant without joints", "a joint at which the force acts")
    bound = float(real_array("unnamed", given[0], 0, "effect_blocks"))
    if bound <= 0:
        raise InputError("effect_blocks: unnamed", f"a force of {bound:g} {port.unit}", "a positive bound")
    return [(NoiseInput(f"load {port.name}: unnamed", bound, port.unit, given[1]), port)]


def with_forces(plant: LinearPlant, ports: Sequence[Any], sectors: Sequence[ForceSector] = ()) -> LinearPlant:
    """The plant with a force at each port as further inputs, and what the first ones' sectors see as outputs, too."""
    if not ports:
        return plant
    nominal = plant.matrices(plant.values)[0]

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, c, d = plant.matrices(p)
        push, seen_c, seen_d = force_columns((nominal, f, g), ports, sectors)
        wide = np.vstack([np.hstack([d, np.zeros((len(c), len(ports)))]), seen_d])
        return Descriptor(e, f, np.hstack([g, push]), np.vstack([c, seen_c]), wide)

    inputs = (*plant.inputs, *(Signal(f"force {i} at {p.name}", p.unit) for i, p in enumerate(ports)))
    seen = (Signal(f"{s.signal} {i} at {s.port.name}", s.port.speed_unit) for i, s in enumerate(sectors))
    return LinearPlant(
        plant.name, plant.parameters, inputs, (*plant.outputs, *seen), plant.states, equations, plant.exact
    )


def _told(uncertain: UncertainModel, plant: LinearPlant) -> UncertainModel:
    """The same with an origin for every parameter."""
    blocks = []
    for b in uncertain.blocks:
        p = plant.parameters[b.name]
        text = f"parameter {b.name} = {p.value:.6g} {p.unit}".rstrip()
        text += f", {p.meaning}" if p.meaning else ""
        blocks.append(dataclasses.replace(cast("Any", b), origin=text + (f"; {p.source}" if p.source else "")))
    return UncertainModel(uncertain.M, blocks, uncertain.operating_point)


def _with_sectors(whole: UncertainModel, sectors: Sequence[ForceSector], n_u: int) -> tuple[UncertainModel, list[str]]:
    """The forces of the sectors closed over what they see: ``f = -r delta s``; the middle is in the plant already."""
    k = len(sectors)
    if not k:
        return whole, []
    m, (q, p) = whole.M, whole.delta_shape
    n_y = len(whole.outputs)
    force = list(range(q + n_u, q + n_u + k))
    rest_in = [j for j in range(m.n_inputs) if j not in force]
    seen = list(range(p + n_y - k, p + n_y))
    columns = rest_in[:q] + force + rest_in[q:]
    rows = [*range(p), *seen, *range(p, p + n_y - k)]
    scale = np.ones(m.n_inputs)
    scale[q : q + k] = [s.radius if s.signal == "force" else -s.radius for s in sectors]
    names = free_names([s.effect.key for s in sectors], [b.name for b in whole.blocks])
    ins, outs = list(m.inputs), list(m.outputs)
    model = StateSpaceModel(
        m.A, m.B[:, columns] * scale, m.C[rows], m.D[np.ix_(rows, columns)] * scale, m.dt,
        [*ins[:q], *(f"w_{n}" for n in names), *(ins[j] for j in rest_in[q:])],
        [*outs[:p], *(f"z_{n}" for n in names), *outs[p : p + n_y - k]],
        m.states, where="effect_blocks",
    )  # fmt: skip
    blocks = [
        RealScalar(name, 1, ParameterRange(s.middle, s.radius, s.unit), origin=_sector_words(s))
        for name, s in zip(names, sectors, strict=True)
    ]
    found = UncertainModel(model, [*whole.blocks, *blocks], whole.operating_point)
    return found, [name for name, s in zip(names, sectors, strict=True) if s.approximate]


def _sector_words(s: ForceSector) -> str:
    e = s.effect
    seen = "of the force there" if s.signal == "force" else f"of its {s.signal}"
    return f"{e.in_words} as a sector {seen}; {s.valid}; {e.values_in_words}"


def lag_block(time: float, spread: float, name: str) -> UncertainModel:
    """All lags :math:`1 / (1 + s T)` with T within ``spread`` of ``time``, in s, exactly."""
    if not 0.0 <= spread < time:
        raise InputError(f"lag {name}", f"{time:g} s +- {spread:g} s", "a time constant that stays positive")
    a = -1.0 / time
    if not spread:
        return UncertainModel(StateSpaceModel([[a]], [[-a]], [[1.0]], [[0.0]]), [])
    model = StateSpaceModel([[a]], [[a * spread, -a]], [[a], [1.0]], [[a * spread, -a], [0.0, 0.0]])
    return UncertainModel(model, [RealScalar(name, 1, ParameterRange(time, spread, "s"))])


def delay_block(delay: float, spread: float, pade: int, name: str, origin: str = "") -> UncertainModel:
    r"""All delays from ``delay - spread`` (at least 0) to ``delay + spread`` as :math:`P + w \Delta`."""
    if not 0 < delay < np.inf or not 0 <= spread < np.inf:
        raise InputError("delay_block", f"{delay:g} s +- {spread:g} s", "a positive delay, a spread of 0 s or more")
    n = checked_order(pade, "delay_block", 1)
    # The slope of what is missed changes from 1 to 2 n + 1 where there is a spread: a lower order follows that better.
    made = covering(delay, spread, n, n + 1 if spread else min(n + 2, 2 * n + 1))
    return UncertainModel(made.M, [FullBlock(name, 1, 1, origin=origin, covers=made.blocks[0].covers)])


def _gadgets(
    e: AttachedEffect, level: float, amplitude: Mapping[str, float], width: float, pade: int
) -> list[UncertainModel]:
    """What an effect puts into its signal: a gain with a range, a delay, a lag."""
    found: list[UncertainModel] = []
    gain = e.gain(level, amplitude)
    seen = e.sector(amplitude, ("input", "output"))
    reach = width * e.scale_std
    if seen is not None:
        reach = 0.5 * (seen.gain_upper - seen.gain_lower)
    if reach:
        words = f"{e.in_words}" + ("" if seen is None else " as a sector") + f"; {e.values_in_words}"
        block = RealScalar(e.key, 1, ParameterRange(gain, reach), origin=words)
        found.append(UncertainModel(StateSpaceModel([], [], [], [[0.0, reach], [1.0, gain]]), [block]))
    elif gain != 1.0:
        found.append(UncertainModel(StateSpaceModel([], [], [], [[gain]]), []))
    if e.delay:
        spread = width * e.std.get(e.effect.delay, 0.0)
        words = f"{e.in_words}, {e.delay:.6g} s +- {spread:.3g} s, as Padé of order {pade} and a weight proved to cover"
        words = f"{words} what that misses; {e.values_in_words}"
        found.append(delay_block(e.delay, spread, pade, e.key, words))
    if e.time_constant:
        spread = width * e.std.get(e.effect.time_constant, 0.0)
        model = lag_block(e.time_constant, spread, e.key)
        words = f"{e.in_words}, {e.time_constant:.6g} s +- {spread:.3g} s; {e.values_in_words}"
        found.append(UncertainModel(model.M, [dataclasses.replace(cast("Any", b), origin=words) for b in model.blocks]))
    return found


def _at_channel(gadget: UncertainModel, signals: Sequence[Signal], k: int, name: str) -> UncertainModel:
    """The gadget of this name in signal k, all others passed on."""
    g, (q, p), n = gadget.M, gadget.delta_shape, len(signals)
    b, c = np.zeros((g.n_states, q + n)), np.zeros((p + n, g.n_states))
    b[:, :q], b[:, q + k] = g.B[:, :q], g.B[:, q]
    c[:p], c[p + k] = g.C[:p], g.C[p]
    d = np.zeros((p + n, q + n))
    d[p:, q:] = np.eye(n)
    d[:p, :q], d[:p, q + k], d[p + k, :q], d[p + k, q + k] = g.D[:p, :q], g.D[:p, q], g.D[p, :q], g.D[p, q]
    model = StateSpaceModel(
        g.A, b, c, d, 0.0, [*(f"w_{name}" for _ in range(q)), *signals], [*(f"z_{name}" for _ in range(p)), *signals],
        [f"{name} {i + 1}" for i in range(g.n_states)], where="effect_blocks",
    )  # fmt: skip
    return UncertainModel(model, gadget.blocks)


def _with_noise(
    plant: LinearPlant | ExtendedPlant,
    whole: UncertainModel,
    loads: Sequence[tuple[NoiseInput, Any]],
    signals: Sequence[tuple[AttachedEffect, int, float]],
    width: float = 0.0,
    drivers: Sequence[tuple[NoiseInput, int]] = (),
) -> EffectBlocks:
    """Bounded errors as inputs of size one, before the plant's own."""
    m, (q, p) = whole.M, whole.delta_shape
    n_u = len(plant.inputs)
    noise: list[NoiseInput] = []
    columns_b, columns_d = [], []
    for i, (load, _) in enumerate(loads):
        j = q + n_u + i
        noise.append(load)
        columns_b.append(load.bound * m.B[:, j])
        columns_d.append(load.bound * m.D[:, j])
    for load, k in drivers:
        noise.append(load)
        columns_b.append(load.bound * m.B[:, q + k])
        columns_d.append(load.bound * m.D[:, q + k])
    for e, k, _ in signals:
        bound = e.largest_offset(width)
        if e.site.kind == "output" and bound:
            signal = plant.outputs[k]
            noise.append(NoiseInput(f"noise {signal.name}: {e.effect.id}", bound, signal.unit, _bounded(e)))
            columns_b.append(np.zeros(m.n_states))
            columns_d.append(bound * np.eye(m.n_outputs)[p + k])
    between_b = np.array(columns_b).reshape(len(noise), m.n_states).T
    between_d = np.array(columns_d).reshape(len(noise), m.n_outputs).T
    model = StateSpaceModel(
        m.A,
        np.hstack([m.B[:, :q], between_b, m.B[:, q : q + n_u]]),
        m.C,
        np.hstack([m.D[:, :q], between_d, m.D[:, q : q + n_u]]),
        m.dt,
        [*m.inputs[:q], *((n.name, "1") for n in noise), *plant.inputs],
        [*m.outputs[:p], *plant.outputs],
        m.states,
        where="effect_blocks",
    )
    return EffectBlocks(UncertainModel(model, whole.blocks), tuple(noise), {})


def _bounded(e: AttachedEffect) -> str:
    return f"{e.in_words} as a bounded error; {e.values_in_words}"


def _check(own: StateSpaceModel, name: str, made: EffectBlocks) -> None:
    """The nominal member is the plant's own linear model."""
    found = made.model.nominal.select(own.input_names, own.output_names)
    size = np.abs(own.poles())
    omega = np.geomspace(max(size[size > 0].min(initial=1.0), 1e-6), max(size.max(initial=1.0), 1e-5), 7) * 1.0371
    a, b = (frequency_response(m, omega) for m in (found, own))
    off = float(np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-300))
    if off > NOMINAL_EXACT:
        raise NoTrustworthyNumber(
            f"{name}: effect_blocks", f"the nominal member is off the linear model by {off:.2g} of its response"
        )


def _left_out(signals: Sequence[tuple[AttachedEffect, int, float]]) -> dict[str, str]:
    """Bounded errors of drivers."""
    left = {}
    for e, _, _ in signals:
        seen = e.footprint()
        if e.site.kind == "input" and seen is not None and seen.offset:
            left[f"{e!r}"] = "a bounded error of an input"
    return left
