"""Effects as uncertainty: a linear model x' = A x + B (u + d) + sum b_j f_j, with blocks or bounds of d and f_j."""
# Gelb, Vander Velde, *Multiple-Input Describing Functions* (1968), chapter 2; Wang, Lundström, Skogestad,
# "Representation of uncertain time delays in the H-infinity framework", Int. J. Control 59 (1994); Březina 2010,
# section 4.2.

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, cast, get_args

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.delays.approximation import checked_order
from robustlab.delays.model import covering
from robustlab.display import AllFields, Displayable, Facts, Part, listed, number
from robustlab.dynamics.descriptor_elimination import with_outputs
from robustlab.dynamics.effects.effect import Footprint, Law
from robustlab.dynamics.extended.attached_effect import AttachedEffect, is_set_valued, rest_band, steady_force
from robustlab.dynamics.extended.extended_plant import ExtendedPlant, extended_model, with_effects
from robustlab.dynamics.extended.simulator import factors_of
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant, tied_plant, with_factors
from robustlab.dynamics.parameters import Parameter
from robustlab.dynamics.plant_base import Trim
from robustlab.dynamics.ports.port_model import Port, PortModel
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel, product

# Allowed difference between the nominal member of a set and the plant's linear model, relative to its response.
NOMINAL_EXACT = 1e-8

# Amplitudes for the check whether a sector is independent of the amplitude.
STRETCHES = (0.5, 1.0, 2.0)

SLOPE_ONLY = "only its slope at the point is in the model"

Amplitude = float | tuple[float, float]
Dry = Literal["gain", "load", "both"]


@dataclass(frozen=True, eq=False)
class ForceSector:
    """A law as a gain: ``f = -k s`` with k in [low, high]; for the signal ``force`` ``f = k T``."""

    effect: AttachedEffect
    port: Port
    signal: str
    range: ParameterRange
    row: Array  # of the gain's argument, (n_x,); zero for a force
    valid: str
    approximate: bool


@dataclass(frozen=True)
class NoiseInput(AllFields):
    """An input of the set for a bounded error: its signal is at most one."""

    name: str
    bound: float  # physical value of a unit signal
    unit: str
    origin: str

    @property
    def in_words(self) -> str:
        return f"{self.name}: at most {self.bound:.5g} {self.unit}: {self.origin}"


def _force_parts(
    plant: ExtendedPlant, amplitude: Mapping[str, Amplitude], dry: Dry | None, width: float
) -> tuple[list[ForceSector], list[Load], dict[int, Array], dict[str, str]]:
    """Return sectors, forces as inputs, law -> row of ``f = -row x`` in the nominal member, and effects left out."""
    sectors, bounded = list[ForceSector](), list[Load]()
    replacements, left_out, missing = dict[int, Array](), dict[str, str](), dict[str, str]()
    for j, (e, _, port) in enumerate(plant.laws):
        seen = e.footprint()
        reason = ""
        if seen is None or seen.signal not in ("speed", "current", "position", "force", "time"):
            reason = SLOPE_ONLY
        elif e.effect.structural:
            reason = "it divides the joint: it is no force at one joint"
        elif seen.signal == "force" and np.count_nonzero(port.force) != 1:
            reason = f"{SLOPE_ONLY}: its joint shares its inertia with others"
        if seen is None or reason:
            left_out[f"{e!r}"] = reason
            continue
        key = _signal_name(plant, port, seen.signal)
        as_gain, as_load = _as_gain_or_force(e, seen, key in amplitude, dry)
        everywhere = {(f.gain_lower, f.gain_upper) for a in STRETCHES if (f := e.footprint(a)) is not None}
        if as_gain and key not in amplitude and len(everywhere) != 1:
            if seen.signal == "position" and not seen.offset:
                left_out[f"{e!r}"] = f"{SLOPE_ONLY}: give an amplitude of {key}"
            else:
                missing[key] = e.effect.title
            continue
        row = np.zeros_like(port.velocity)
        if as_gain:
            found = _sector(e, port, seen, amplitude.get(key), width)
            row = found.range.nominal * found.row
            if found.range.radius > 0:
                sectors.append(found)
        if as_load:
            bounded.append(_load(plant, plant.model.ports, e, width, "a bounded force, for every motion"))
        replacements[j] = row
    if missing:
        raise _no_amplitude(missing, '; dry="load" for friction needs none')
    return sectors, bounded, replacements, left_out


def _no_amplitude(missing: Mapping[str, str], more: str = "") -> InputError:
    name, title = next(iter(missing.items()))
    return InputError(
        "effect_blocks", f"{title} at {name} without an amplitude", f"amplitude for {', '.join(missing)}",
        f"the amplitude of the signal there at which the effect is described{more}",
    )  # fmt: skip


