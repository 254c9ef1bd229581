r"""What is left of the unknown force once the named effects are in the model, and the periodic lines in it.

The named effects' forces, the input as the plant sees it, and what the sensors add to the outputs are known from the
simulation of the windows. With them as known inputs the model is linear again, and the smoother tells the force that
still lacks, with its standard deviation, sample by sample. Along the recorded motion a nonlinear plant with its effects
gives the rates

.. math:: A_e \begin{bmatrix} \bar x \\ z \end{bmatrix} + B u + E\,(f(\bar x, u) - A \bar x - B u) + \sum_j b_j F_j

with the effects' states z and forces :math:`F_j` as simulated (A and E with what effects have changed). What the
sensors tell beyond these is smoothed joint by joint.

A line that repeats with the position (a screw) or time (hum) may be too weak to name an effect, and be certain all the
same. For each wave number a cosine and sine are fitted to the force, with a phase of its own in each record and
direction of motion; the power explained is judged against the same under random signs of the blocks of time, and
against the largest level of all wave numbers. Smooth curves are taken off before, and found lines one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Indices
from robustlab.dynamics.extended.simulator import Simulator, Windows, rising
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import Port
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.hypotheses.disturbance_smoother import smooth_disturbance
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Problem
from robustlab.identification.hypotheses.motion_smoother import lacking_forces
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.naming.residual_force import (
    MovingSamples,
    ResidualForce,
    moving_samples,
    residual_force,
    role,
    without_curves,
)
from robustlab.statespace import StateSpaceModel

RESIDUAL_BLOCKS = 32  # of time, over all records
RESIDUAL_SAMPLES = 6000  # over all records; the force is smooth, so every so manieth sample tells it
LINE_ALARM = 0.01  # p-value of a line worth telling
MOST_LINES = 4
LINE_WORTH = 0.02  # of the mean square of the force: a weaker line is certain and of no use
FEWEST_TURNS = 8.0  # over the range of the position: fewer are a curve, which the splines have taken
TURNS_PER_BLOCK = 3.0  # of a line over time: slower ones cannot be told from drift between blocks
MOST_WAVES = 3000  # wave numbers tried over a coordinate
OVERSAMPLING = 2.0  # wave numbers tried per turn over the range
WAVES_AT_ONCE = 300  # bounds the memory
FINER_WAVES = 41  # of the last search, between the neighbours of the best one
CURVE_STIFFNESS = 1e-4  # of the smooth curves that are taken off first
FLIPS = 400  # random signs


@dataclass(frozen=True, eq=False)
class JointResiduals:
    """Forces left along one record at all joints."""

    ports: tuple[Port, ...]  # of the joints, in the order of the columns
    # force, std: (n, n_joints)
    force: Array
    std: Array
    x: Array  # the motion, (n, n_x)
    used: Indices  # samples of the record, (n,)


def joint_residuals(problem: Problem, fit: Fit, k: int, simulator: Simulator, least: float) -> JointResiduals | None:
    """Of one record of a nonlinear plant; None where its windows lie in pieces, or there is no joint.

    ``least``: lowest bandwidth of the forces in Hz.
    """
    plant, record = problem.plant, problem.records[k]
    assert isinstance(plant, NonlinearPlant)
    assert record.motion is not None
    windows = Windows(record.windows.starts, record.windows.length)
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    factors, values, shift = problem.setting(fit.hypothesis, fit.z)
    x0 = problem.starts_seen(k, simulator, values) + record.x0_std * fit.starts[k]
    motion = simulator.run(factors, values, x0, windows, shift)
    about, model = motion.about, motion.model
    assert about is not None
    names = [p.name for p in plant.port_places if p.kind == "joint"]
    if np.any(np.diff(used) != 1) or not names:
        return None
    n, own, n_u = len(used), model.own, len(plant.inputs)
    mean = simulator.seen_input(values, shift)[0][used]
    x = record.motion[used]
    middle = np.vstack([0.5 * (x[1:] + x[:-1]), x[-1:]])
    z = motion.states.reshape(n, -1)[:, own:]
    steps = len(about.steps) // n  # a sample
    rates, point = about.rates[::steps], about.points
    total = (model.A[point, :own] @ np.hstack([middle, z])[..., None])[..., 0]
    total += (model.B[point, :own] @ np.hstack([mean, rates])[..., None])[..., 0]
    # The force noted at a sample is that of the step before it; held over a sample it belongs one sample earlier.
    forces = motion.forces.reshape(n, -1)
    forces = np.vstack([forces[1:], forces[-1:]])
    for j, law in enumerate(simulator.laws(values)):
        total += model.ports[law.port].force[point, :own] * forces[:, j : j + 1]
    columns = list(record.columns)
    plain = simulator.plain_outputs(motion.states, about, model, mean.reshape(*motion.states.shape[:2], n_u))
    added = (motion.outputs - plain)[:, :, columns].reshape(n, -1)
    try:
        t = record.record.dt * np.arange(n)
        force, std = lacking_forces(plant, t, record.u[used], record.y[used] - added, columns, x, total, least)
    except NoTrustworthyNumber:
        return None
    return JointResiduals(tuple(model.ports[name] for name in names), force, std, x, used)


@dataclass(frozen=True, eq=False)
class LeftOver:
    """The residual force at the first joint (or the first input) with the named effects in the model."""

    # port, unit: the joint and the unit of the force
    port: str
    unit: str
    units: dict[str, str]
    # force, std, coordinates, blocks: samples over all records, (n,); coordinates by name; block label of each sample
    force: Array
    std: Array
    coordinates: dict[str, Array]
    blocks: NDArray[np.int_]

    def curves(self) -> ResidualForce:
        """The force over each coordinate."""
        return residual_force(self.force, self.std, self.coordinates, self.units, unit=self.unit, blocks=self.blocks)


def left_over(problem: Problem, fit: Fit, noise: NoiseModel) -> LeftOver | None:
    """The residual force over the given records; None where there is hardly any motion.

    The parameters stay as fitted; the starts of all windows are found anew.
    """
    everything = problem.on(problem.records)
    placed = everything.fit(fit.hypothesis, noise, fit.z, plan=FitPlan(8, 0.5, fixed=True))
    simulators = everything.simulators(fit.hypothesis)
    if isinstance(problem.plant, NonlinearPlant):
        parts = _at_worst_joint(everything, placed, simulators)
    else:
        parts = [_of_record(everything, placed, k, simulator) for k, simulator in enumerate(simulators)]
    known = [p for p in parts if p is not None]
    if not known:
        return None
    per_record = max(4, RESIDUAL_BLOCKS // len(known))
    step = max(1, sum(len(p[2]) for p in known) // RESIDUAL_SAMPLES)
    blocks = [k * per_record + np.arange(len(p[2])) * per_record // len(p[2]) for k, p in enumerate(known)]
    force = np.concatenate([p[2][::step] for p in known])
    std = np.concatenate([p[3][::step] for p in known])
    coordinates = {name: np.concatenate([p[4][name][::step] for p in known]) for name in known[0][4]}
    labels = np.concatenate([b[::step] for b in blocks])
    try:
        moving_samples(force, std, coordinates, labels)
    except InputError:  # hardly any motion
        return None
    port = known[0][0]
    return LeftOver(port, known[0][1], known[0][5], force, std, coordinates, labels)


_Part = tuple[str, str, Array, Array, dict[str, Array], dict[str, str]]


def _at_worst_joint(problem: Problem, fit: Fit, simulators: Sequence[Simulator]) -> list[_Part | None]:
    """What `_of_record` gives, of a nonlinear plant: at the joint where most is left, in standard deviations."""
    found = [joint_residuals(problem, fit, k, s, _least(problem, k)) for k, s in enumerate(simulators)]
    known = [f for f in found if f is not None]
    if not known:
        return []
    j = int(np.argmax(np.sum([np.mean((f.force / f.std) ** 2, axis=0) for f in known], axis=0)))
    parts: list[_Part | None] = []
    for k, f in enumerate(found):
        if f is None:
            parts.append(None)
            continue
        port, record, own = f.ports[j], problem.records[k], f.x.shape[1]
        coordinates = {"time": record.record.t[f.used], "speed": f.x @ port.velocity[:own]}
        units = {"time": "s", "speed": port.speed_unit}
        if port.position is not None:
            coordinates["position"], units["position"] = f.x @ port.position[:own], port.position_unit
        for i, signal in enumerate(problem.plant.inputs):
            coordinates[f"input {signal.name}"], units[f"input {signal.name}"] = record.u[f.used, i], signal.unit
        parts.append((port.name, port.unit, f.force[:, j], f.std[:, j], coordinates, units))
    return parts


def _least(problem: Problem, k: int) -> float:
    """Lowest bandwidth in Hz of the force in one record.

    The test turns the signs of whole blocks, which must not hang together by the smoother's own memory: where there is
    hardly any force the likelihood makes that longer than a block, and chance would look like structure.
    """
    windows, dt = problem.records[k].windows, problem.records[k].record.dt
    return max(4, RESIDUAL_BLOCKS // len(problem.records)) / (len(windows.starts) * windows.length * dt)


def _of_record(problem: Problem, fit: Fit, k: int, simulator: Simulator) -> _Part | None:
    """Port, unit, force, std, coordinates and their units along one record."""
    record = problem.records[k]
    factors, values, shift = problem.setting(fit.hypothesis, fit.z)
    model = simulator.model(factors, values)
    joint = next((p for p in model.ports.values() if p.kind == "joint"), None)
    # A plant without a joint: what it lacks is told as an addition to its first input.
    first = problem.plant.inputs[0]
    push, name, unit = (joint.force, joint.name, joint.unit) if joint else (model.B[:, 0], first.name, first.unit)
    windows = record.windows
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    x0 = problem.starts_seen(k, simulator, values) + record.x0_std * fit.starts[k]
    known, columns, added = _known_inputs(simulator, factors, values, record, x0, shift)
    y = record.y[used] - added
    seen = np.isfinite(y).any(axis=0)
    rows, y = np.array(record.columns)[seen], y[:, seen]
    d = model.D[rows]  # at the samples themselves, where the line begins
    linear = StateSpaceModel(
        model.A, np.hstack([model.B, rising(model.A, model.B, record.record.dt), columns]), model.C[rows],
        np.hstack([d, -d, np.zeros((len(rows), columns.shape[1]))]),
    )  # fmt: skip
    t = record.record.dt * np.arange(len(used))
    contiguous = np.all(np.diff(used) == 1)
    if not contiguous:
        return None
    least = _least(problem, k)
    try:
        smoothed = smooth_disturbance(linear, push[:, None], t, known, y)
        if smoothed.bandwidth[0] < least:
            smoothed = smooth_disturbance(linear, push[:, None], t, known, y, bandwidth=least)
    except NoTrustworthyNumber:
        return None
    x = smoothed.x
    units, coordinates = {"time": "s"}, {"time": record.record.t[used]}
    if joint is not None:
        coordinates["speed"] = x @ joint.velocity
        units["speed"] = joint.speed_unit
    else:
        for k_y in record.columns:
            signal = problem.plant.outputs[k_y]
            coordinates[f"output {signal.name}"] = x @ model.C[k_y]
            units[f"output {signal.name}"] = signal.unit
    if joint is not None and joint.position is not None:
        coordinates["position"] = x @ joint.position
        units["position"] = joint.position_unit
    for j, signal in enumerate(problem.plant.inputs):
        coordinates[f"input {signal.name}"] = record.u[used, j]
        units[f"input {signal.name}"] = signal.unit
    return name, unit, smoothed.d[:, 0], smoothed.d_std[:, 0], coordinates, units


def _known_inputs(
    simulator: Simulator,
    factors: Mapping[str, float],
    values: Sequence[Mapping[str, float]],
    record: PreparedRecord,
    x0: Array,
    shift: Sequence[float] | None,
) -> tuple[Array, Array, Array]:
    """Inputs of the linear model (n, 2 n_u + n_laws), columns of the laws' forces (n_x, n_laws), what sensors add."""
    windows = Windows(record.windows.starts, record.windows.length)
    motion = simulator.run(factors, values, x0, windows, shift)
    model = simulator.model(factors, values)
    laws = [law for (e, site), v in zip(simulator.effects, values, strict=True) for law in e.laws(site, v)]
    columns = np.zeros((len(model.A), len(laws)))
    for j, law in enumerate(laws):
        columns[:, j] = model.ports[law.port].force
    # The force noted at a sample is that of the step before it; held over a sample it belongs one sample earlier.
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    forces = motion.forces.reshape(len(used), len(laws))
    forces = np.vstack([forces[1:], forces[-1:]])
    mean, rise = (part[used] for part in simulator.seen_input(values, shift))
    plain = motion.states @ model.C.T
    if model.D.any():
        plain = plain + (mean - rise).reshape(len(windows.starts), windows.length, -1) @ model.D.T
    added = (motion.outputs - plain)[:, :, list(record.columns)].reshape(len(used), -1)
    return np.hstack([mean, rise, forces]), columns, added


