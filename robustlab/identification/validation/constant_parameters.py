r"""Smallest constant real parameters that explain a record, by descent: an upper bound of the smallest size.

For fixed parameters the noise is affine in the free states; successive cone programmes change both at once, first to
meet the noise bound, then to minimise the size.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import SLACK, Rows, Search, solved_cones, sparse_matrices
from robustlab.identification.validation.sampled_problem import Recorded, observable_directions, states, zero_order_hold

WIDEST = 1e3  # parameters beyond this many times their range are not tried
MOVES = 40  # of a descent
CREEP, CREEPS = 0.995, 3  # stop after so many moves that leave more than this share of the noise beyond its bound
PRICE = 1e4  # of the noise beyond its bound, in units of the size of the parameters
STARTS = 3  # random ones besides the nominal one
SIMULATION_WORK = 500.0  # of a simulation, besides its samples
MARGIN = 1e-7  # distance of the programmes' target from the noise bound


@dataclass(frozen=True)
class Parameters:
    """Result of `smallest_parameters`."""

    upper: float  # largest ``|delta|`` of the best delta; inf if none explains the record
    delta: Array  # normalised values of the real blocks, in order
    noise: Array  # remaining noise (n, n_y), over its bound
    excess: float  # smallest noise over its bound over all trials


@dataclass(frozen=True)
class _Windows:
    """Noise (n, n_y) with delta in windows from zero state, and the response of -noise to free states (n n_y, k)."""

    delta: Array
    e: Array
    free: Any

    def noise(self, x: Array) -> Array:
        return self.e - (self.free @ x).reshape(self.e.shape)


def smallest_parameters(recorded: Recorded, search: Search) -> Parameters:
    """Search the smallest ``|delta|`` that explains the record, all blocks real."""
    m = len(recorded.uncertain.blocks)
    rng = np.random.default_rng(0)
    starts = [np.zeros(m), *(rng.uniform(-1, 1, m) for _ in range(STARTS if m > 1 else 1))]
    found: list[Parameters] = []
    for start in starts:
        found.append(_descend(recorded, start, search))
        if not found[-1].upper:
            break
    return min(found, key=_rank)


def _rank(found: Parameters) -> tuple[float, float]:
    return found.upper, found.excess


def _descend(recorded: Recorded, start: Array, search: Search) -> Parameters:
    """Solve successive programmes with a trust region."""
    m, radius, creeps = len(start), 0.5, 0
    at = _windows(recorded, start, search)
    fitted = None if at is None else _move(recorded, at, np.zeros((at.e.size, m)), search, 0.0)
    if at is None or fitted is None:
        return Parameters(np.inf, start, np.zeros(recorded.y.shape), np.inf)
    x = fitted[1]
    best = _sized(recorded, at, x)
    for _ in range(MOVES):
        if creeps >= CREEPS or search.budget.over or not best.upper:
            break
        here = _sized(recorded, at, x)
        step = 1e-5 * max(1.0, float(np.abs(at.delta).max()))
        sides = [_windows(recorded, at.delta + s * step * unit, search) for unit in np.eye(m) for s in (1, -1)]
        known = [side.noise(x).ravel() for side in sides if side is not None]
        if len(known) < len(sides):
            break
        slope = np.column_stack([(a - b) / (2 * step) for a, b in zip(known[::2], known[1::2], strict=True)])
        moved = _move(recorded, at, slope, search, radius)
        if moved is None:
            break
        new = _windows(recorded, at.delta + moved[0], search)
        if new is None:
            radius /= 4
            continue
        there = _sized(recorded, new, moved[1])
        was, now = max(here.excess - 1, 0.0) * PRICE, max(there.excess - 1, 0.0) * PRICE
        creeps = creeps + 1 if now > CREEP * was > 0 else 0
        best = min(best, there, key=_rank)
        if was + np.abs(at.delta).max() > now + np.abs(new.delta).max():
            length, size = float(np.abs(moved[0]).max()), float(np.abs(new.delta).max())
            at, x, radius = new, moved[1], min(2 * radius, max(4 * length, 1e-3), WIDEST)
            if length < 0.02 * search.precision * max(size, 1e-9) and (there.excess <= 1 + SLACK or length < 1e-9):
                break
        else:
            radius /= 4
            if radius < 1e-9:
                break
    return best


def _windows(recorded: Recorded, delta: Array, search: Search) -> _Windows | None:
    """Simulate the windows at delta; None if it is ill-posed or overflows."""
    search.budget.spend(SIMULATION_WORK + 0.3 * recorded.y.size)
    uncertain = recorded.uncertain
    try:
        model = uncertain.evaluate(dict(zip([b.name for b in uncertain.blocks], delta.tolist(), strict=True)))
        A, B = zero_order_hold(model, recorded.dt)
    except NoTrustworthyNumber:
        return None
    C, sparse = model.C / recorded.bound[:, None], sparse_matrices()
    cuts = list(pairwise([*recorded.starts, len(recorded.t)]))
    longest = max(b - a for a, b in cuts)
    moved = [states(A, np.zeros((longest, len(A))), x0) @ C.T for x0 in observable_directions(A, C).T]
    columns = np.stack(moved, axis=2) if moved else np.zeros((longest, recorded.y.shape[1], 0))
    e, free = np.empty_like(recorded.y), []
    for a, b in cuts:
        u = recorded.u[a:b]
        e[a:b] = (recorded.y[a:b] - u @ model.D.T) / recorded.bound - states(A, u @ B.T, np.zeros(len(A))) @ C.T
        part = columns[: b - a].reshape((b - a) * e.shape[1], -1)
        free.append(sparse.csr_matrix(part[:, :0] if a == 0 and recorded.at_rest else part))
    together = sparse.block_diag(free, format="csr")
    return _Windows(delta, e, together) if np.isfinite(e).all() and np.isfinite(together.data).all() else None


def _sized(recorded: Recorded, at: _Windows, x: Array) -> Parameters:
    """Return the size of delta and the noise that remains with these free states."""
    noise = at.noise(x)
    if recorded.norm == "peak":
        excess = float(np.abs(noise).max())
    else:
        excess = float(np.linalg.norm(noise, axis=0).max() / np.sqrt(recorded.count))
    size = float(np.abs(at.delta).max())
    return Parameters(size if excess <= 1 + SLACK and size <= WIDEST else np.inf, at.delta, noise, excess)


def _move(recorded: Recorded, at: _Windows, slope: Array, search: Search, radius: float) -> tuple[Array, Array] | None:
    """Solve the linearised problem for the change of delta and the free states; None without an answer.

    Variables: change of delta, size of delta, excess of the noise, free states of each window.
    """
    sparse, m, n = sparse_matrices(), len(at.delta), at.e.size
    noise = sparse.hstack([sparse.csr_matrix(slope), sparse.csr_matrix((n, 2)), -at.free]).tocsr()
    width = noise.shape[1]
    every = sparse.identity(width, format="csr")
    change, size, over = every[:m], every[m : m + 1], every[m + 1 : m + 2]
    ones = sparse.csr_matrix(np.ones((m, 1)))
    aim, rows = 1 - MARGIN, []
    if recorded.norm == "peak":
        spare = sparse.csr_matrix(np.ones((2 * n, 1))) @ over
        e = at.e.ravel()
        rows.append(Rows(sparse.vstack([noise, -noise]) - spare, aim + np.concatenate([-e, e]), "positive"))
    else:
        root = float(np.sqrt(recorded.count))
        for j, e in enumerate(at.e.T):
            cone = -sparse.vstack([root * over, noise[j :: at.e.shape[1]]])
            rows.append(Rows(cone, np.concatenate([[root * aim], e]), "second-order", 1 + len(e)))
    held = np.zeros(2 * m) + radius
    sized = np.concatenate([-at.delta, at.delta])
    rows += [
        Rows(sparse.vstack([change, -change]), held, "positive") if radius else Rows(change, np.zeros(m), "zero"),
        Rows(sparse.vstack([change - ones @ size, -change - ones @ size]), sized, "positive"),
        Rows(-over, np.zeros(1), "positive"),
    ]
    cost = np.zeros(width)
    cost[m], cost[m + 1] = 1.0, PRICE
    found = solved_cones(cost, rows, search.budget)
    return None if found is None else (found.x[:m], found.x[m + 2 :])