def _signal_name(plant: ExtendedPlant, port: Port, signal: str) -> str:
    """Return the key of a law's amplitude: its joint, or the state of its position."""
    if signal != "position" or port.position is None:
        return port.name
    return plant.states[int(np.flatnonzero(port.position)[0])].name


def _check_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> None:
    """Check that every amplitude is positive (a pair: increasing) and has an effect at its place."""
    joints = {_signal_name(plant, port, s) for _, _, port in plant.laws for s in ("speed", "position")}
    known = tuple(dict.fromkeys([*(e.site.name for e in plant.effects), *sorted(joints)]))
    for name, value in amplitude.items():
        where = f"effect_blocks: amplitude {name!r}"
        if name not in known:
            raise unknown_name(where, "no effect there", name, known)
        pair, expected = _pair(value), "a positive number, or (least, largest) of two"
        for end in pair:
            checks.number(where, end, expected, above=0)
        if len(pair) != 2 or pair[0] > pair[1]:
            raise InputError(where, f"{value!r}", expected)
        if name not in joints and pair[0] != pair[1]:
            raise InputError(where, f"{value!r} at a driver or sensor", "one positive number")


def _pair(value: Amplitude) -> tuple[float, ...]:
    return tuple(value) if isinstance(value, (tuple, list)) else (value, value)


def _as_gain_or_force(e: AttachedEffect, seen: Footprint, known: bool, dry: Dry | None) -> tuple[bool, bool]:
    """Return whether the law becomes a gain, and whether a bounded force."""
    if not seen.offset:
        return True, False
    wide = [seen, *(f for a in STRETCHES if (f := e.footprint(1e3 * a)) is not None)]
    if seen.signal != "force" and all(f.gain_upper <= f.gain_lower for f in wide):
        return False, True
    mode = dry or ("gain" if known else "load")
    if mode == "both" and seen.signal == "position":  # no opposition to a speed: the error would be F + k |s|
        mode = "load"
    return mode != "load", mode != "gain"


def _sector(e: AttachedEffect, port: Port, seen: Footprint, amplitude: Amplitude | None, width: float) -> ForceSector:
    ends = _pair(1.0 if amplitude is None else amplitude)
    all_of = [f for a in ends for f in e.footprints(a, width)]
    low, high = min(f.gain_lower for f in all_of), max(f.gain_upper for f in all_of)
    if seen.offset and ends[0] < ends[1]:
        at_largest = [f.describing for f in e.footprints(ends[1], width)]
        low = max(low, min(at_largest)) if np.isfinite(at_largest).all() else low
    unit, row = port.speed_unit, port.velocity
    if seen.signal == "position" and port.position is not None:
        unit, row = port.position_unit, port.position
    if seen.signal == "force":
        valid, row = "a gain that may change at every instant, for every motion", np.zeros_like(row)
    elif amplitude is None:
        valid = "at every amplitude, as a gain that may change with the motion"
    elif seen.offset:
        reach = f"{ends[0]:.4g} {unit} and more" if ends[0] == ends[1] else f"{ends[0]:.4g} to {ends[1]:.4g} {unit}"
        valid = f"harmonic balance, for oscillations of amplitude{'' if ends[0] == ends[1] else 's'} {reach}"
    else:
        valid = f"up to {ends[1]:.4g} {unit}, as a gain that may change with the motion"
    units = "" if seen.signal == "force" else f"{port.unit}/({unit})"
    gains = ParameterRange(0.5 * (low + high), 0.5 * (high - low), units)
    return ForceSector(e, port, seen.signal, gains, row, valid, bool(seen.offset) and seen.signal != "force")


