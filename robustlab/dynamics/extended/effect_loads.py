r"""Effects as loads: the linear part of a plant, driven by bounded signals that stand for its nonlinear effects.

.. math::
    \dot x = A x + B\,(u + d) + \sum_j b_j f_j, \qquad |f_j| \le F_j, \quad |d| \le d_{max}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Law
from robustlab.dynamics.extended.attached_effect import AttachedEffect, is_set_valued, rest_band, steady_force
from robustlab.dynamics.extended.effect_blocks import NoiseInput, with_forces
from robustlab.dynamics.extended.extended_plant import (
    ExtendedNonlinearPlant,
    ExtendedPlant,
    with_effects,
    without_signals,
)
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_contract import Trim
from robustlab.dynamics.ports.port_model import Port, port_model
from robustlab.dynamics.simulation import transition
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.record import Record
from robustlab.statespace import OperatingPoint, StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel

# The simulated states must be those of the linear part under the loads to this share of their size.
LOADS_EXACT = 1e-6
# Points of a sample at which the response to a load is looked at.
LOAD_POINTS = 16
# Of what the laws at one port leave open, one that position and speed tell takes so much less than the others.
TOLD_SHARE = 1e-3
# Samples, those of the largest force, at which a law is asked with other values of its parameters.
TOLD_SAMPLES = 200


@dataclass(frozen=True, eq=False)
class EffectLoads:
    """A plant as a linear set with loads."""

    plant: LinearPlant | ExtendedPlant  # what it was made of
    # its inputs are the loads, each over its bound, so that they are at most one, then the plant's
    model: UncertainModel
    loads: tuple[NoiseInput, ...]  # name of the input, bound, unit and origin of each load
    # for each load its effect, and the port or the number of the input where it acts
    acts: tuple[tuple[AttachedEffect, Port | int], ...] = ()

    def along(self, record: Record) -> Record:
        """The record with the loads as further inputs, as the plant with its effects makes them under its inputs."""
        if not self.loads:
            return record
        signals = self._signals(record, *self._motion(record))
        added = {load.name: signals[:, k] for k, load in enumerate(self.loads)}
        units = {**record.units, **{load.name: "1" for load in self.loads}}
        return Record(record.t, {**record.inputs, **added}, record.outputs, units, record.name, record.meaning)

    def _motion(self, record: Record) -> tuple[Array, Array]:
        """Inputs (n, n_u), and the states of the plant with its effects under them (n, n_x)."""
        assert isinstance(self.plant, ExtendedPlant)
        where = f"loads along {record.name}"
        missing = [s.name for s in self.plant.inputs if s.name not in record.inputs]
        if missing:
            raise InputError(where, f"no input {missing[0]!r}", ", ".join(s.name for s in self.plant.inputs))
        u = np.column_stack([record.inputs[s.name] for s in self.plant.inputs])
        if not record.is_uniform:
            raise InputError(where, "irregular sampling", "equal steps", "resample the record")
        clock, x0 = resting_start(self.plant, record)
        return u, self.plant.stepped(clock, u, self.plant.whole_state(x0))[0]

    def _size(self, j: int, record: Record, known: Sequence[NoiseInput], sigmas: float) -> float:
        """Largest size of a load along a record where all bounds here are one; ``known`` has those of the others."""
        u, states = self._motion(record)
        told, e = self._told(j, states), self.acts[j][0]
        if told is not None:  # for all its values, along the motion of the nominal ones
            largest, port = states[np.argsort(-np.abs(told))[:TOLD_SAMPLES]], self._law(j)[1]
            laws = [law for values in e.corners(sigmas) for law in e.effect.laws(e.site, values)]
            return max(float(np.abs(_law_along(law, port, largest)).max()) for law in laws)
        signals, others = self._signals(record, u, states), self._sharing().get(j, [])
        # The whole force at the port, and what the others may have taken off it.
        whole = float(np.abs(signals[:, [j, *others]].sum(axis=1)).max())
        for i in others:
            told = None if np.isfinite(known[i].bound) else self._told(i, states)
            size = known[i].bound if told is None else float(np.abs(told).max())
            if not np.isfinite(size):
                found = f"{known[j].name} and {known[i].name}"
                raise InputError("effect_loads", found, "forces that the motion or a bound tells apart")
            whole += size
        nominal = e.largest_gain(0.0)
        return whole * (e.largest_gain(sigmas) / nominal if nominal else 1.0)

    def _sharing(self) -> dict[int, list[int]]:
        """For each load that is not alone at its port, the others there: their sum is all that a motion tells."""
        at = {j: way.name for j, (_, way) in enumerate(self.acts) if isinstance(way, Port)}
        found = {j: [i for i in at if i != j and at[i] == at[j]] for j in at}
        return {j: others for j, others in found.items() if others}

    def _told(self, j: int, states: Array) -> Array | None:
        """The force of a load's law at each sample (n,); None where position and speed do not tell it."""
        e, (law, port) = self.acts[j][0], self._law(j)
        seen = e.footprint()
        if law.memory or seen is None or seen.signal in ("force", "time") or is_set_valued(law, 0.0):
            return None
        return _law_along(law, port, states)

    def _law(self, j: int) -> tuple[Law, Port]:
        """The law of a load's effect, and its port in the plant with all effects."""
        assert isinstance(self.plant, ExtendedPlant)
        return next((law, port) for e, law, port in self.plant.laws if e is self.acts[j][0])

    def _shares(self, states: Array) -> tuple[Array, Array]:
        """For each load what its law alone tells of it (n - 1, n_loads), and its share of what that leaves open."""
        prior, share = np.zeros((len(states) - 1, len(self.loads))), np.ones(len(self.loads))
        for j in self._sharing():
            told = self._told(j, states)
            if told is not None:
                prior[:, j], share[j] = 0.5 * (told[1:] + told[:-1]) / self.loads[j].bound, TOLD_SHARE
        return prior, share

    def _signals(self, record: Record, u: Array, states: Array) -> Array:
        """Loads (n, n_loads): what the linear part needs to go through the simulated states."""
        where = f"loads along {record.name}"
        nominal, h = self.model.nominal, record.dt
        names = [s.name for s in nominal.states]
        x = states[:, [[s.name for s in self.plant.states].index(name) for name in names]]
        phi, gamma, _ = transition(nominal, h)
        k = len(self.loads)
        signals = np.zeros((len(u), k))
        known = {load.name: s / load.bound for load, s in _driver_errors(self, u, h)}
        columns = [j for j, load in enumerate(self.loads) if load.name not in known]
        for j in set(range(k)) - set(columns):
            signals[:, j] = known[self.loads[j].name]
        rest = x[1:] - x[:-1] @ phi.T - u[:-1] @ gamma[:, k:].T - signals[:-1] @ gamma[:, :k].T
        size = np.abs(x).max(axis=0, initial=0.0) + 1e-300
        if columns:
            prior, share = (part[..., columns] for part in self._shares(states))
            open_still = rest - prior @ gamma[:, columns].T
            solved = np.linalg.lstsq(gamma[:, columns] * share / size[:, None], (open_still / size).T, rcond=None)[0]
            found = prior + solved.T * share
            signals[:-1, columns] = found
            signals[-1, columns] = found[-1]
            rest = rest - found @ gamma[:, columns].T
        # A load that changes within a sample is not its mean there: a reversal of dry friction in the midst of one.
        reach = max(1.0, float(np.abs(signals).max(initial=0.0)))
        within = 2.0 * reach * _spread(nominal.A, nominal.B[:, :k], h)
        off = float(((np.abs(rest) - within) / size).max(initial=0.0))
        if off > LOADS_EXACT:
            raise NoTrustworthyNumber(where, f"they miss the simulated states by {off:.1e} of their size")
        return signals


