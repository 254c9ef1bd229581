"""Residual force of a model with its named effects: curves over speed, position, time and input, and periodic lines.

With the effects' simulated forces as known inputs the model is linear, and the smoother estimates the residual force;
that of a nonlinear plant is smoothed joint by joint, given the rates of plant and effects along its motion. The force
is correlated in time: bands come from a bootstrap over blocks, shares of the variance from blocks not fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Indices
from robustlab.dynamics.extended.simulator import Simulator, rising
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import Port
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.greybox.disturbance_smoother import smooth_disturbance
from robustlab.identification.greybox.effect_fit import Fit, FitPlan, NoiseModel, Problem
from robustlab.identification.greybox.motion_smoother import lacking_forces
from robustlab.identification.greybox.prepared_record import PreparedRecord
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel

RESIDUAL_BLOCKS = 32  # of time, over all records
RESIDUAL_SAMPLES = 6000  # over all records: the force is smooth
FEWEST_BLOCKS = 8
POINTS = 4000  # samples used: the force is smooth
REST = 0.01  # of the largest speed: slower counts as rest, where dry friction balances any force
FOLDS = 8  # of cross-validation
STIFFNESS = 10.0 ** np.arange(-5.0, 3.0)  # penalty over the weight of the data
RIDGE = 1e-7
SIDE, WIDE, SLOW = 8, 14, 2  # spline coefficients on a side of zero speed and over other coordinates; degree over time
BINS = 24
REPEATS = 400  # of the bootstrap

LINE_ALARM = 0.01  # largest p-value of a reported line
MOST_LINES = 4
LINE_WORTH = 0.02  # of the mean square of the force: weaker lines are not reported
FEWEST_TURNS = 8.0  # over the range of the position: fewer are part of the smooth curve
TURNS_PER_BLOCK = 3.0  # of a line over time: slower ones are indistinguishable from drift between blocks
MOST_WAVES = 3000  # wave numbers over a coordinate
OVERSAMPLING = 2.0  # wave numbers per turn over the range
WAVES_AT_ONCE = 300  # limits the memory
FINER_WAVES = 41  # of the final search between the neighbours of the best one
CURVE_STIFFNESS = 1e-4  # of the smooth curves that are subtracted first
FLIPS = 400  # random signs


@dataclass(frozen=True)
class ForceCurve(Evidence):
    """Residual force over one coordinate."""

    coordinate: str
    unit: str
    # x, value, low, high: middle of each bin, mean force in it, and its 95 % band, (n_bins,), in order of x
    x: Array
    value: Array
    low: Array
    high: Array
    count: NDArray[np.int_]  # samples in each bin
    share: float  # of the variance explained by a curve over this coordinate in blocks not fitted, 0..1


@dataclass(frozen=True)
class ResidualForce(Evidence):
    """The residual force over each coordinate."""

    unit: str  # of the force
    rms: float
    noise_share: float  # of its variance, by the estimate's own std
    curves: Mapping[str, ForceCurve]  # coordinate -> curve
    blocks: int  # number of blocks


@dataclass(frozen=True, eq=False)
class MovingSamples:
    """Samples in motion: force (n,), weights (n,), coordinates, block of each sample, sign of the speed."""

    d: Array
    std: Array
    weight: Array
    x: dict[str, Array]
    block: NDArray[np.int_]
    n_blocks: int
    speed: str | None
    sign: Array

    def per_block(self, value: Array) -> Array:
        """Return weighted sums over each block: (n, ...) -> (n_blocks, ...)."""
        belongs = (np.arange(self.n_blocks)[:, None] == self.block) * self.weight
        return (belongs @ value.reshape(len(value), -1)).reshape(self.n_blocks, *value.shape[1:])


def moving_samples(force: Array, std: Array, x: Mapping[str, Array], label: NDArray[np.int_]) -> MovingSamples | None:
    """Select the samples in motion of a force (n,) with the block label of each; None if too few."""
    speed = next((name for name in x if role(name) == "speed"), None)
    chosen = np.arange(0, len(force), max(1, len(force) // POINTS))
    if speed is not None:
        moving = np.abs(x[speed]) > REST * np.abs(x[speed]).max()
        if moving[chosen].sum() >= 0.2 * len(chosen):
            chosen = chosen[moving[chosen]]
    _, block = np.unique(label[chosen], return_inverse=True)
    count = int(block.max()) + 1
    if count < FEWEST_BLOCKS:
        return None
    floor = float(np.median(std[chosen]))
    weight = 1.0 / np.maximum(std[chosen], floor) ** 2 * floor**2
    sign = np.sign(x[speed][chosen]) if speed else np.ones(len(chosen))
    return MovingSamples(
        force[chosen], std[chosen], weight, {k: v[chosen] for k, v in x.items()}, block, count, speed, sign
    )


def role(name: str) -> str:
    """Return the first word of a coordinate's name: "speed", "position", "time" or another."""
    return name.split(maxsplit=1)[0].lower() if name.split() else ""