@dataclass(frozen=True, eq=False)
class EffectBlocks(Displayable):
    """A plant with effects as an uncertain model."""

    model: UncertainModel  # its inputs are those of ``noise``, then the plant's
    noise: tuple[NoiseInput, ...]  # inputs for bounded errors
    left_out: Mapping[str, str]  # effect at its place -> reason why it is in no block
    approximate: tuple[str, ...] = ()  # names of the blocks that hold by harmonic balance only, for oscillations
    status: Status = Status.CONVERGED  # the nominal member equals the plant's linear model

    @property
    def origins(self) -> dict[str, str]:
        return {b.name: b.origin for b in self.model.blocks}

    @property
    def notes(self) -> tuple[str, ...]:
        names = ", ".join(self.approximate)
        harmonic = f"{names}: holds by harmonic balance, for oscillations that its line names, not for every motion."
        notes = {
            harmonic: self.approximate,
            "Inputs for bounded errors come first; one is the bound in their row.": self.noise,
            "What is proved for this set says nothing about the effects that are not in it.": self.left_out,
        }
        return tuple(text for text, there in notes.items() if there)

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
    """Build the uncertain model of a plant with or without effects."""
    width = checks.number("effect_blocks: sigmas", sigmas, "0 or more", at_least=0)
    checks.whole("effect_blocks: pade", pade, 1, 8)
    if dry not in (None, *get_args(Dry)):
        raise InputError("effect_blocks: dry", f"{dry!r}", f"one of {', '.join(get_args(Dry))}")
    plant, amplitude = _extended(plant, "effect_blocks"), amplitude or {}
    _check_amplitudes(plant, amplitude)
    sectors, bounded, replacements, left_out = _force_parts(plant, amplitude, dry, width)
    levels = _signal_amplitudes(plant, amplitude)
    linear = plant.linear_model(None, levels, replacements=replacements)
    point = linear.operating_point
    assert point is not None
    loads = [*bounded, *_residual_force(plant.model, unnamed)]
    inner = tied_plant(without_signals(plant, linear, width), tied)
    whole = _with_origins(_with_forces(inner, [*(s.port for s in sectors), *_ports(loads)], sectors).uncertain(), inner)
    signals = plant.signal_levels(point.x, point.u)
    whole = with_signals(_with_sectors(whole, sectors, len(plant.inputs)), signals, levels, width, pade)
    errors = _placed(loads, plant)
    for e, k, _ in sorted(signals, key=lambda signal: signal[0].site.kind):  # inputs first
        if e.site.kind == "output":
            signal, bound, at = plant.outputs[k], e.largest_offset(width), len(plant.inputs) + len(loads) + k
            words, name = f"{e.in_words} as a bounded error; {e.values_in_words}", f"noise {signal.name}: {e.effect.id}"
            errors += [(NoiseInput(name, bound, signal.unit, words), at)] if bound else []
            continue
        if e.site.name not in amplitude and _is_bounded_error(plant, e):
            errors += _placed([_load(plant, {}, e, width, "a bounded error, for every motion")], plant)
        if (seen := e.footprint()) and seen.offset:
            left_out[f"{e!r}"] = "a bounded error of an input"
    approximate = tuple(s.effect.key for s in sectors if s.approximate)
    made = EffectBlocks(*_errors_first(whole, plant, errors), left_out, approximate)
    _check(plant.linear_model(None, levels, pade, replacements=replacements), plant.name, made)
    return replace(made, model=with_outputs(made.model, outputs))


def _extended(plant: Any, where: str) -> ExtendedPlant:
    """Return a linear plant as one with effects, perhaps none."""
    if isinstance(plant, LinearPlant):
        return ExtendedPlant(plant.name, plant.parameters, plant.inputs, plant.outputs, plant.states, plant, ())
    if not isinstance(plant, ExtendedPlant) or not plant.is_linear:
        found = "a nonlinear plant" if isinstance(plant, ExtendedPlant) else type(plant).__name__
        raise InputError(where, found, "a linear plant, with or without effects")
    return plant


def _signal_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> dict[str, float]:
    """Return the amplitudes of drivers and sensors; those with a sector must have one."""
    signals = [e for e in plant.effects if e.on_signal]
    missing = {
        e.site.name: e.effect.title
        for e in signals
        if e.scale is None
        and e.site.name not in amplitude
        and e.sector({e.site.name: 1.0}, ("input", "output")) is not None
        and not _is_bounded_error(plant, e)
    }
    if missing:
        raise _no_amplitude(missing)
    return {e.site.name: float(_pair(amplitude[e.site.name])[1]) for e in signals if e.site.name in amplitude}


def _is_bounded_error(plant: ExtendedPlant, e: AttachedEffect) -> bool:
    others = [o for o in plant.effects if o.site == e.site and o is not e and o.scale is not None]
    return e.site.kind == "input" and e.input_error() is not None and not others


def _errors_first(
    whole: UncertainModel, plant: ExtendedPlant, errors: Sequence[tuple[NoiseInput, int]]
) -> tuple[UncertainModel, tuple[NoiseInput, ...]]:
    """Put bounded errors as unit inputs before the plant's own; indices count inputs, forces and output errors."""
    m, (q, p) = whole.M, whole.delta_shape
    n_u, n_y = len(plant.inputs), len(plant.outputs)
    columns = [*range(q), *(q + k for _, k in errors), *range(q, q + n_u)]
    scale = np.array([*[1.0] * q, *(e.bound for e, _ in errors), *[1.0] * n_u])
    b = np.hstack([m.B, np.zeros((m.n_states, n_y))])[:, columns] * scale
    d = np.hstack([m.D, np.eye(m.n_outputs)[:, p : p + n_y]])[:, columns] * scale
    inputs = [*m.inputs[:q], *((e.name, "1") for e, _ in errors), *plant.inputs]
    outputs = [*m.outputs[:p], *plant.outputs]
    model = StateSpaceModel(m.A, b, m.C, d, m.dt, inputs, outputs, m.states, where="effect_blocks")
    return UncertainModel(model, whole.blocks), tuple(e for e, _ in errors)


