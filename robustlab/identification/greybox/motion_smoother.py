"""States of a nonlinear plant along a record, joint by joint: q' = v, v' = the plant's acceleration along the motion +
a, with a random walk a, smoothed from each measured position; the residual force is M a, M from the plant's pushes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import Course, exponentials
from robustlab.errors import InputError, NoTrustworthyNumber, RobustlabError
from robustlab.identification.greybox.disturbance_smoother import SmoothedRecord, output_shares, smooth_disturbance
from robustlab.statespace import StateSpaceModel

ROUNDS = 2  # of smoothing with known inputs from the previous motion
UNMEASURED_ROUNDS = 4  # of linear simulations of the unmeasured states
STATE_SHARE = 0.05  # standard deviation of such a state over its size along the record
POINTS = 60  # of a motion for means
EDGE = 20  # samples at which the plant's outputs are tested for linearity


Smoothed = tuple[SmoothedRecord, Array, Array]  # with part and constant of each output (`PreparedRecord`)


@dataclass(frozen=True, eq=False)
class _Chain:
    """A measured state and its rate, the outputs that measure them, and the derivatives of the last rate."""

    states: tuple[int, ...]
    outputs: tuple[int, ...]
    rows: Array
    own: Array

    def model(self) -> StateSpaceModel:
        """Return the model with known rates of the last state as input; its unknown rate is the smoother's force."""
        n = len(self.states)
        a = np.eye(n, k=1)
        a[-1] = self.own
        return StateSpaceModel(a, np.eye(n)[:, -1:], self.rows, np.zeros((len(self.outputs), 1)))

    @property
    def push(self) -> Array:
        return np.eye(len(self.states))[:, -1:]


def smooth_motion(plant: NonlinearPlant, t: Array, u: Array, y: Array, columns: Sequence[int]) -> Smoothed:
    """Return states and forces at the joints along a record; ``columns``: index of each measured output."""
    arrays = (np.ascontiguousarray(a) for a in (t, u, y))
    return _kept(plant, *(a.tobytes() for a in arrays), tuple(columns))


@lru_cache(maxsize=16)
def _kept(plant: NonlinearPlant, t: bytes, u: bytes, y: bytes, columns: tuple[int, ...]) -> Smoothed:
    clock = np.frombuffer(t)
    n = len(clock)
    return _smooth(plant, clock, np.frombuffer(u).reshape(n, -1), np.frombuffer(y).reshape(n, -1), columns)


def _smooth(plant: NonlinearPlant, t: Array, u: Array, y: Array, columns: tuple[int, ...]) -> Smoothed:
    chains, offset = _chains(plant, u, y, columns)
    y = y - offset
    dt, n, n_x = float(t[1] - t[0]), len(t), len(plant.states)
    measured = sorted(k for c in chains for k in c.states)
    hidden = np.array([k for k in range(n_x) if k not in measured], dtype=np.int64)
    runs = [_smoothed(c, t, np.zeros(n), y) for c in chains]
    x = _assembled(chains, runs, n, n_x)
    x[:, hidden] = _rest(plant)[hidden]
    course = Course(plant, x, u, dt)
    known = np.zeros((n, n_x))
    for _ in range(ROUNDS):
        x = _with_hidden(course, hidden)
        course = replace(course, x=x)
        chains, known = _along(chains, course)
        runs = [_smoothed(c, t, known[:, c.states[-1]], y, like=run) for c, run in zip(chains, runs, strict=True)]
        found = _assembled(chains, runs, n, n_x)
        found[:, hidden] = x[:, hidden]
        course = replace(course, x=found)
    x = _with_hidden(course, hidden)
    return _collected(plant, chains, runs, hidden, t, u, y, x, known)


# --- sensors ---------------------------------------------------------------------------------------------------------


