r"""What to do next with a platform under control: the path of its pose on which the open hypotheses are furthest apart.

For every path of a menu and each open hypothesis A the machine is simulated with A under a stated controller of each
nut, about the path's first pose,

.. math:: u_j = u_{j0} + k_j\,(r_j - q_j) + d_j\,(\dot r_j - \dot q_j)_f + c_j\, \dot r_{jf}, \qquad
          k_j = \omega^2 / b_j, \quad d_j = 2 \zeta \omega / b_j, \quad c_j = a_j / b_j

with b and a the accelerations of a nut per unit of its input and of its own speed; f: a filtered difference. A predicts
the outputs of the record in windows, B is refitted to them, and d is that of `propose_experiment`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.control.controlled_plant import ControlledNonlinearPlant, controlled_nonlinear
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import ExtendedNonlinearPlant, with_effects
from robustlab.dynamics.linearisation import trim
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification import tuning
from robustlab.identification.experiment.experiment_bench import SAFE, Pair, distances
from robustlab.identification.experiment.next_experiment import NextExperiment, Tried, labels_of
from robustlab.identification.experiment.path_menu import PathLimits, PosePath, paths
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, NoiseModel, Problem, predicted
from robustlab.identification.hypotheses.prepared_record import ports_of, prepare
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel

NATURAL, DAMPING, FILTER = 40.0, 0.7, 500.0  # of the stated controller: rad/s, share, rad/s
ROUNDS = 8  # in which an input is found that an effect turns into the one that the motion needs
ITERATIONS = 6  # of a refit
FINALISTS = 3  # paths whose distance is found with either hypothesis as the truth
SMALLER = 0.95  # of a path whose inputs were too large: the share of the limit that it is scaled to
POSE = (("tx", "m"), ("ty", "m"), ("tz", "m"), ("ax", "rad"), ("ay", "rad"), ("az", "rad"))


@dataclass(frozen=True, eq=False)
class _Rated:
    """A path, the largest input that it takes under any hypothesis, and the distances of the pairs."""

    path: PosePath
    largest: float
    pairs: tuple[Pair, ...]

    @property
    def separation(self) -> float:
        return min(p.separation for p in self.pairs)


def propose_path(
    problem: Problem,
    named: Fit,
    rivals: Sequence[Fit],
    *,
    only: Sequence[str] = (),
    duration: float | None = None,
    input_range: float | None = None,
) -> NextExperiment | None:
    """The path of the menu on which the named hypothesis and its rivals are furthest apart.

    ``problem``: the records and the platform that the fits belong to. ``rivals``: of these the most probable is looked
    at, where it is not the named one. ``only``: names of the menu; all where left out. ``duration``: in s, as long as
    the longest record where left out. ``input_range``: largest input; the largest of the records where left out, as are
    the largest speed and the range of each angle.

    Returns None without a rival, for a plant that is no Stewart platform, and where no path can be followed. Its
    ``inputs`` are the references of the nut angles, ``phi_1_ref`` and so on, and the poses that they belong to.
    """
    plant = problem.plant
    others = sorted((r for r in rivals if r.hypothesis.key != named.hypothesis.key), key=lambda f: -f.evidence)
    if not others or not isinstance(plant, StewartPlatform):
        return None
    fits = (named, others[0])
    first = problem.records[0].record
    n = max(r.record.n for r in problem.records) if duration is None else round(duration / first.dt)
    about, limits, top = _limits(problem, input_range)
    found = paths(plant.geometry, about, limits, n, first.dt, _legs(fits))
    unknown = set(only) - {path.name for path in found}
    if unknown:
        raise InputError("propose_path: only", f"no {sorted(unknown)[0]!r}", ", ".join(p.name for p in found))
    labels = labels_of(fits)
    rated = [r for p in found if not only or p.name in only for r in _rated(problem, fits, labels, p, top)]
    if not rated:
        return None
    rated = sorted(rated, key=lambda r: -r.separation)
    rated[:FINALISTS] = [_both_ways(problem, fits, labels, r) for r in rated[:FINALISTS]]
    best = max(rated[:FINALISTS], key=lambda r: r.separation)
    rated = [best, *(r for r in rated if r is not best)]
    now = min(p.separation for p in distances(problem, fits, labels))
    return _proposal(problem, rated, labels, now, top)


def _legs(fits: Sequence[Fit]) -> list[int]:
    """Legs (0..5) at which hypotheses differ: the last figure of a place such as ``phidot_3``."""
    keys = [{c.key for c in f.hypothesis.candidates} for f in fits]
    open_sites = {c.site.name for f in fits for c in f.hypothesis.candidates if c.key not in set.intersection(*keys)}
    return sorted({int(site[-1]) - 1 for site in open_sites if site[-1] in "123456"})


# --- limits ----------------------------------------------------------------------------------------------------------


def _limits(problem: Problem, input_range: float | None) -> tuple[Array, PathLimits, float]:
    """Pose about which a path goes, limits of the joints, and the largest input."""
    plant: Any = problem.plant
    x = np.concatenate([r.smoothed.x for r in problem.records])
    angles, speeds = x[:, :6], x[:, 6:12]
    low, high = angles.min(axis=0), angles.max(axis=0)
    about = plant.poses(0.5 * (low + high)[None])[0]
    used = max(float(np.abs(r.u).max()) for r in problem.records)
    top = used if input_range is None else float(input_range)
    hold = trim(plant, pose=about).u
    acceleration = _authority(plant, about)[0] * np.maximum(top - np.abs(hold), 0.0)
    reach = np.column_stack([low, high])
    return about, PathLimits(np.abs(speeds).max(axis=0), acceleration, reach), top


def _authority(plant: Any, pose: Array) -> tuple[Array, Array]:
    """Acceleration of each nut per unit of its own input, and less per unit of its own speed, (6,) each; currents
    settled.
    """
    point = trim(plant, pose=pose)
    A, B, _, _ = plant.jacobians(point.x, point.u)
    rates, own = B[6:12], A[6:12, 6:12]
    if len(A) > 12:  # the currents follow voltages and speeds at once
        settled = A[6:12, 12:] @ np.linalg.inv(A[12:, 12:])
        rates, own = rates - settled @ B[12:], own - settled @ A[12:, 6:12]
    return np.diag(rates).copy(), -np.diag(own).copy()


# --- the machine under control ---------------------------------------------------------------------------------------


def _rated(problem: Problem, fits: Sequence[Fit], labels: Sequence[str], path: PosePath, top: float) -> list[_Rated]:
    """The path with the distance of one pair, made smaller where it takes more than the largest input; nothing where it
    cannot be followed.
    """
    plant: Any = problem.plant
    truth, rival = _orders(fits)[0]
    try:
        run = _run(problem, fits[truth], path)
        if _largest_input(run) > top:
            path = path.smaller(plant.geometry, SMALLER * top / _largest_input(run))
            run = _run(problem, fits[truth], path)
        if _largest_input(run) > top:
            return []
        pair = Pair(labels[truth], labels[rival], _distance(problem, fits[truth], fits[rival], run))
    except NoTrustworthyNumber:
        return []
    return [_Rated(path, _largest_input(run), (pair,))]


def _both_ways(problem: Problem, fits: Sequence[Fit], labels: Sequence[str], rated: _Rated) -> _Rated:
    """The path with the distance of the other pair, too."""
    if len(_orders(fits)) < 2:
        return rated
    truth, rival = _orders(fits)[1]
    try:
        run = _run(problem, fits[truth], rated.path)
        d = _distance(problem, fits[truth], fits[rival], run)
    except NoTrustworthyNumber:  # what cannot be followed if the rival is right would tell nothing
        return replace(rated, pairs=(*rated.pairs, Pair(labels[truth], labels[rival], 0.0)))
    pairs = (*rated.pairs, Pair(labels[truth], labels[rival], d))
    return replace(rated, largest=max(rated.largest, _largest_input(run)), pairs=pairs)


def _orders(fits: Sequence[Fit]) -> list[tuple[int, int]]:
    """Truth and rival: a rival that contains its truth is no rival."""
    return [(a, b) for a, b in ((0, 1), (1, 0)) if not _contains(fits[b], fits[a])]


def _largest_input(record: Record) -> float:
    return max(float(np.abs(u).max()) for u in record.inputs.values())


def _contains(rich: Fit, poor: Fit) -> bool:
    """True where the rich hypothesis has all effects of the poor one: it cannot be told from it where that is true."""
    own = {c.key for c in rich.hypothesis.candidates}
    return {c.key for c in poor.hypothesis.candidates} < own


def _run(problem: Problem, fit: Fit, path: PosePath) -> Record:
    """A record of the path under the stated controller, with the fit's parameters and effects, and with noise."""
    plant: Any = problem.plant
    factors, values = problem.split(fit.hypothesis, fit.z)
    candidates = list(zip(fit.hypothesis.candidates, values, strict=True))
    for c, v in candidates:
        for name, factor in c.effect.factors(plant, c.site, v).items():
            factors[name] = factors.get(name, 1.0) * factor
    plant = plant.with_parameters(**{n: plant.parameters[n].reference * f for n, f in factors.items()})
    forces = [
        AttachedEffect(c.effect, c.site, v) for c, v in candidates
        if c.site.kind == "joint" and not c.effect.structural and not c.effect.factors(plant, c.site, v)
    ]  # fmt: skip
    dt = problem.records[0].record.dt
    u, y = _followed(plant, forces, path, dt)
    names = [s.name for s in plant.inputs], [s.name for s in plant.outputs]
    for c, v in candidates:
        if c.site.kind == "input":
            k = names[0].index(c.site.name)
            u[:, k] = _asked(c.effect, v, u[:, k], dt)
        elif c.site.kind == "output":
            k = names[1].index(c.site.name)
            y[:, k] = c.effect.output(y[None, :, k], v, dt)[0]
    first = problem.records[0]
    noise = np.random.default_rng(0).standard_normal((len(y), len(first.columns))) * first.smoothed.noise_std
    t = dt * np.arange(len(y))
    outputs = {names[1][k]: y[:, k] + noise[:, j] for j, k in enumerate(first.columns)}
    return Record(t, {name: u[:, k] for k, name in enumerate(names[0])}, outputs, {}, path.name)