def _residual_force(model: PortModel, given: tuple[float, str] | None) -> list[Load]:
    if given is None:
        return []
    port = next((p for p in model.ports.values() if p.kind == "joint"), None)
    if port is None:
        raise InputError("effect_blocks: unnamed", "a plant without joints", "a joint at which the force acts")
    return [(NoiseInput(f"load {port.name}: unnamed", given[0], port.unit, given[1]), port)]


def _with_forces(plant: LinearPlant, ports: Sequence[Port], sectors: Sequence[ForceSector] = ()) -> LinearPlant:
    """Return the plant with forces at the ports as further inputs, and arguments of sectors as further outputs."""
    if not ports:
        return plant
    push = plant.matrices(plant.values)[0] @ np.array([p.force for p in ports]).T

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, c, d = plant.matrices(p)
        seen_c, seen_d = np.zeros((len(sectors), len(f))), np.zeros((len(sectors), g.shape[1] + len(ports)))
        for k, s in enumerate(sectors):
            if s.signal != "force":
                seen_c[k] = s.row
                continue
            dual = push[:, k] / float(push[:, k] @ push[:, k])
            others = push * (np.arange(len(ports)) != k)
            seen_c[k], seen_d[k] = dual @ f, np.concatenate([dual @ g, dual @ others])
        wide = np.vstack([np.hstack([d, np.zeros((len(c), len(ports)))]), seen_d])
        return Descriptor(e, f, np.hstack([g, push]), np.vstack([c, seen_c]), wide)

    inputs = (*plant.inputs, *(Signal(f"force {i} at {p.name}", p.unit) for i, p in enumerate(ports)))
    seen = (Signal(f"{s.signal} {i} at {s.port.name}", s.port.speed_unit) for i, s in enumerate(sectors))
    return LinearPlant(
        plant.name, plant.parameters, inputs, (*plant.outputs, *seen), plant.states, equations, plant.exact
    )


def _with_origins(uncertain: UncertainModel, plant: LinearPlant) -> UncertainModel:
    blocks = []
    for b in uncertain.blocks:
        p = plant.parameters[b.name]
        text = f"parameter {b.name} = {p.value:.6g} {p.unit}".rstrip()
        text += f", {p.meaning}" if p.meaning else ""
        blocks.append(replace(cast("Any", b), origin=text + (f"; {p.source}" if p.source else "")))
    return UncertainModel(uncertain.M, blocks, uncertain.operating_point)


def _with_sectors(whole: UncertainModel, sectors: Sequence[ForceSector], n_u: int) -> UncertainModel:
    """Close the sectors' forces as ``f = -r delta s``; their middle gains are in the plant already."""
    if not sectors:
        return whole
    m, (q, p), k = whole.M, whole.delta_shape, len(sectors)
    n_y = len(whole.outputs) - k
    ins, outs = np.arange(m.n_inputs), np.arange(m.n_outputs)
    columns = [*ins[:q], *ins[q + n_u : q + n_u + k], *ins[q : q + n_u], *ins[q + n_u + k :]]
    rows = [*outs[:p], *outs[p + n_y :], *outs[p : p + n_y]]
    scale = np.ones(m.n_inputs)
    scale[q : q + k] = [s.range.radius if s.signal == "force" else -s.range.radius for s in sectors]
    inputs, outputs = [m.inputs[j] for j in columns], [m.outputs[j] for j in rows]
    inputs[q : q + k], outputs[p : p + k] = ([Signal(f"{w}_{s.effect.key}") for s in sectors] for w in "wz")
    model = StateSpaceModel(
        m.A, m.B[:, columns] * scale, m.C[rows], m.D[np.ix_(rows, columns)] * scale, m.dt, inputs, outputs, m.states,
        where="effect_blocks",
    )  # fmt: skip
    blocks = []
    for s in sectors:
        seen = "of the force there" if s.signal == "force" else f"of its {s.signal}"
        words = f"{s.effect.in_words} as a sector {seen}; {s.valid}; {s.effect.values_in_words}"
        blocks.append(RealScalar(s.effect.key, 1, s.range, origin=words))
    return UncertainModel(model, [*whole.blocks, *blocks], whole.operating_point)