def _chains(plant: NonlinearPlant, u: Array, y: Array, columns: Sequence[int]) -> tuple[list[_Chain], Array]:
    """Return the measured states, and each measured output at zero states, (n_measured,)."""
    names = [s.name for s in plant.states]
    c, offset = _rows(plant, u, y, columns)
    shown: dict[int, list[int]] = {}
    for j, row in enumerate(c):
        shown.setdefault(int(np.flatnonzero(row)[0]), []).append(j)
    places = {p.position: p.name for p in plant.port_places if p.position}
    groups: list[tuple[int, ...]] = [(names.index(q), names.index(v)) for q, v in places.items()]
    for q, _ in groups:
        if q not in shown:
            known = ", ".join(plant.outputs[k].name for k in columns)
            raise InputError(
                f"discover {plant.name}", f"no measured output shows {names[q]} (measured: {known})",
                "the position of every joint of a nonlinear plant", "a speed alone does not determine the position",
            )  # fmt: skip
    paired = {k for pair in groups for k in pair}
    groups += [(k,) for k in shown if k not in paired]
    outputs = [tuple(j for k in states for j in shown.get(k, ())) for states in groups]
    return [
        _Chain(states, own, c[np.ix_(own, states)], np.zeros(len(states)))
        for states, own in zip(groups, outputs, strict=True)
    ], offset


def _rows(plant: NonlinearPlant, u: Array, y: Array, columns: Sequence[int]) -> tuple[Array, Array]:
    """Return rows (n_measured, n_x) of C for the measured outputs, each of one state, and values at zero states."""
    n_x = len(plant.states)
    # By differences, exact for linear outputs: a plant may have no derivatives at zero states (an empty tank).
    shown = plant.outputs_along(np.vstack([np.zeros(n_x), np.eye(n_x)]), np.repeat(u[:1], n_x + 1, axis=0))
    c = (shown[1:] - shown[0]).T[list(columns)]
    for j, row in zip(columns, c, strict=True):
        if np.count_nonzero(row) != 1:
            raise InputError(
                f"discover {plant.name}", f"the output {plant.outputs[j].name} shows {np.count_nonzero(row)} states",
                "outputs of a nonlinear plant that show one state each", "give the positions and currents as outputs",
            )  # fmt: skip
    scale = np.abs(c).sum(axis=1)
    first = np.zeros((min(EDGE, len(y)), len(plant.states)))
    for j, row in enumerate(c):
        k = int(np.flatnonzero(row)[0])
        first[:, k] = np.nan_to_num(y[: len(first), j]) / row[k]
    shown = plant.outputs_along(first, u[: len(first)])[:, list(columns)]
    offset = (shown - first @ c.T).mean(axis=0)
    if (np.abs(shown - first @ c.T - offset) > 1e-9 * (np.abs(shown) + scale)).any():
        raise InputError(f"discover {plant.name}", "outputs that are no linear function of a state", "linear ones")
    return c, offset


# --- smoothing -------------------------------------------------------------------------------------------------------


def _smoothed(chain: _Chain, t: Array, known: Array, y: Array, like: SmoothedRecord | None = None) -> SmoothedRecord:
    noise = None if like is None else like.noise_std
    return smooth_disturbance(chain.model(), chain.push, t, known[:, None], y[:, list(chain.outputs)], noise)


def _assembled(chains: Sequence[_Chain], runs: Sequence[SmoothedRecord], n: int, n_x: int) -> Array:
    x = np.zeros((n, n_x))
    for chain, run in zip(chains, runs, strict=True):
        x[:, list(chain.states)] = run.x
    return x


def _along(chains: Sequence[_Chain], course: Course) -> tuple[list[_Chain], Array]:
    """Return the chains with the plant's mean derivatives along the motion, and the known rates between the samples."""
    n = len(course.x)
    x, u = course.at(np.arange(n - 1) + 0.5)
    rates = course.plant.rates_along(x, u)
    if not np.isfinite(rates).all():
        raise NoTrustworthyNumber(course.plant.name, "rates along the record that are no numbers")
    mean = course.plant.local_models(*course.at(np.linspace(0, n - 1, min(n, POINTS)))).A.mean(axis=0)
    found = []
    for chain in chains:
        own = list(chain.states)
        found.append(replace(chain, own=mean[own[-1], own]))
        rates[:, own[-1]] -= x[:, own] @ found[-1].own
    return found, np.vstack([rates, rates[-1:]])