def _law_along(law: Law, port: Port, states: Array) -> Array:
    """Force of a law that position and speed tell, at each state (n,)."""
    v = states @ port.velocity
    q = np.zeros_like(v) if port.position is None else states @ port.position
    return np.array([
        steady_force(law, at, speed) if speed else 0.5 * sum(rest_band(law, at))
        for at, speed in zip(q.tolist(), v.tolist(), strict=True)
    ])  # fmt: skip


def resting_start(plant: LinearPlant | ExtendedPlant, record: Record) -> tuple[Array, Array]:
    """A record's clock (n,), and the smallest state of the plant alone that shows the outputs measured first."""
    extended = isinstance(plant, ExtendedPlant)
    own = plant.model.own if extended else len(plant.states)
    C = plant.model.C if extended else plant.state_space().C
    shown = [k for k, s in enumerate(plant.outputs) if s.name in record.outputs]
    first = np.array([record.outputs[plant.outputs[k].name][0] for k in shown])
    x0 = np.linalg.pinv(C[shown, :own]) @ first if shown else np.zeros(own)
    clock = record.t[0] + record.dt * np.arange(record.n) if record.is_uniform else record.t
    return clock, np.asarray(x0, dtype=np.float64)


def effect_loads(plant: Any, sigmas: float = 2.0, records: Sequence[Record] = (), margin: float = 1.0) -> EffectLoads:
    """A plant with effects as its linear part with bounded loads."""
    if isinstance(plant, LinearPlant):
        return EffectLoads(plant, plant.uncertain(), ())
    if not isinstance(plant, ExtendedPlant):
        raise InputError("effect_loads", type(plant).__name__, "a linear plant, with or without effects")
    linear = [e for e in plant.effects if _is_linear(e)]
    base: LinearPlant = plant.plant
    ports = port_model(base).ports
    if linear:
        rest = with_effects(plant.plant, linear)
        base, ports = without_signals(rest, rest.linear_model(), sigmas), rest.model.ports
    loads: list[NoiseInput] = []
    acts: list[tuple[AttachedEffect, Port | int]] = []
    for e in plant.effects:
        if e in linear or not e.effect.nameable:
            continue
        bound, unit, way = _load(plant, ports, e, sigmas)
        loads.append(NoiseInput(e.load_name, bound, unit, f"{e.in_words}; {e.values_in_words}"))
        acts.append((e, way))
    ways = [way for _, way in acts]
    pushed = with_forces(base, [w for w in ways if isinstance(w, Port)])
    ones = tuple(replace(x, bound=1.0) for x in loads)
    bare = EffectLoads(plant, _loads_first(pushed.uncertain(), len(plant.inputs), ones, ways), ones, tuple(acts))
    bounded = _bounded_by(bare, loads, records, sigmas, margin)
    whole = _loads_first(pushed.uncertain(), len(plant.inputs), bounded, ways)
    return EffectLoads(plant, whole, tuple(bounded), tuple(acts))