def _check(own: StateSpaceModel, name: str, made: EffectBlocks) -> None:
    """Check that the nominal member equals the plant's linear model."""
    found = made.model.nominal.select(own.input_names, own.output_names)
    size = np.abs(own.poles())
    omega = np.geomspace(max(size[size > 0].min(initial=1.0), 1e-6), max(size.max(initial=1.0), 1e-5), 7) * 1.0371
    a, b = (frequency_response(m, omega) for m in (found, own))
    off = float(np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-300))
    if off > NOMINAL_EXACT:
        text = f"the nominal member is off the linear model by {off:.2g} of its response"
        raise NoTrustworthyNumber(f"{name}: effect_blocks", text)


# Number of samples of largest force at which a law is evaluated with other parameter values.
LARGEST_SAMPLES = 200


@dataclass(frozen=True, eq=False)
class EffectLoads:
    """A plant as a linear set with loads."""

    plant: ExtendedPlant
    model: UncertainModel  # inputs: the loads over their bounds, then the plant's
    loads: tuple[NoiseInput, ...]
    effects: tuple[AttachedEffect, ...]  # of each load

    def along(self, record: Record) -> Record:
        """Return the record with the simulated loads as further inputs."""
        if not self.loads:
            return record
        made = _along(self.plant, self.effects, record)[0]
        added = {load.name: signal / load.bound for load, signal in zip(self.loads, made, strict=True)}
        units = {**record.units, **{load.name: "1" for load in self.loads}}
        return Record(record.t, {**record.inputs, **added}, record.outputs, units, record.name, record.meaning)


def _along(plant: ExtendedPlant, effects: Sequence[AttachedEffect], record: Record) -> tuple[list[Array], Array]:
    """Return each effect's mean force or input error in each sample (n,) of a record, and the states (n, n_x)."""
    where, names = f"loads along {record.name}", [s.name for s in plant.inputs]
    missing = [name for name in names if name not in record.inputs]
    if missing:
        raise InputError(where, f"no input {missing[0]!r}", ", ".join(names))
    if not record.is_uniform:
        raise InputError(where, "irregular sampling", "equal steps", "resample the record")
    seen = {name: record.inputs[name] for name in names}
    # the smallest initial state of the plant with the first measured outputs
    measured = [k for k, s in enumerate(plant.outputs) if s.name in record.outputs]
    first = np.array([record.outputs[plant.outputs[k].name][0] for k in measured])
    own = plant.model.own
    x0 = np.linalg.pinv(plant.model.C[measured, :own]) @ first if measured else np.zeros(own)
    states, _, forces = plant.forced(np.column_stack(list(seen.values())), record.dt, float(record.t[0]), x0, None)
    found = []
    for e in effects:
        if e.site.kind == "input":
            after = e.effect.input(seen[e.site.name], e.values, record.dt)
            found.append(after - seen[e.site.name])
            seen[e.site.name] = after
        else:
            found.append(forces[:, [other is e for other, _, _ in plant.laws]].sum(axis=1))
    return found, states


def effect_loads(plant: Any, sigmas: float = 2.0, records: Sequence[Record] = (), margin: float = 1.0) -> EffectLoads:
    """Return a plant with effects as its linear part with loads, bounded for every motion or along the records."""
    plant = _extended(plant, "effect_loads")
    linear = [e for e in plant.effects if _is_linear(e)]
    rest = with_effects(plant.plant, linear) if linear else _extended(plant.plant, "")
    base, ports = without_signals(rest, rest.linear_model(), sigmas), rest.model.ports
    effects = tuple(e for e in plant.effects if e not in linear and e.effect.nameable)
    made = [_load(plant, ports, e, sigmas) for e in effects]
    free = [k for k, (load, _) in enumerate(made) if not np.isfinite(load.bound)]
    if free and not records:
        where = f"effect_loads: {made[free[0]][0].name}"
        raise InputError(where, "no bound whatever the motion", "records whose motion bounds it")
    runs = [_along(plant, effects, record) for record in records] if free else []
    times = "" if margin == 1.0 else f"{margin:g} times the largest "
    within = f"{times}within the motion of {', '.join(r.name for r in records)}"
    for k in free:
        (load, way), e = made[k], effects[k]
        size = margin * max(_largest(plant, e, signals[k], states, sigmas) for signals, states in runs)
        made[k] = replace(load, bound=size, origin=f"{load.origin}; {within}"), way
    whole = _with_forces(base, _ports(made)).uncertain()
    return EffectLoads(plant, *_errors_first(whole, plant, _placed(made, plant)), effects)