Turns = NDArray[np.complex128]


def remaining_lines(left: LeftOver) -> tuple[dict[str, float | str], ...]:
    """Lines over position and time in the residual force that chance does not explain (p < 0.01), strongest first.

    Each has ``over`` ("position" or "time"), ``period`` in ``unit``, ``amplitude`` in ``force_unit`` (RMS over records
    and directions) and ``p_value``. Empty where there is none, or hardly any motion.
    """
    try:
        data = moving_samples(left.force, left.std, left.coordinates, left.blocks)
    except InputError as fault:
        if "blocks" in str(fault):  # too little motion: nothing to say
            return ()
        raise
    if (np.diff(data.block) < 0).any():
        raise InputError("remaining lines: blocks", "labels that go back", "contiguous blocks, one after the other")
    chance = np.random.default_rng(0).choice([-1.0, 1.0], size=(FLIPS, data.n_blocks))
    signs = np.vstack([np.ones(data.n_blocks), chance])
    data = replace(data, d=without_curves(data, CURVE_STIFFNESS))
    searches = list(_searches(data))
    least = LINE_WORTH * float(data.weight @ data.d**2)
    found: list[dict[str, float | str]] = []
    while len(found) < MOST_LINES:
        sure = [line for s in searches if (line := _strongest(data, s, signs, len(searches)))]
        if not sure:
            break
        power, p, place, at = max(sure, key=lambda line: line[0])
        if power < least:
            break
        wave = _refined(data, place, at)
        fitted, amplitude = _line(data, place, wave)
        data = replace(data, d=data.d - fitted)
        found.append(
            {
                "over": role(place.name),
                "period": float(1.0 / wave),
                "unit": left.units.get(place.name, ""),
                "amplitude": amplitude,
                "force_unit": left.unit,
                "p_value": p,
            }
        )
    return tuple(found)