# --- along the records -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LeftOver:
    """Residual force at one joint (or the first input), its unit, and those of the coordinates."""

    port: str
    unit: str
    units: Mapping[str, str]
    samples: MovingSamples


class _Part(NamedTuple):
    """Residual force along one record."""

    port: str
    unit: str
    force: Array
    std: Array
    coordinates: dict[str, Array]
    units: dict[str, str]


def left_over(problem: Problem, fit: Fit, noise: NoiseModel) -> LeftOver | None:
    """Return the residual force over all records of the problem; None with too little motion."""
    everything = problem.on(problem.records)
    placed = everything.fit(fit.hypothesis, noise, fit.z, plan=FitPlan(8, 0.5, fixed=True))
    simulators = everything.simulators(fit.hypothesis)
    if isinstance(problem.plant, NonlinearPlant):
        parts = _at_worst_joint(everything, placed, simulators)
    else:
        parts = [p for k, s in enumerate(simulators) if (p := _of_record(everything, placed, k, s)) is not None]
    if not parts:
        return None
    per_record = max(4, RESIDUAL_BLOCKS // len(parts))
    step = max(1, sum(len(p.force) for p in parts) // RESIDUAL_SAMPLES)
    blocks = [k * per_record + np.arange(len(p.force)) * per_record // len(p.force) for k, p in enumerate(parts)]
    samples = moving_samples(
        np.concatenate([p.force[::step] for p in parts]),
        np.concatenate([p.std[::step] for p in parts]),
        {name: np.concatenate([p.coordinates[name][::step] for p in parts]) for name in parts[0].coordinates},
        np.concatenate([b[::step] for b in blocks]),
    )
    return samples and LeftOver(parts[0].port, parts[0].unit, parts[0].units, samples)


def _coordinates(
    problem: Problem, record: PreparedRecord, used: Indices, x: Array, port: Port | None
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return time, speed and position of a joint, and the inputs, with their units."""
    found, units = {"time": record.record.t[used]}, {"time": "s"}
    if port is not None:
        found["speed"], units["speed"] = x @ port.velocity[: x.shape[1]], port.speed_unit
        if port.position is not None:
            found["position"], units["position"] = x @ port.position[: x.shape[1]], port.position_unit
    for j, signal in enumerate(problem.plant.inputs):
        found[f"input {signal.name}"], units[f"input {signal.name}"] = record.u[used, j], signal.unit
    return found, units


def _at_joints(
    problem: Problem, fit: Fit, k: int, simulator: Simulator
) -> tuple[list[Port], Array, Array, Array, Indices] | None:
    """Return joints, forces (n, n_joints), deviations, motion and samples of a nonlinear plant's unbroken record."""
    plant, record = problem.plant, problem.records[k]
    assert isinstance(plant, NonlinearPlant)
    assert record.motion is not None
    windows = record.windows
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
    # The force stored at a sample is that of the step before it: held over a sample, it belongs one sample earlier.
    forces = motion.forces.reshape(n, -1)
    forces = np.vstack([forces[1:], forces[-1:]])
    for j, law in enumerate(simulator.laws(values)):
        total += model.ports[law.port].force[point, :own] * forces[:, j : j + 1]
    columns = list(record.columns)
    plain = simulator.plain_outputs(motion.states, about, model, mean.reshape(*motion.states.shape[:2], n_u))
    added = (motion.outputs - plain)[:, :, columns].reshape(n, -1)
    try:
        t = record.record.dt * np.arange(n)
        force, std = lacking_forces(
            plant, t, record.u[used], record.y[used] - added, columns, x, total, _least(problem, k)
        )
    except NoTrustworthyNumber:
        return None
    return [model.ports[name] for name in names], force, std, x, used


def _at_worst_joint(problem: Problem, fit: Fit, simulators: Sequence[Simulator]) -> list[_Part]:
    """Return the residual of a nonlinear plant at its worst joint, in standard deviations."""
    found = [(problem.records[k], _at_joints(problem, fit, k, s)) for k, s in enumerate(simulators)]
    known = [(record, *part) for record, part in found if part is not None]
    if not known:
        return []
    j = int(np.argmax(np.sum([np.mean((force / std) ** 2, axis=0) for _, _, force, std, _, _ in known], axis=0)))
    return [
        _Part(ports[j].name, ports[j].unit, force[:, j], std[:, j], *_coordinates(problem, record, used, x, ports[j]))
        for record, ports, force, std, x, used in known
    ]


def _least(problem: Problem, k: int) -> float:
    """Return the lowest bandwidth in Hz of the force in one record."""
    # The test flips the signs of whole blocks: a smoother with a longer memory would make noise look like structure.
    windows, dt = problem.records[k].windows, problem.records[k].record.dt
    return max(4, RESIDUAL_BLOCKS // len(problem.records)) / (len(windows.starts) * windows.length * dt)


def _of_record(problem: Problem, fit: Fit, k: int, simulator: Simulator) -> _Part | None:
    """Estimate the residual force of a linear plant along one record; None in pieces or without an estimate."""
    record = problem.records[k]
    factors, values, shift = problem.setting(fit.hypothesis, fit.z)
    model = simulator.model(factors, values)
    joint = next((p for p in model.ports.values() if p.kind == "joint"), None)
    # Without a joint the residual force is an addition to the first input.
    first = problem.plant.inputs[0]
    push, name, unit = (joint.force, joint.name, joint.unit) if joint else (model.B[:, 0], first.name, first.unit)
    windows = record.windows
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    x0 = problem.starts_seen(k, simulator, values) + record.x0_std * fit.starts[k]
    known, columns, added = _known_inputs(simulator, factors, values, record, x0, shift)
    y = record.y[used] - added
    seen = np.isfinite(y).any(axis=0)
    rows, y = np.array(record.columns)[seen], y[:, seen]
    d = model.D[rows]  # acts on the input at the sample itself
    linear = StateSpaceModel(
        model.A, np.hstack([model.B, rising(model.A, model.B, record.record.dt), columns]), model.C[rows],
        np.hstack([d, -d, np.zeros((len(rows), columns.shape[1]))]),
    )  # fmt: skip
    t = record.record.dt * np.arange(len(used))
    if np.any(np.diff(used) != 1):
        return None
    least = _least(problem, k)
    try:
        smoothed = smooth_disturbance(linear, push[:, None], t, known, y)
        if smoothed.bandwidth[0] < least:
            smoothed = smooth_disturbance(linear, push[:, None], t, known, y, bandwidth=least)
    except NoTrustworthyNumber:
        return None
    coordinates, units = _coordinates(problem, record, used, smoothed.x, joint)
    if joint is None:
        for k_y in record.columns:
            signal = problem.plant.outputs[k_y]
            coordinates[f"output {signal.name}"] = smoothed.x @ model.C[k_y]
            units[f"output {signal.name}"] = signal.unit
    return _Part(name, unit, smoothed.d[:, 0], smoothed.d_std[:, 0], coordinates, units)


def _known_inputs(
    simulator: Simulator,
    factors: Mapping[str, float],
    values: Sequence[Mapping[str, float]],
    record: PreparedRecord,
    x0: Array,
    shift: Sequence[float] | None,
) -> tuple[Array, Array, Array]:
    """Return inputs of the linear model (n, 2 n_u + n_laws), force columns (n_x, n_laws), additions of the sensors."""
    windows = record.windows
    motion = simulator.run(factors, values, x0, windows, shift)
    model = simulator.model(factors, values)
    laws = [law for (e, site), v in zip(simulator.effects, values, strict=True) for law in e.laws(site, v)]
    columns = np.zeros((len(model.A), len(laws)))
    for j, law in enumerate(laws):
        columns[:, j] = model.ports[law.port].force
    # The force stored at a sample is that of the step before it: held over a sample, it belongs one sample earlier.
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    forces = motion.forces.reshape(len(used), len(laws))
    forces = np.vstack([forces[1:], forces[-1:]])
    mean, rise = (part[used] for part in simulator.seen_input(values, shift))
    plain = motion.states @ model.C.T
    if model.D.any():
        plain = plain + (mean - rise).reshape(len(windows.starts), windows.length, -1) @ model.D.T
    added = (motion.outputs - plain)[:, :, list(record.columns)].reshape(len(used), -1)
    return np.hstack([mean, rise, forces]), columns, added


# --- curves ----------------------------------------------------------------------------------------------------------


def residual_curves(left: LeftOver, seed: int = 0) -> ResidualForce:
    """Return the force over each coordinate, with bands and held-out shares."""
    data, rng = left.samples, np.random.default_rng(seed)
    force = data.d - np.average(data.d, weights=data.weight)
    curves: dict[str, ForceCurve] = {}
    for name, (columns, penalty) in _bases(data).items():
        x, value, low, high, count = _binned(data, data.x[name], role(name) == "speed", rng)
        share = _held_out_share(data, force, columns, penalty)
        curves[name] = ForceCurve(name, left.units.get(name, ""), x, value, low, high, count, share)
    variance = float(np.average(force**2, weights=data.weight))
    noise = min(1.0, float(np.average(data.std**2, weights=data.weight)) / variance) if variance > 0 else 1.0
    return ResidualForce(left.unit, float(np.sqrt(np.mean(data.d**2))), noise, curves, data.n_blocks)


def _bases(data: MovingSamples) -> dict[str, tuple[Array, Array]]:
    """Return for each varying coordinate the columns (n, p) of a curve, and their roughness penalty (p, p)."""
    return {name: _basis(name, x) for name, x in data.x.items() if np.ptp(x) > 0}


def _basis(name: str, x: Array) -> tuple[Array, Array]:
    low, high = float(x.min()), float(x.max())
    if role(name) == "speed":  # over sqrt|v|, one set below zero and one above: the curve may jump at zero
        side = _spline(np.sqrt(np.abs(x) / (float(np.abs(x).max()) or 1.0)), 0.0, 1.0, SIDE)
        columns = np.hstack([side * (x < 0)[:, None], side * (x > 0)[:, None]])
        return columns, np.asarray(np.kron(np.eye(2), _roughness(SIDE)))
    if role(name) == "time":  # a low-degree polynomial extrapolates well to held-out blocks at the ends
        columns = np.vander((x - low) / ((high - low) or 1.0) - 0.5, SLOW + 1, increasing=True)
        return columns, np.diag([0.0, *[1.0] * SLOW])
    return _spline(x, low, high, WIDE), _roughness(WIDE)


def _spline(x: Array, low: float, high: float, size: int) -> Array:
    """Return cubic B-splines on an even grid from low to high, (n, size); constant outside."""
    from scipy.interpolate import BSpline

    inner = np.linspace(low, high, size - 2)
    step = inner[1] - inner[0]
    knots = np.concatenate([low - step * np.arange(3, 0, -1), inner, high + step * np.arange(1, 4)])
    return np.asarray(BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray())


def _roughness(size: int) -> Array:
    second = np.diff(np.eye(size), 2, axis=0)
    return np.asarray(second.T @ second, dtype=np.float64)


def _without_curves(data: MovingSamples) -> Array:
    """Subtract from the force smooth curves f(x) and sgn(v) f(x) over all coordinates."""
    from scipy.linalg import block_diag

    bases = []
    for name, (columns, penalty) in _bases(data).items():
        bases.append((columns, penalty))
        if data.speed and role(name) != "speed":
            bases.append((columns * data.sign[:, None], penalty))
    if not bases:
        return data.d - np.average(data.d, weights=data.weight)
    columns, penalty = np.hstack([c for c, _ in bases]), np.asarray(block_diag(*(p for _, p in bases)))
    weighted = columns.T * data.weight
    gram = weighted @ columns
    return data.d - columns @ _solved(gram, weighted @ data.d, CURVE_STIFFNESS, penalty, gram)


def _solved(gram: Array, moment: Array, stiffness: float, penalty: Array, whole: Array) -> Array:
    """Return coefficients of a ridge regression whose stiffness is independent of units, length and columns."""
    size = float(np.trace(whole)) / len(whole)
    return np.linalg.solve(gram + size * (stiffness * penalty + RIDGE * np.eye(len(whole))), moment)


def _held_out_share(data: MovingSamples, force: Array, columns: Array, penalty: Array) -> float:
    """Return the share of the variance that a curve explains in held-out runs of blocks, at the best stiffness."""
    folds = data.block * min(FOLDS, data.n_blocks) // data.n_blocks
    parts = [(columns[folds == k], data.weight[folds == k], force[folds == k]) for k in np.unique(folds)]
    grams = [(c.T * w) @ c for c, w, _ in parts]
    moments = [(c.T * w) @ f for c, w, f in parts]
    gram, moment = np.sum(grams, axis=0), np.sum(moments, axis=0)
    total = float(data.weight @ force**2) or 1.0
    left = [
        sum(float(w @ (f - c @ _solved(gram - g, moment - m, s, penalty, gram)) ** 2)
            for (c, w, f), g, m in zip(parts, grams, moments, strict=True))
        for s in STIFFNESS
    ]  # fmt: skip
    return max(0.0, 1.0 - min(left) / total)


def _binned(
    data: MovingSamples, x: Array, split: bool, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array, NDArray[np.int_]]:
    """Return means of the force in bins of x with equal counts, and bands from a bootstrap over blocks."""
    if split:
        sides = [side for side in (x[x < 0], x[x > 0]) if len(side)]
        edges = np.unique(np.concatenate([_quantiles(s, max(2, round(BINS * len(s) / len(x)))) for s in sides]))
    else:
        edges = _quantiles(x, BINS)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    used, place = np.unique(place, return_inverse=True)
    n = len(used)
    one = np.zeros((len(x), n))
    one[np.arange(len(x)), place] = 1.0
    weight, force = data.per_block(one), data.per_block(one * data.d[:, None])
    at, count = data.per_block(one * x[:, None]).sum(0) / weight.sum(0), one.sum(0).astype(int)
    value = force.sum(0) / weight.sum(0)
    times = rng.multinomial(data.n_blocks, np.full(data.n_blocks, 1.0 / data.n_blocks), size=REPEATS)
    total = times @ weight
    drawn = np.where(total > 0, (times @ force) / np.where(total > 0, total, 1.0), np.nan)
    spread = np.sqrt(np.nanmean((drawn - value) ** 2, axis=0))
    # In a bin with few blocks the spread between blocks is unreliable: the spread within the bin counts as well.
    visits = (weight > 0).sum(axis=0)
    inside = np.sqrt(np.maximum((one * (data.d[:, None] - value) ** 2).sum(0) / np.maximum(count, 1), 0.0))
    own = np.sqrt((one * data.std[:, None] ** 2).sum(0) / np.maximum(count, 1))
    spread = np.maximum(spread * np.sqrt(visits / np.maximum(visits - 1, 1)), own / np.sqrt(visits))
    band = 2.0 * np.where(visits < 4, np.maximum(spread, inside), spread)
    return at, value, value - band, value + band, count


def _quantiles(x: Array, n: int) -> Array:
    return np.unique(np.quantile(x, np.linspace(0.0, 1.0, n + 1)))


# --- lines -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Place:
    """Wave numbers (turns per unit) over one coordinate; samples of one group share a phase."""

    name: str
    x: Array
    waves: Array
    group: NDArray[np.int_]


def remaining_lines(left: LeftOver) -> tuple[dict[str, float | str], ...]:
    """Return significant lines (p < 0.01) over position and time in the residual force, strongest first."""
    # Each wave number's power, with a phase for each record and direction, is compared with the largest one under
    # random signs of the blocks. Smooth curves are subtracted before, and lines one by one.
    data = left.samples
    chance = np.random.default_rng(0).choice([-1.0, 1.0], size=(FLIPS, data.n_blocks))
    signs = np.vstack([np.ones(data.n_blocks), chance])
    data = replace(data, d=_without_curves(data))
    places = list(_places(data))
    least = LINE_WORTH * float(data.weight @ data.d**2)
    found: list[dict[str, float | str]] = []
    while len(found) < MOST_LINES:
        sure = [best for p in places if (best := _strongest(data, p, signs, len(places)))]
        if not sure:
            break
        power, p, place, at = max(sure, key=lambda best: best[0])
        if power < least:
            break
        step = 1.0 / (float(np.ptp(place.x)) * OVERSAMPLING)
        finer = place.waves[at] + step * np.linspace(-1.0, 1.0, FINER_WAVES)
        wave = float(finer[_power(data, replace(place, waves=finer), signs[:1])[0].argmax()])
        fitted, amplitude = _line(data, place, wave)
        data = replace(data, d=data.d - fitted)
        line: dict[str, float | str] = {"over": role(place.name), "period": 1.0 / wave, "amplitude": amplitude}
        found.append({**line, "unit": left.units.get(place.name, ""), "force_unit": left.unit, "p_value": p})
    return tuple(found)


def _places(data: MovingSamples) -> Iterator[_Place]:
    """Yield position and time, each with the wave numbers that its samples resolve."""
    time = next((x for name, x in data.x.items() if role(name) == "time"), np.zeros(len(data.d)))
    record = np.concatenate([[0], np.cumsum(np.diff(time) < 0)])  # time restarts with each record
    for name, x in data.x.items():
        span = float(np.ptp(x))
        if role(name) not in ("position", "time") or not span > 0:
            continue
        step = np.abs(np.diff(x))
        longest, group = span / FEWEST_TURNS, 2 * record + (data.sign > 0)
        if role(name) == "time":
            length = float(np.median([np.ptp(x[data.block == b]) for b in range(data.n_blocks)]))
            longest, group = min(longest, length / TURNS_PER_BLOCK), record
        low, high = 1.0 / longest, 0.5 / float(np.median(step[step > 0]))
        count = min(MOST_WAVES, int((high - low) * span * OVERSAMPLING))
        if count >= 2:
            yield _Place(name, x, low + np.arange(count) / (span * OVERSAMPLING), group)


def _strongest(
    data: MovingSamples, place: _Place, signs: Array, places: int
) -> tuple[float, float, _Place, int] | None:
    """Return power, p, place and index of the strongest significant wave, or None."""
    power = _power(data, place, signs)
    mean = power[1:].mean(axis=0)
    level = power / np.where(mean > 0, mean, 1.0)
    chance = np.sort(level[1:].max(axis=1))
    p = places * (1 + len(chance) - np.searchsorted(chance, level[0])) / len(level)
    sure = np.flatnonzero(p < LINE_ALARM)
    if not len(sure):
        return None
    at = int(sure[power[0, sure].argmax()])
    return float(power[0, at]), float(p[at]), place, at


def _power(data: MovingSamples, place: _Place, signs: Array) -> Array:
    """Return the explained power of every wave number under every set of the blocks' signs, (n_signs, n_waves)."""
    power, waves = np.zeros((len(signs), len(place.waves))), place.waves
    for g in np.unique(place.group):
        own = place.group == g
        x, weight = place.x[own] - place.x.min(), data.weight[own]
        by_block = (np.arange(data.n_blocks)[:, None] == data.block[own]) * (weight * data.d[own])
        # The wave numbers are evenly spaced: the table serves every chunk.
        table = np.exp(2j * np.pi * np.outer(x, waves[:WAVES_AT_ONCE] - waves[0]))
        for first in range(0, len(waves), WAVES_AT_ONCE):
            chunk = slice(first, first + WAVES_AT_ONCE)
            turned = np.exp(2j * np.pi * waves[first] * x)[:, None] * table[:, : len(waves[chunk])]
            double, total = weight @ turned**2, float(weight.sum())
            # Rotated so that cosine and sine are orthogonal (Lomb); the ridge is for samples that miss one of them.
            sums = (by_block @ turned) * np.exp(-0.5j * np.angle(double))
            for part, side in ((sums.real, 1.0), (sums.imag, -1.0)):
                norm = 0.5 * (total + side * np.abs(double)) + 1e-6 * total
                power[:, chunk] += (signs @ part) ** 2 / norm
    return power


def _line(data: MovingSamples, place: _Place, wave: float) -> tuple[Array, float]:
    """Return the fitted line along the samples, and its amplitude: RMS over the samples of the groups' amplitudes."""
    phase = 2.0 * np.pi * wave * (place.x - place.x.min())
    columns, root = np.column_stack([np.cos(phase), np.sin(phase)]), np.sqrt(data.weight)
    fitted, square = np.empty(len(phase)), 0.0
    for g in np.unique(place.group):
        own = place.group == g
        ab = np.linalg.lstsq(columns[own] * root[own, None], data.d[own] * root[own], rcond=1e-6)[0]
        fitted[own] = columns[own] @ ab
        square += float(ab @ ab) * float(np.mean(own))
    return fitted, float(np.sqrt(square))