def _followed(plant: Any, forces: Sequence[AttachedEffect], path: PosePath, dt: float) -> tuple[Array, Array]:
    """Inputs (n, 6) and outputs (n, n_y) of the machine that follows a path."""
    at = trim(plant, pose=path.poses[0])
    names = [s.name for s in plant.outputs[:6]]
    machine = with_effects(plant, forces) if forces else plant
    K = _controller(*_authority(plant, path.poses[0]), names, plant)
    loop = controlled_nonlinear(machine, K, names, names, at)
    if isinstance(loop, ControlledNonlinearPlant):  # stepped like one with effects: the loop is stiff
        loop = ExtendedNonlinearPlant(loop.name, loop.parameters, loop.inputs, loop.outputs, loop.states, loop, ())
    start = np.concatenate([at.x, np.zeros(K.n_states)])
    made = loop.motion(path.angles, dt, 0.0, start, dt, "foh")[1]
    n_y = len(plant.outputs)
    return made[:, n_y : n_y + 6].copy(), made[:, :n_y].copy()


def _controller(authority: Array, damping: Array, names: Sequence[str], plant: Any) -> StateSpaceModel:
    """The stated controller, from references and angles to the inputs."""
    k, d, c = NATURAL**2 / authority, 2.0 * DAMPING * NATURAL / authority, damping / authority
    rates = FILTER * np.hstack([np.diag(d + c), -np.diag(d)])
    inputs = [*((f"{name}_ref", "rad") for name in names), *((name, "rad") for name in names)]
    return StateSpaceModel(
        -FILTER * np.eye(12), FILTER * np.eye(12), -rates, np.hstack([np.diag(k), -np.diag(k)]) + rates, 0.0,
        inputs, plant.inputs,
    )  # fmt: skip