@dataclass(frozen=True)
class _Search:
    """Wave numbers (turns per unit) that are tried over one coordinate; samples of one group share a phase."""

    name: str
    x: Array
    waves: Array
    group: NDArray[np.int_]

    @property
    def groups(self) -> list[int]:
        return np.unique(self.group).tolist()


def _records(data: MovingSamples) -> NDArray[np.int_]:
    """Record of each sample: a clock that goes back begins a new one."""
    time = next((x for name, x in data.x.items() if role(name) == "time"), None)
    if time is None:
        return np.zeros(len(data.d), dtype=int)
    return np.concatenate([[0], np.cumsum(np.diff(time) < 0)])


def _searches(data: MovingSamples) -> Iterator[_Search]:
    """Position and time, each with the wave numbers that its samples can show."""
    record = _records(data)
    for name, x in data.x.items():
        span = float(np.ptp(x))
        if role(name) not in ("position", "time") or not span > 0:
            continue
        step = np.abs(np.diff(x))
        longest, group = span / FEWEST_TURNS, record
        if role(name) == "time":
            length = float(np.median([np.ptp(x[data.block == b]) for b in range(data.n_blocks)]))
            longest = min(longest, length / TURNS_PER_BLOCK)
        else:
            group = 2 * record + (data.sign > 0)
        low, high = 1.0 / longest, 0.5 / float(np.median(step[step > 0]))
        count = min(MOST_WAVES, int((high - low) * span * OVERSAMPLING))
        if count >= 2:
            yield _Search(name, x, low + np.arange(count) / (span * OVERSAMPLING), group)