def loaded_model(
    plant: ExtendedNonlinearPlant, at: Trim, sigmas: float = 2.0
) -> tuple[StateSpaceModel, tuple[NoiseInput, ...]]:
    """A nonlinear plant with effects at rest as its linear model with bounded loads, and these loads."""
    linear, ports = plant.linear_model(at), plant.about(at.x, plant.mapped_input(at.u)).model.ports
    loads, columns = [], []
    for e in plant.effects:
        if _is_linear(e) or not e.effect.nameable:
            continue
        bound, unit, way = _load(plant, ports, e, sigmas)
        if not np.isfinite(bound):
            raise InputError(f"loads of {e.in_words}", "no bound whatever the motion", "effects that have one")
        loads.append(NoiseInput(e.load_name, bound, unit, f"{e.in_words}; {e.values_in_words}"))
        columns.append(bound * (linear.B[:, way] if isinstance(way, int) else way.force))
    b = np.column_stack([*columns, linear.B])
    d = np.hstack([np.zeros((len(linear.C), len(loads))), linear.D])
    inputs = [*((load.name, "1") for load in loads), *linear.inputs]
    point = OperatingPoint(at.x, np.concatenate([np.zeros(len(loads)), at.u]), at.y)
    model = StateSpaceModel(linear.A, b, linear.C, d, 0.0, inputs, linear.outputs, linear.states, point, plant.name)
    return model, tuple(loads)