def _largest(plant: ExtendedPlant, e: AttachedEffect, signal: Array, states: Array, sigmas: float) -> float:
    """Return the largest magnitude of a load along a motion, for all values of its effect."""
    law, port = next((law, port) for other, law, port in plant.laws if other is e)
    seen = e.footprint()
    if law.memory or seen is None or seen.signal in ("force", "time") or is_set_valued(law, 0.0):
        nominal = e.largest_gain(0.0)
        return float(np.abs(signal).max()) * (e.largest_gain(sigmas) / nominal if nominal else 1.0)
    most = states[np.argsort(-np.abs(_law_along(law, port, states)))[:LARGEST_SAMPLES]]
    laws = [other for values in e.corners(sigmas) for other in e.effect.laws(e.site, values)]
    return max(float(np.abs(_law_along(other, port, most)).max()) for other in laws)


def _law_along(law: Law, port: Port, states: Array) -> Array:
    """Return the force of a law of position and speed at each state, (n,)."""
    v = states @ port.velocity
    q = np.zeros_like(v) if port.position is None else states @ port.position
    return np.array([
        steady_force(law, at, speed) if speed else 0.5 * sum(rest_band(law, at))
        for at, speed in zip(q.tolist(), v.tolist(), strict=True)
    ])  # fmt: skip


def loaded_model(plant: ExtendedPlant, at: Trim, sigmas: float = 2.0) -> tuple[StateSpaceModel, tuple[NoiseInput, ...]]:
    """Return the linear model with bounded loads of a nonlinear plant with effects at a trim, and these loads."""
    linear, ports = plant.linear_model(at), plant.about(at.x, plant.mapped_input(at.u)).model.ports
    effects = [e for e in plant.effects if not _is_linear(e) and e.effect.nameable]
    made = [_load(plant, ports, e, sigmas) for e in effects]
    loads = tuple(load for load, _ in made)
    for e, load in zip(effects, loads, strict=True):
        if not np.isfinite(load.bound):
            raise InputError(f"loads of {e.in_words}", "no bound whatever the motion", "effects that have one")
    columns = [load.bound * (linear.B[:, way] if isinstance(way, int) else way.force) for load, way in made]
    b = np.column_stack([*columns, linear.B])
    d = np.hstack([np.zeros((len(linear.C), len(loads))), linear.D])
    inputs = [*((load.name, "1") for load in loads), *linear.inputs]
    point = OperatingPoint(at.x, np.concatenate([np.zeros(len(loads)), at.u]), at.y)
    model = StateSpaceModel(linear.A, b, linear.C, d, 0.0, inputs, linear.outputs, linear.states, point, plant.name)
    return model, loads


def _is_linear(e: AttachedEffect) -> bool:
    return not e.on_signal and not e.laws()


# A bounded force or input error, and its port or the index of its input.
Load = tuple[NoiseInput, Port | int]


def _load(plant: ExtendedPlant, ports: Mapping[str, Port], e: AttachedEffect, sigmas: float, kind: str = "") -> Load:
    """Return the load of an effect; its bound is infinite if only a motion bounds it."""
    words = f"{e.in_words}{' as ' if kind else ''}{kind}; {e.values_in_words}"
    if e.site.kind == "input":
        bound = e.input_error(sigmas)
        k = [s.name for s in plant.inputs].index(e.site.name)
        if bound is not None:
            return NoiseInput(e.load_name, float(bound), plant.inputs[k].unit, words), k
    elif not e.on_signal and e.site.name in ports and not e.effect.structural:
        port = ports[e.site.name]
        return NoiseInput(e.load_name, e.largest_offset(sigmas) or math.inf, port.unit, words), port
    hint = "rl.uncertain_from has sectors and weights for such effects"
    where, expected = f"effect_loads: {e.in_words}", "effects that are one of these"
    raise InputError(where, "neither linear nor bounded whatever the motion", expected, hint)


def _ports(loads: Sequence[Load]) -> list[Port]:
    return [way for _, way in loads if isinstance(way, Port)]


def _placed(loads: Sequence[Load], plant: ExtendedPlant) -> list[tuple[NoiseInput, int]]:
    """Return loads with the index of their input, forces after the plant's inputs."""
    forces = itertools.count(len(plant.inputs))
    return [(load, way if isinstance(way, int) else next(forces)) for load, way in loads]


# --- the linear part with its tolerances ------------------------------------------------------------------------------

# Allowed difference of entries of an exact form, relative to the largest of the matrix.
FORM_ROUNDING = 1e-9