def _strongest(
    data: MovingSamples, place: _Search, signs: Array, searches: int
) -> tuple[float, float, _Search, int] | None:
    """Of the waves that chance does not explain the one with the most power: power, p, place, index."""
    power = _power(data, place, signs, WAVES_AT_ONCE)
    mean = power[1:].mean(axis=0)
    level = power / np.where(mean > 0, mean, 1.0)
    chance = np.sort(level[1:].max(axis=1))
    p = searches * (1 + len(chance) - np.searchsorted(chance, level[0])) / len(level)
    sure = np.flatnonzero(p < LINE_ALARM)
    if not len(sure):
        return None
    at = int(sure[power[0, sure].argmax()])
    return float(power[0, at]), float(p[at]), place, at


def _power(data: MovingSamples, place: _Search, signs: Array, chunk: int) -> Array:
    """Explained power of every wave number for every set of signs, (n_signs, n_waves)."""
    parts = []
    tables = _tables(place, place.waves[:chunk])  # the wave numbers are evenly spaced: each chunk only turns on
    for first in range(0, len(place.waves), chunk):
        waves = place.waves[first : first + chunk]
        power = np.zeros((len(signs), len(waves)))
        for moment, inverse in _normal_equations(data, place, waves, tables):
            root = np.einsum("bwp,wpq->qbw", moment, np.linalg.cholesky(inverse))
            power += (signs @ root[0]) ** 2 + (signs @ root[1]) ** 2
        parts.append(power)
    return np.hstack(parts)