def _bounded_by(
    bare: EffectLoads, loads: Sequence[NoiseInput], records: Sequence[Record], sigmas: float, margin: float
) -> list[NoiseInput]:
    """Loads without a bound get the largest value along the records; ``bare`` has all of them in their own units."""
    free = [load for load in loads if not np.isfinite(load.bound)]
    if free and not records:
        where = f"effect_loads: {free[0].name}"
        raise InputError(where, "no bound whatever the motion", "records whose motion bounds it")
    if not free:
        return list(loads)
    times = "" if margin == 1.0 else f"{margin:g} times the largest "
    within = f"{times}within the motion of {', '.join(r.name for r in records)}"
    return [
        replace(x, bound=margin * max(bare._size(j, r, loads, sigmas) for r in records), origin=f"{x.origin}; {within}")
        if x in free else x
        for j, x in enumerate(loads)
    ]  # fmt: skip


def _is_linear(e: AttachedEffect) -> bool:
    return not e.on_signal and not e.laws()


def _load(
    plant: ExtendedPlant | ExtendedNonlinearPlant, ports: Any, e: AttachedEffect, sigmas: float
) -> tuple[float, str, Port | int]:
    """Bound, unit, and the port or the number of the input where it acts."""
    where = f"effect_loads: {e.in_words}"
    hint = "rl.uncertain_from has sectors and weights for such effects"
    if e.site.kind == "input":
        bound = e.input_error(sigmas)
        k = [s.name for s in plant.inputs].index(e.site.name)
        if bound is not None:
            return float(bound), plant.inputs[k].unit, k
    elif not e.on_signal and e.site.name in ports and not e.effect.structural:
        bound = e.largest_offset(sigmas)  # as in the blocks of `rl.uncertain_from`, which takes the same loads
        return bound or float("inf"), ports[e.site.name].unit, ports[e.site.name]
    raise InputError(where, "neither linear nor bounded whatever the motion", "effects that are one of these", hint)


def _loads_first(
    whole: UncertainModel, n_u: int, loads: Sequence[NoiseInput], ways: Sequence[Port | int]
) -> UncertainModel:
    """The loads over their bounds as inputs before the plant's own; those of drivers act where the input does."""
    m, (q, _) = whole.M, whole.delta_shape
    forces = iter(range(q + n_u, m.n_inputs))
    at = [q + way if isinstance(way, int) else next(forces) for way in ways]
    columns = [*range(q), *at, *range(q, q + n_u)]
    inputs = [*m.inputs[:q], *((load.name, "1") for load in loads), *m.inputs[q : q + n_u]]
    scale = np.ones(len(columns))
    scale[q : q + len(loads)] = [load.bound for load in loads]
    b, d = m.B[:, columns] * scale, m.D[:, columns] * scale
    model = StateSpaceModel(m.A, b, m.C, d, m.dt, inputs, m.outputs, m.states, where="effect_loads")
    return UncertainModel(model, whole.blocks)


def _spread(a: Array, b: Array, h: float) -> Array:
    """How far a load of size one may move each state in a sample beside its mean, (n,): the impulse response less its
    mean over the sample, integrated in size.
    """
    from scipy.linalg import expm

    step, way = expm(a * (h / LOAD_POINTS)), [b]
    for _ in range(LOAD_POINTS):
        way.append(step @ way[-1])
    path = np.array(way)
    return np.abs(path - path.mean(axis=0)).mean(axis=0).sum(axis=1) * h


def _driver_errors(made: EffectLoads, u: Array, h: float) -> list[tuple[NoiseInput, Array]]:
    """The loads of drivers with what they add to their inputs, (n,)."""
    assert isinstance(made.plant, ExtendedPlant)
    found: list[tuple[NoiseInput, Array]] = []
    seen = {s.name: u[:, k] for k, s in enumerate(made.plant.inputs)}
    for load, (e, _) in zip(made.loads, made.acts, strict=True):
        if e.site.kind == "input":
            after = e.effect.input(seen[e.site.name], e.values, h)
            found.append((load, after - seen[e.site.name]))
            seen[e.site.name] = after
    return found
