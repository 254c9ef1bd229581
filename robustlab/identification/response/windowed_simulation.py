r"""Simulation in windows, each from its own least-squares initial state, and the residual that such windows leave.

The *recursive residual* predicts sample k of an output with the state fitted to its samples in the window before k,

.. math:: w_k = \frac{y_k - y_{u,k} - s_k^T \hat x_{k-1}}{\sqrt{1 + s_k^T P_{k-1} s_k}}, \qquad
          P_{k-1} = \Big(\sum_{j<k} s_j s_j^T\Big)^{-1},

which is white with the variance of the noise where the model is right, for every window length (Brown, Durbin, Evans
1975). What an input does to an output is judged in windows with free start, constant drive and constant sensor error
projected out: :math:`P y_j \approx \sum_i s_i\, P (G u_i)_j`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Mask
from robustlab.dynamics.simulation import transition
from robustlab.identification.response.response import Response, Stretch
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel

SHORTEST_START = 20  # samples
# Singular values of the column-scaled sensitivity below this share of the largest are not observed.
RANK_TOLERANCE = 1e-10
# Entries of the free response below this share of its largest column carry no information on the state.
NO_INFORMATION = 1e-10


@dataclass(frozen=True)
class StateFit:
    """Least-squares fit of an initial state to a stretch of measured outputs."""

    # state at the first sample, shape (n_x,); the smallest one (scaled) where the outputs do not determine it
    x0: Array
    std: Array  # standard deviation of ``x0`` if the remaining error were white, shape (n_x,)
    rank: int  # number of state directions that the outputs determine
    y: Array  # simulated outputs from ``x0``, shape (n, n_y)


@dataclass(frozen=True)
class InitialState(Evidence):
    """The state from which the whole record is simulated."""

    # x0, std: estimate and its standard deviation, shape (n_x,), in the units of ``names``
    x0: Array
    std: Array
    names: tuple[str, ...]  # names of the states
    # samples, seconds: length of the stretch it was fitted to
    samples: int
    seconds: float
    # number of state directions that the recorded outputs determine; less than n_x means part of the start is unknown
    rank: int

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return {
            "x0": self.x0,
            "std": self.std,
            "states": list(self.names),
            "samples": self.samples,
            "seconds": self.seconds,
            "rank": self.rank,
        }


def fit_state(response: Response, stretch: Stretch, free: Array | None = None) -> StateFit:
    """Initial state of a stretch; ``free`` is the free response over its clock, where it is known already."""
    forced = response.simulate(stretch.t, stretch.u, np.zeros(response.n_states))
    free = response.free_response(stretch.t) if free is None else free
    x0, std, rank = weighted_least_squares(free, stretch.y - forced, stretch.weight)
    return StateFit(x0, std, rank, forced + free @ x0)


def starting_state(response: Response, whole: Stretch, longest: int) -> InitialState:
    """State at the start of a record, from the longest opening stretch over which the estimate stays consistent.

    A short stretch suffers from noise, a long one from the faults of the model. The stretch is doubled from 20 samples
    (at least 4 n_x) up to ``longest``, as long as the 3-sigma intervals of all estimates so far have a common point
    (intersection of confidence intervals).
    """
    shortest = min(len(whole.t), max(SHORTEST_START, 4 * response.n_states))
    names, longest = response.model.state_names, min(longest, len(whole.t))
    return consistent_start(lambda n: fit_state(response, whole.cut(0, n)), whole.t, names, shortest, longest)


def consistent_start(
    fit_to: Callable[[int], StateFit], t: Array, names: tuple[str, ...], shortest: int, longest: int
) -> InitialState:
    """`starting_state` from the fits ``fit_to(n)`` to the first n samples of the clock ``t``."""
    n = shortest
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    best: tuple[int, StateFit] | None = None
    while True:
        fit = fit_to(n)
        low, high = np.maximum(low, fit.x0 - 3.0 * fit.std), np.minimum(high, fit.x0 + 3.0 * fit.std)
        if best is not None and (low > high).any():
            break
        best = n, fit
        if 2 * n > longest or not names:
            break
        n *= 2
    n, fit = best
    return InitialState(fit.x0, fit.std, names, n, float(t[n - 1] - t[0]), fit.rank)


def weighted_least_squares(free: Array, error: Array, weight: Array) -> tuple[Array, Array, int]:
    """Weighted least-squares state, its standard deviation for white errors, and the rank."""
    n_x = free.shape[2]
    if not n_x:
        return np.zeros(0), np.zeros(0), 0
    lhs = (free * weight[:, None]).reshape(-1, n_x)
    rhs = (error * weight).ravel()
    scale = np.linalg.norm(lhs, axis=0)
    scale[scale == 0] = 1.0
    left, sigma, right = np.linalg.svd(lhs / scale, full_matrices=False)
    rank = int((sigma > RANK_TOLERANCE * sigma[0]).sum()) if sigma[0] > 0 else 0
    left, sigma, right = left[:, :rank], sigma[:rank], right[:rank]
    coordinates = left.T @ rhs
    x0 = right.T @ (coordinates / sigma) / scale
    spare = max(1, len(rhs) - rank)
    variance = max(0.0, float(rhs @ rhs - coordinates @ coordinates)) / spare
    std = np.sqrt(variance * ((right / sigma[:, None]) ** 2).sum(axis=0)) / scale
    return x0, std, rank


@dataclass(frozen=True)
class WindowedSimulation:
    """Windowed simulation of a record."""

    edges: NDArray[np.int_]  # first sample of each window, and the number of samples at the end, shape (n_windows + 1,)
    y: Array  # simulated outputs, shape (n, n_y)
    x0: Array  # fitted initial states, shape (n_windows, n_x)
    # recursive residual in units of the outputs, shape (n, n_y); NaN at the samples that only fix the state of their
    # window
    residual: Array


def window_edges(n: int, length: int) -> NDArray[np.int_]:
    """Edges of windows of ``length`` samples; a rest shorter than half a window belongs to the last one.

    Examples
    --------
    >>> window_edges(99, 40).tolist(), window_edges(110, 40).tolist()
    ([0, 40, 99], [0, 40, 80, 110])
    """
    edges = list(range(0, n, length))
    if len(edges) > 1 and n - edges[-1] < length / 2:
        edges.pop()
    return np.array([*edges, n])


def windowed_simulation(response: Response, whole: Stretch, length: int) -> WindowedSimulation:
    """Simulate every window of ``length`` samples from its own least-squares initial state."""
    t, y = whole.t, whole.y
    edges = window_edges(len(t), length)
    longest = int(np.diff(edges).max())
    # The free response is the same in all windows where the clock is uniform.
    shared = response.free_response(t[:longest]) if whole.is_uniform else None
    n_windows = len(edges) - 1
    simulated, states = np.empty_like(y), np.empty((n_windows, response.n_states))
    error, residual = np.full((longest, y.shape[1], n_windows), np.nan), np.empty_like(y)
    for k, (first, last) in enumerate(pairwise(edges)):
        part, size = slice(first, last), last - first
        free = shared[:size] if shared is not None else response.free_response(t[part])
        fit = fit_state(response, whole.cut(first, last), free)
        simulated[part], states[k] = fit.y, fit.x0
        error[:size, :, k] = y[part] - fit.y
        if shared is None:
            for j in range(y.shape[1]):
                residual[part, j] = recursive_residual(free[:, j], error[:size, j, k : k + 1])[:, 0]
    if shared is not None:
        for j in range(y.shape[1]):
            padded = recursive_residual(shared[:, j], error[:, j])
            residual[:, j] = np.concatenate([padded[:size, k] for k, size in enumerate(np.diff(edges))])
    return WindowedSimulation(edges, simulated, states, residual)


def recursive_residual(free: Array, error: Array) -> Array:
    """Recursive residual of one output in windows that share one free response, shape (n, n_windows).

    ``free``: free response of this output, shape (n, n_x). ``error``: measured minus simulated output from any one
    initial state, shape (n, n_windows); the residual is the same for all. A window that ends earlier than the others
    ends in NaN.
    """
    from robustlab.identification.response.recursion_kernel import predict

    size = np.linalg.norm(free, axis=0)
    floor = NO_INFORMATION * np.where(size > 0, size, 1.0)
    result = np.array(error, order="C")
    predict(np.array(free, order="C"), result, floor)
    return result


DEAD_VISCOSITY = 50.0  # viscous damping that slows a machine down by more than this is none
LONGEST_DELAY, DELAYS = 0.02, 4  # s, and how many up to it
MOST_FRICTION = 0.95  # share of the largest input's force that dry friction may take in a machine that moves
REST = 0.03  # speeds below this share of the largest count as rest
MOST_PORTS = 6
RANK = 1e-8
GROWTH = 1e6  # windows over which an unstable model grows by more are not simulated


def response_windows(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask
) -> tuple[ResponseWindows, ...]:
    """The record in windows of its whole length, a sixth, and a thirtieth, as far as these make sense.

    ``model``: linear model. ``outputs``: names of the outputs to look at. ``record``: on a uniform clock, with the
    model's inputs and these outputs. ``good``: samples that were measured, shape (n,); windows with others are left
    out.
    """
    point = model.operating_point
    at_y = dict(zip(model.output_names, point.y, strict=True)) if point else {}
    at_u = dict(zip(model.input_names, point.u, strict=True)) if point else {}
    u = np.column_stack([record.inputs[name] - at_u.get(name, 0.0) for name in model.input_names])
    y = np.column_stack([record.outputs[name] - at_y.get(name, 0.0) for name in outputs])
    fits = [ResponseWindows(model, outputs, record.dt, u, y, good, length) for length in _lengths(model, record)]
    return tuple(fit for fit in fits if fit.count)


def _lengths(model: StateSpaceModel, record: Record) -> list[int]:
    """Window lengths in samples."""
    shortest = max(40, 8 * (2 * model.n_states + 1))
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(np.where(np.abs(poles) > 0, poles, 1e-300)) / model.dt
    growth = float(poles.real.max(initial=0.0))
    lengths = []
    for parts in (1, 6, 30):
        length = record.n // parts
        if length >= shortest and growth * length * record.dt < math.log(GROWTH):
            lengths.append(length)
    return lengths


class MissingEffects(NamedTuple):
    """Responses (n,) of one output to what a model may lack, with physics' sign: coefficients are never negative.

    ``springs`` (what acts against position) and the largest coefficients of them, ``stiffest``; ``losses`` (viscous
    damping, then twice dry friction, for each port) and theirs, ``largest``; ``held``: the part of the response to each
    input that is due to the time at rest, when static friction holds it.
    """

    springs: list[Array]
    stiffest: list[float]
    losses: list[Array]
    largest: list[float]
    held: list[Array]


class ResponseWindows:
    """A record cut into windows of one length, with what no initial state or constant explains."""

    def __init__(
        self, model: StateSpaceModel, outputs: tuple[str, ...], dt: float, u: Array, y: Array, good: Mask, length: int
    ) -> None:
        edges = np.arange(0, len(u) + 1, length)
        keep = [(i, k) for i, k in pairwise(edges.tolist()) if good[i:k].all()]
        self.model, self.dt, self.length, self.count, self.good = model, dt, length, len(keep), good
        self.rows = [model.output_names.index(name) for name in outputs]
        self.keep, self.u_all = keep, u
        self.u, self.y = self._cut(u), self._cut(y)
        self.ports = _ports(model)
        if model.is_discrete:
            self.phi, self.gamma = model.A, np.hstack([model.B, np.eye(model.n_states)])
        else:
            wide = _with_state_inputs(model)
            self.phi, self.gamma, _ = transition(wide, dt)
        if not keep:
            return
        self.basis = [self._nuisance(row) for row in self.rows]
        self.answers = self.response(self.u, np.arange(model.n_inputs))
        self.forced = [[self.project(j, f[..., row]) for f in self.answers] for j, row in enumerate(self.rows)]
        self.target = [self.project(j, self.y[..., j]) for j in range(len(self.rows))]

    def _cut(self, x: Array) -> Array:
        return np.stack([x[i:k] for i, k in self.keep]) if self.keep else np.zeros((0, self.length, x.shape[1]))

    def response(self, signals: Array, columns: NDArray[np.intp]) -> list[Array]:
        """Outputs (windows, n, n_y_of_model) to each signal (windows, n, columns) from rest, one at a time.

        Column k < n_u of the inputs is input k; column n_u + i drives the equation of state i.
        """
        count, n_u = len(columns), self.model.n_inputs
        gamma = self.gamma[:, columns]
        force = signals.transpose(1, 2, 0)  # (n, columns, windows)
        state = np.zeros((count, force.shape[2], self.model.n_states))
        states = np.empty((self.length, *state.shape))
        for k in range(self.length):
            states[k] = state
            state = state @ self.phi.T + force[k][:, :, None] * gamma.T[:, None, :]
        found = []
        for c, column in enumerate(columns.tolist()):
            y = states[:, c].transpose(1, 0, 2) @ self.model.C.T
            found.append(y + signals[..., c : c + 1] * self.model.D[:, column] if column < n_u else y)
        return found

    @cached_property
    def late(self) -> list[list[Array]]:
        """Responses to the inputs at delays of up to 20 ms."""
        longest = min(LONGEST_DELAY / self.dt, self.length / 4)
        return self.delayed(sorted({round(longest * k / DELAYS) for k in range(1, DELAYS + 1)} - {0}))

    def _nuisance(self, row: int) -> Array:
        """Orthonormal basis (n, r) of what a start, a constant disturbance and a constant sensor error can do."""
        free = self._free(row)
        drive = self.gamma[:, self.model.n_inputs :]
        held = np.vstack([np.zeros((1, self.model.n_states)), np.cumsum(free[:-1] @ drive, axis=0)])
        return _orthonormal(np.column_stack([free, held, np.ones(self.length)]))

    def _free(self, row: int) -> Array:
        """Output over a window from a unit of each state at its start, (n, n_x)."""
        free = np.empty((self.length, self.model.n_states))
        line = self.model.C[row]
        for k in range(self.length):
            free[k], line = line, line @ self.phi
        return free

    def project(self, j: int, x: Array) -> Array:
        """What the nuisance of output j leaves of x (windows, n), as one vector."""
        q = self.basis[j]
        return (x - (x @ q) @ q.T).ravel()

    def plain(self, j: int) -> tuple[Array, float]:
        """Least-squares factors (n_u,) of the inputs' responses in output j, and R²."""
        columns = np.column_stack(self.forced[j])
        share, factors = explained(self.target[j], columns, np.full(columns.shape[1], -np.inf), np.inf)
        return factors, share

    def raw(self, j: int) -> tuple[Array, float]:
        """`plain` with nothing but the windows' starts left out: what a steady input does counts here, too."""
        row = self.rows[j]
        q = _orthonormal(self._free(row))
        target, *columns = ((x - (x @ q) @ q.T).ravel() for x in (self.y[..., j], *(f[..., row] for f in self.answers)))
        share, factors = explained(target, np.column_stack(columns), np.full(len(columns), -np.inf), np.inf)
        return factors, share

    def delayed(self, delays: list[int]) -> list[list[Array]]:
        """Responses (windows, n, n_y_of_model) to each input, for each of the delays in samples."""
        if not delays:
            return []
        u, n_u = self.u_all, self.model.n_inputs
        late = [np.vstack([np.repeat(u[:1], d, axis=0), u[: len(u) - d]]) for d in delays]
        answers = self.response(self._cut(np.hstack(late)), np.tile(np.arange(n_u), len(delays)))
        return [answers[k : k + n_u] for k in range(0, len(answers), n_u)]

    def effects(self, j: int, row: int, y: Array) -> MissingEffects:
        """What friction and springs do to the model's output ``row`` when it moves like y (windows, n)."""
        from scipy.signal import savgol_filter

        mean = y - y.mean(axis=1, keepdims=True)
        width = min(self.length - 1 + self.length % 2, max(5, (self.length // 40) | 1))
        rate = np.asarray(savgol_filter(y, width, min(3, width - 1), deriv=1, delta=self.dt, axis=1), dtype=np.float64)
        total = np.cumsum(mean, axis=1) * self.dt
        drives = np.stack([-mean, -total, -rate, -np.sign(y), -np.sign(rate)], axis=2)
        speed = np.abs(y if self._static_gain(row, self.ports[0] if self.ports else 0) else rate)
        rest = speed < REST * speed.max(initial=0.0)
        springs: list[Array] = []
        stiffest: list[float] = []
        losses: list[Array] = []
        largest: list[float] = []
        n_u, kinds = self.model.n_inputs, drives.shape[2]
        everything = self.response(np.tile(drives, len(self.ports)), np.repeat(self.ports, kinds))
        for k, port in enumerate(self.ports):
            answers = [self.project(j, a[..., row]) for a in everything[kinds * k : kinds * (k + 1)]]
            gain = self._static_gain(row, port)
            springs.append(answers[0])
            stiffest.append(DEAD_VISCOSITY / gain if gain else np.inf)
            if gain:  # an integral of what integrates already is no spring
                springs.append(answers[1])
                stiffest.append(np.inf)
            losses += answers[2:]
            hold = MOST_FRICTION * self._holding[j][k] or np.inf  # a run-down without input bounds no friction
            largest += [np.inf, hold, hold]
        held = [self.project(j, a[..., row]) for a in self.response(self.u * rest[..., None], np.arange(n_u))]
        return MissingEffects(springs, stiffest, losses, largest, held)

    @cached_property
    def _holding(self) -> list[list[float]]:
        """Drive of each port (list of them for each output) that stands up to the largest inputs."""
        sign = np.sign(self.u)
        peak, mean = np.abs(self.u).max(axis=(0, 1)), np.abs(self.u).mean(axis=(0, 1))
        crest = np.divide(peak, mean, out=np.zeros_like(peak), where=mean > 0)
        n_u = self.model.n_inputs
        answers = self.response(np.tile(sign, len(self.ports)), np.repeat(self.ports, n_u))
        found = []
        for j, row in enumerate(self.rows):
            columns = [self.project(j, a[..., row]) for a in answers]
            found.append(
                [
                    sum(crest[i] * _ratio(self.forced[j][i], columns[k * n_u + i]) for i in range(n_u))
                    for k in range(len(self.ports))
                ]
            )
        return found

    def _static_gain(self, row: int, port: int) -> float:
        """|y/d| at rest of a constant drive of the port; 0 where the model integrates it."""
        a, b = self.model.A, np.hstack([self.model.B, np.eye(self.model.n_states)])
        if self.model.is_discrete:
            a = a - np.eye(len(a))
        if not len(a) or np.linalg.cond(a) > 1e12:
            return 0.0
        return abs(float(self.model.C[row] @ np.linalg.solve(a, b[:, port])))


def _orthonormal(columns: Array) -> Array:
    """Orthonormal basis (n, r) of what the columns span."""
    size = np.linalg.norm(columns, axis=0)
    if not size.any():
        return np.zeros((len(columns), 0))
    left, sigma, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return left[:, sigma > RANK * sigma[0]]


def _ratio(x: Array, y: Array) -> float:
    """|coefficient| of y in the least-squares fit of x."""
    square = float(y @ y)
    return abs(float(x @ y)) / square if square else 0.0


def _with_state_inputs(model: StateSpaceModel) -> StateSpaceModel:
    """The model with a further input on the equation of every state."""
    n = model.n_states
    names = [f"input {k}" for k in range(model.n_inputs)] + [f"state {k}" for k in range(n)]
    wide = np.hstack([model.B, np.eye(n)])
    return StateSpaceModel(model.A, wide, model.C, np.hstack([model.D, np.zeros((len(model.C), n))]), inputs=names)


def _ports(model: StateSpaceModel) -> list[int]:
    """Where effects act: equations of states that are no plain integrals of others; in large models the inputs."""
    n_u = model.n_inputs
    states = []
    for k in range(model.n_states):
        kinematic = not model.B[k].any() and np.count_nonzero(model.A[k]) == 1 and not model.A[k, k]
        if not kinematic:
            states.append(n_u + k)
    return states if len(states) <= MOST_PORTS else list(range(min(n_u, MOST_PORTS)))


def explained(target: Array, columns: Array, lower: Array, upper: Array | float) -> tuple[float, Array]:
    """Share of the target's square that the columns explain within bounds on their coefficients, and those."""
    from scipy.optimize import lsq_linear

    total = float(target @ target)
    size = np.linalg.norm(columns, axis=0)
    coefficients = np.zeros(columns.shape[1])
    upper = np.broadcast_to(np.asarray(upper, dtype=np.float64), coefficients.shape)
    use = np.flatnonzero(size > 1e-12 * max(float(size.max(initial=0.0)), 1e-300))
    if not total or not len(use):
        return 0.0, coefficients
    scaled = columns[:, use] / size[use]
    scale = math.sqrt(total)
    q, r = np.linalg.qr(scaled)
    small = q.T @ (target / scale)
    if np.isinf(lower[use]).all() and np.isinf(upper[use]).all():
        x = np.linalg.lstsq(r, small, rcond=None)[0]
    else:
        bounds = lower[use] * size[use] / scale, upper[use] * size[use] / scale
        x = np.asarray(lsq_linear(r, small, bounds, method="bvls").x, dtype=np.float64)
    coefficients[use] = x * scale / size[use]
    rest = 1.0 - float(small @ small) + float(((small - r @ x) ** 2).sum())
    return 1.0 - rest, coefficients