def _tables(place: _Search, waves: Array) -> list[tuple[Turns, Turns]]:
    """For each group the phase factors of the waves over that of the first, (n_samples, n_waves), and their squares."""
    x = place.x - place.x.min()
    factors = [np.exp(2j * np.pi * np.outer(x[place.group == g], waves - waves[0])) for g in place.groups]
    return [(factor, factor * factor) for factor in factors]


def _normal_equations(
    data: MovingSamples, place: _Search, waves: Array, tables: Sequence[tuple[Turns, Turns]] | None = None
) -> Iterator[tuple[Array, Array]]:
    """For each group the sums over each block of (cos, sin) times the force, and the inverse sums of their products.

    Shapes (n_blocks, n_waves, 2) and (n_waves, 2, 2). ``tables`` are those of as many or more wave numbers with the
    same steps.
    """
    for g, (table, square) in zip(place.groups, tables or _tables(place, waves), strict=True):
        own = np.flatnonzero(place.group == g)
        first = np.exp(2j * np.pi * waves[0] * (place.x[own] - place.x.min()))
        weight = data.weight[own]
        force = weight * data.d[own] * first
        edges = np.searchsorted(data.block[own], np.arange(data.n_blocks + 1))  # blocks follow each other
        moment = np.stack([force[a:b] @ table[a:b, : len(waves)] for a, b in pairwise(edges)])
        # cos^2 and cos sin by the double angle
        double, total = (weight * first * first) @ square[:, : len(waves)], float(weight.sum())
        cc, cs = 0.5 * (total + np.real(double)), 0.5 * np.imag(double)
        gram = np.stack([np.stack([cc, cs], axis=1), np.stack([cs, total - cc], axis=1)], axis=2)
        # The ridge keeps it regular where the samples happen to miss one of the two phases.
        inverse = np.asarray(np.linalg.inv(gram + 1e-6 * total * np.eye(2)), dtype=np.float64)
        yield np.stack([np.real(moment), np.imag(moment)], axis=2), inverse


def _refined(data: MovingSamples, place: _Search, at: int) -> float:
    """Wave number of the most power between the neighbours of the best one of the grid."""
    step = 1.0 / (float(np.ptp(place.x)) * OVERSAMPLING)
    waves = place.waves[at] + step * np.linspace(-1.0, 1.0, FINER_WAVES)
    power = np.zeros(FINER_WAVES)
    for moment, inverse in _normal_equations(data, place, waves):
        whole = moment.sum(axis=0)
        power += np.einsum("wp,wpq,wq->w", whole, inverse, whole)
    return float(waves[power.argmax()])


def _line(data: MovingSamples, place: _Search, wave: float) -> tuple[Array, float]:
    """The fitted line along the samples, and its amplitude: RMS over the samples of each group's own."""
    phase = 2.0 * np.pi * wave * (place.x - place.x.min())
    columns = np.column_stack([np.cos(phase), np.sin(phase)])
    fitted, square = np.empty(len(phase)), 0.0
    equations = _normal_equations(data, place, np.array([wave]))
    for g, (moment, inverse) in zip(place.groups, equations, strict=True):
        own = place.group == g
        ab = inverse[0] @ moment[:, 0].sum(axis=0)
        fitted[own] = columns[own] @ ab
        square += float(ab @ ab) * float(np.mean(own))
    return fitted, float(np.sqrt(square))
