r"""What an input does to an output, in windows that know neither their start nor a constant disturbance.

Each window has its own initial state, a constant drive of every state's equation, and a constant error of the sensor;
what these can do is projected out of the measured output and of every response of the model,

.. math:: P y_j \approx \sum_i s_i \, P (G u_i)_j, \qquad P = I - Q Q^T,

so that the factors :math:`s_i` do not depend on drift, offsets or where the machine started.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Mask
from robustlab.dynamics.simulation import transition
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel

__all__ = ["ResponseWindows", "explained", "response_windows"]


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