def without_signals(plant: ExtendedPlant, linear: StateSpaceModel, width: float) -> LinearPlant:
    """Return the linear model as a plant in descriptor form, affine in the parameters with tolerances."""
    base: Any = plant.plant
    if not plant.effects:
        return base
    factors = factors_of(base, plant.effects)
    scaled = base.values | {name: base.parameters[name].reference * factor for name, factor in factors.items()}
    parameters = {name: replace(p, value=scaled[name]) for name, p in base.parameters.items()}
    tied: dict[str, list[str]] = {}
    for e in plant.effects:
        names = list(factors_of(base, [e]))
        if not (names and e.scale and e.scale_std):
            continue
        tolerance = width * e.scale_std / e.scale
        for name in names:
            parameters[name] = replace(parameters[name], tolerance=tolerance if len(names) == 1 else 0.0)
        if len(names) > 1:
            label = f"{e.effect.id}({e.site.name})"
            parameters[label] = Parameter(
                label, 1.0, "", tolerance, e.source, f"{e.effect.title}, over the fitted value"
            )
            tied[label] = names
    structure = _structure(plant, linear, scaled)
    nominal = structure(scaled)
    terms = _joint_terms(plant, nominal[0], width)
    parameters |= {label: parameter for label, (parameter, _) in terms.items()}
    constant = nominal[0] @ linear.A - nominal[1]
    matrices = with_factors(structure, base.parameters, scaled, tied)

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, c, d = matrices(p)
        for label, (parameter, per_unit) in terms.items():
            f = f + (p[label] - parameter.value) * per_unit
        return Descriptor(e, f + constant, g, c, d)

    return LinearPlant(plant.name, parameters, plant.inputs, plant.outputs, plant.states, equations, base.exact)


def _joint_terms(plant: ExtendedPlant, inertia: Array, width: float) -> dict[str, tuple[Parameter, Array]]:
    """Return fitted springs and dampers at joints: parameter, and the entries of F per unit of it."""
    found: dict[str, tuple[Parameter, Array]] = {}
    for e in plant.effects:
        if e.site.kind not in ("joint", "current") or e.laws() or e.effect.structural:  # a split joint stays nominal
            continue
        for parameter in e.parameters:
            value, std = e.values[parameter.name], e.std.get(parameter.name, 0.0)
            if not std:
                continue
            first, second = (
                extended_model(plant.plant, [other if item is e else item for item in plant.effects]).A - plant.model.A
                for share in (1.25, 1.5)
                for other in [replace(e, values={**e.values, parameter.name: share * value})]
            )
            if not np.allclose(second, 2.0 * first, rtol=FORM_ROUNDING, atol=0.0):
                continue
            label = f"{e.key}.{parameter.name}"
            tolerance = width * std / abs(value)
            per_unit = inertia @ first / (0.25 * value)
            found[label] = Parameter(label, value, parameter.unit, tolerance, e.source, e.effect.title), per_unit
    return found


def _structure(
    plant: ExtendedPlant, linear: StateSpaceModel, scaled: Mapping[str, float]
) -> Callable[[Mapping[str, float]], list[Array]]:
    """Return a function from parameter values to E, F, G, C, D of all states, without a constant part of F."""
    base: Any = plant.plant
    own, size = plant.model.own, len(plant.states)
    inertia = base.matrices(scaled)[0]
    split: list[tuple[int, int, float]] = []  # joint, its relative position, the load's share
    for name, port in plant.model.ports.items():
        if name.endswith(".load"):
            joint = [s.name for s in plant.states].index(name.removesuffix(".load"))
            rate = int(np.flatnonzero(port.velocity[own:])[0]) + own
            split.append((joint, rate - 1, 1.0 / (float(port.velocity @ port.force) * inertia[joint, joint])))

    def matrices(values: Mapping[str, float]) -> list[Array]:
        e0, f0, g0, c0, d0 = base.matrices(values)
        e, f, g = np.eye(size), np.zeros((size, size)), np.zeros((size, g0.shape[1]))
        e[:own, :own], f[:own, :own], g[:own] = e0, f0, g0
        for joint, first, share in split:
            e[joint, joint] = (1.0 - share) * e0[joint, joint]
            f[joint, first : first + 2] = e[joint, joint] * linear.A[joint, first : first + 2]
            e[first + 1, joint] = -1.0
        return [e, f, g, np.hstack([c0, np.zeros((len(c0), size - own))]), d0]

    return matrices