def _with_hidden(course: Course, hidden: Indices) -> Array:
    """Simulate the unmeasured states along the motion, from their equilibrium."""
    x = course.x.copy()
    if not len(hidden):
        return x
    n, plant = len(x), course.plant
    for _ in range(UNMEASURED_ROUNDS):
        about = Course(plant, x, course.u, course.dt)
        at, u = about.at(np.arange(n - 1) + 0.5)
        local = plant.local_models(at, u)
        a = local.A[:, hidden[:, None], hidden]
        phi, psi, _ = exponentials(np.ascontiguousarray(a), course.dt)
        free = local.rates[:, hidden] - np.einsum("npq,nq->np", a, at[:, hidden])
        pushed = np.einsum("npq,nq->np", psi, free)
        state = _resting(a[0], free[0], x[0, hidden])
        found = np.empty((n, len(hidden)))
        for k in range(n - 1):
            found[k] = state
            state = phi[k] @ state + pushed[k]
        found[-1] = state
        if not np.isfinite(found).all():
            text = "a state without a sensor that does not settle by itself"
            raise InputError(f"discover {plant.name}", text, "a sensor for it")
        x[:, hidden] = found
    return x


def _rest(plant: NonlinearPlant) -> Array:
    """Return an equilibrium of the plant as initial guess of unmeasured states, zero without one."""
    try:
        return np.array(plant.equilibrium().x)
    except RobustlabError:
        return np.zeros(len(plant.states))


def _resting(a: Array, free: Array, otherwise: Array) -> Array:
    """Return the equilibrium of the states at the first sample; ``otherwise`` if they are unstable."""
    if np.linalg.eigvals(a).real.max(initial=-1.0) >= -1e-9:
        return otherwise
    return np.asarray(-np.linalg.solve(a, free))


# --- the result ------------------------------------------------------------------------------------------------------


def _collected(
    plant: NonlinearPlant, chains: Sequence[_Chain], runs: Sequence[SmoothedRecord], hidden: Indices,
    t: Array, u: Array, y: Array, x: Array, known: Array,
) -> Smoothed:  # fmt: skip
    n, n_x, n_y = len(t), x.shape[1], y.shape[1]
    std, covariance = np.zeros((n, n_x)), np.zeros((n, n_x, n_x))
    parts, constant, noise = *np.zeros((2, n_y, n, n_x)), np.zeros(n_y)
    lacking, lacking_std = np.zeros((n, n_x)), np.zeros((n, n_x))
    for chain, run in zip(chains, runs, strict=True):
        own, outputs = list(chain.states), list(chain.outputs)
        std[:, own] = run.x_std
        covariance[:, np.array(own)[:, None], own] = run.covariance
        noise[outputs] = run.noise_std
        lacking[:, own[-1]], lacking_std[:, own[-1]] = run.d[:, 0], run.d_std[:, 0]
        shares = output_shares(chain.model(), chain.push, t, known[:, own[-1:]], y[:, outputs], run)
        for j, share, unit in zip(outputs, *shares, strict=True):
            parts[j][:, own], constant[j][:, own] = share, unit
    if len(hidden):
        std[:, hidden] = STATE_SHARE * np.maximum(np.abs(x[:, hidden]).max(axis=0), 1e-12)
        covariance[:, hidden, hidden] = std[:, hidden] ** 2
    force, force_std = _forces(plant, x, u, lacking, lacking_std)
    whole = replace(
        runs[0], x=x, x_std=std, covariance=covariance, d=force, d_std=force_std, noise_std=noise,
        bandwidth=np.concatenate([r.bandwidth for r in runs]),
    )  # fmt: skip
    return whole, parts, constant


def _forces(plant: NonlinearPlant, x: Array, u: Array, lacking: Array, std: Array) -> tuple[Array, Array]:
    """Return the force at each joint for the missing accelerations, (n, n_joints), and its standard deviation."""
    names = [s.name for s in plant.states]
    joints = [k for k, p in enumerate(plant.port_places) if p.kind == "joint"]
    if not joints:  # as an addition to the inputs
        b = plant.local_models(x, u).B
        inverse = np.linalg.pinv(b)
        return np.einsum("npq,nq->np", inverse, lacking), np.sqrt(np.einsum("npq,nq->np", inverse**2, std**2))
    rows = [names.index(plant.port_places[k].name) for k in joints]
    push = plant.local_models(x, u).push[:, rows][:, :, joints]
    inverse = np.linalg.inv(push)
    force = np.einsum("npq,nq->np", inverse, lacking[:, rows])
    return force, np.sqrt(np.einsum("npq,nq->np", inverse**2, std[:, rows] ** 2))