def _asked(effect: Any, values: Mapping[str, float], needed: Array, dt: float) -> Array:
    """What has to be asked for at an input, so that the effect there makes what the motion needs of it."""
    if effect.delay:
        at = np.arange(len(needed)) + values[effect.delay] / dt
        return np.interp(at, np.arange(len(needed)), needed)
    asked = needed.copy()
    for _ in range(ROUNDS):
        asked = asked + needed - effect.input(asked, values, dt)
    return asked


# --- distances -------------------------------------------------------------------------------------------------------


def _distance(problem: Problem, truth: Fit, rival: Fit, record: Record) -> float:
    """Refit distance of the rival to what the truth predicts along the record."""
    empty = _in_windows(problem, record)
    noise = NoiseModel(truth.noise.std, truth.noise.ar)
    none = tuple(np.zeros((len(c), len(problem.plant.states))) for c in empty.chosen)
    there = predicted(empty, replace(truth, starts=none, noise=noise))
    cost = there.fit(rival.hypothesis, noise, rival.z, none, FitPlan(ITERATIONS)).cost
    return float(np.sqrt(max(0.0, cost - float(rival.z @ rival.z))))


def _in_windows(problem: Problem, record: Record) -> Problem:
    """The record in windows as a naming would cut it: halved until the plant as given keeps near the motion in them."""
    plant, first = problem.plant, problem.records[0]
    model, length = ports_of(plant, record), first.windows.length
    seen, bare = [plant.outputs[k].name for k in first.columns], np.zeros(len(problem.nuisances))
    while True:
        prepared = replace(prepare(plant, model, record, length, None, seen), thin=first.thin)
        cut = problem.on([prepared])
        error = cut.errors(Hypothesis(()), bare, [np.zeros_like(prepared.x0)])[0]
        off = float((np.sqrt(np.nanmean(error**2, axis=(0, 1))) / np.ptp(prepared.y, axis=0)).max())
        if length <= tuning.SHORTEST_WINDOW or off < tuning.MOST_DEVIATION:
            return cut
        length = max(length // 2, tuning.SHORTEST_WINDOW)


# --- the answer ------------------------------------------------------------------------------------------------------


def _proposal(
    problem: Problem, rated: Sequence[_Rated], labels: tuple[str, ...], now: float, top: float
) -> NextExperiment:
    plant, first, best = problem.plant, problem.records[0], rated[0]
    dt, n = first.record.dt, len(best.path.angles)
    sensors = tuple(plant.outputs[k].name for k in first.columns)
    speed, _ = best.path.samples(dt)
    unit = plant.inputs[0].unit
    text = (
        f"a path of the pose, {best.path.name!r}: {best.path.words}, for {n * dt:.3g} s, one sample every "
        f"{1e3 * dt:.3g} ms; nuts up to {np.abs(speed).max():.3g} rad/s, inputs up to {best.largest:.3g} {unit} of "
        f"{top:.3g} (simulated under a controller of {NATURAL:g} rad/s at each nut); the references are for your own "
        f"controller; record the inputs that it asks for, and {', '.join(sensors)}"
    )
    told = (
        "" if best.separation >= SAFE else "nothing on the menu of paths is safe to tell them apart with these limits"
    )
    references = {f"{s.name}_ref": best.path.angles[:, k] for k, s in enumerate(plant.outputs[:6])}
    poses = {name: best.path.poses[:, k] for k, (name, _) in enumerate(POSE)}
    units = {**dict.fromkeys(references, "rad"), **dict(POSE)}
    menu = tuple(Tried(r.path.name, sensors, n * dt, r.separation, True) for r in rated)
    named = min((p.separation for p in best.pairs if p.truth == labels[0]), default=best.separation)
    return NextExperiment(
        best.path.name, text, told, dt * np.arange(n), {**references, **poses}, units, n * dt, sensors, (), {},
        best.separation, named, now, labels, best.pairs, menu,
    )  # fmt: skip