def _lag_block(time: float, spread: float, name: str, origin: str) -> UncertainModel:
    """Return the exact set of all lags :math:`1 / (1 + s T)` with T within ``spread`` of ``time``, in s."""
    if not 0.0 <= spread < time:
        raise InputError(f"lag {name}", f"{time:g} s +- {spread:g} s", "a time constant that stays positive")
    a = -1.0 / time
    if not spread:
        return UncertainModel(StateSpaceModel([[a]], [[-a]], [[1.0]], [[0.0]]), [])
    model = StateSpaceModel([[a]], [[a * spread, -a]], [[a], [1.0]], [[a * spread, -a], [0.0, 0.0]])
    return UncertainModel(model, [RealScalar(name, 1, ParameterRange(time, spread, "s"), origin=origin)])


def delay_block(delay: float, spread: float, pade: int, name: str, origin: str = "") -> UncertainModel:
    r"""Return a cover :math:`P + w \Delta` of all delays from ``delay - spread`` (at least 0) to ``delay + spread``."""
    n = checked_order(pade, "delay_block", 1)
    # With a spread the error's slope changes from 1 to 2 n + 1: a weight of lower order fits better.
    made = covering(delay, spread, n, n + 1 if spread else min(n + 2, 2 * n + 1))
    return UncertainModel(made.M, [FullBlock(name, 1, 1, origin=origin, covers=made.blocks[0].covers)])


def with_signals(
    whole: UncertainModel,
    signals: Sequence[tuple[AttachedEffect, int, float]],
    amplitude: Mapping[str, float],
    width: float,
    pade: int = 0,
) -> UncertainModel:
    """Add uncertain gains of effects (effect, index of signal, level), and with ``pade`` their delays and lags."""
    into, out = ([s for s in signals if s[0].site.kind == kind] for kind in ("input", "output"))
    for e, k, level in [*reversed(into), *out]:  # the effect next to the plant first
        for block in _signal_blocks(e, level, amplitude, width, pade):
            if e.site.kind == "input":
                whole = product(whole, _at_channel(block, whole.inputs, k, e.key))
            else:
                whole = product(_at_channel(block, whole.outputs, k, e.key), whole)
    return whole


def _signal_blocks(
    e: AttachedEffect, level: float, amplitude: Mapping[str, float], width: float, pade: int
) -> list[UncertainModel]:
    """Return the blocks of an effect in its signal: an uncertain gain, a delay, a lag."""
    found: list[UncertainModel] = []
    gain, seen = e.gain(level, amplitude), e.sector(amplitude, ("input", "output"))
    reach = width * e.scale_std if seen is None else 0.5 * (seen.gain_upper - seen.gain_lower)
    if reach:
        words = f"{e.in_words}" + ("" if seen is None else " as a sector") + f"; {e.values_in_words}"
        block = RealScalar(e.key, 1, ParameterRange(gain, reach), origin=words)
        found.append(UncertainModel(StateSpaceModel([], [], [], [[0.0, reach], [1.0, gain]]), [block]))
    elif gain != 1.0:
        found.append(UncertainModel(StateSpaceModel([], [], [], [[gain]]), []))
    if e.delay and pade:
        spread = width * e.std.get(e.effect.delay, 0.0)
        words = f"{e.in_words}, {e.delay:.6g} s +- {spread:.3g} s, as Padé of order {pade} and a weight proved to cover"
        words = f"{words} what that misses; {e.values_in_words}"
        found.append(delay_block(e.delay, spread, pade, e.key, words))
    if e.time_constant and pade:
        spread = width * e.std.get(e.effect.time_constant, 0.0)
        words = f"{e.in_words}, {e.time_constant:.6g} s +- {spread:.3g} s; {e.values_in_words}"
        found.append(_lag_block(e.time_constant, spread, e.key, words))
    return found


def _at_channel(block: UncertainModel, signals: Sequence[Signal], k: int, name: str) -> UncertainModel:
    """Return the block of this name in signal k, with identity in all others."""
    g, (q, p), n = block.M, block.delta_shape, len(signals)
    into, out = np.zeros((q + 1, q + n)), np.zeros((p + n, p + 1))
    into[:q, :q], into[q, q + k] = np.eye(q), 1.0
    out[:p, :p], out[p + k, p] = np.eye(p), 1.0
    passed = np.zeros((p + n, q + n))
    passed[p:, q:] = np.diag(np.arange(n) != k)
    model = StateSpaceModel(
        g.A, g.B @ into, out @ g.C, out @ g.D @ into + passed, 0.0,
        [*(f"w_{name}" for _ in range(q)), *signals], [*(f"z_{name}" for _ in range(p)), *signals],
        [f"{name} {i + 1}" for i in range(g.n_states)], where="effect_blocks",
    )  # fmt: skip
    return UncertainModel(model, block.blocks)
