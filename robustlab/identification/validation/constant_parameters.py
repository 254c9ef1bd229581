r"""Smallest constant real parameters that explain a record: descent from above, branch and bound from below.

For fixed :math:`\delta` the noise is affine in the free states, so whether :math:`\delta` explains the record is a
Chebyshev (or least-squares) fit. Its dual gives weights :math:`\lambda` of a few samples, orthogonal to what free
states can do, with :math:`\lambda^T e(\delta) > \|\lambda\|_*`: a witness against :math:`\delta`. Projected anew,
the same weights are a witness at other :math:`\delta` as long as

.. math:: F(\delta) = \lambda^T P(\delta) e(\delta) / \|P(\delta) \lambda\|_* > 1 .

A box is closed where one witness holds at all points of a grid of 3 in each direction, with a quarter of its variation
to spare (a parabola dips by at most an eighth of its variation between three such points). Between the points nothing
is proved: the lower bound is labelled so.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.identification.validation.sampled_problem import Recorded
from robustlab.identification.validation.window_fit import WindowFit
from robustlab.uncertainty.blocks import Block

__all__ = ["Parameters", "smallest_parameters"]


SPARE = 0.25
WIDEST = 1e3  # parameters beyond this many times their range are not tried
SLACK = 1e-9
MOVES, EXCHANGES, FEW = 40, 20, 60
# Work of a linear programme, besides its entries.
PROGRAMME = 3000
# After so many moves in a row that leave more than this share of what is beyond the noise bound no more is tried.
CREEP, CREEPS = 0.995, 3


@dataclass(frozen=True)
class Parameters:
    """What `smallest_parameters` found: bounds of the largest ``|delta|``, the best delta, and its noise.

    Attributes
    ----------
    lower, upper
        Bounds; the lower one from boxes that were tested at points.
    delta
        Normalised values of the real blocks, in order.
    noise
        Noise that is left (n, n_y), over its bound.
    boxes
        How many boxes were examined.
    finished
        Whether the search came to its end before its budget did.
    least_excess
        Smallest noise over its bound that was found anywhere.
    """

    lower: float
    upper: float
    delta: Array
    noise: Array
    boxes: int
    finished: bool
    least_excess: float


def smallest_parameters(
    recorded: Recorded, blocks: Sequence[Block], scaled: NDArray[np.bool_], precision: float, budget: Budget
) -> Parameters:
    """Bounds of the largest ``|delta|`` over the blocks that ``scaled`` names; the others stay within [-1, 1]."""
    fit = WindowFit(recorded, blocks, budget)
    m = len(blocks)
    zero = fit.excess(fit.windows(np.zeros(m)))
    if zero[0] <= 1 + SLACK:
        return Parameters(0.0, 0.0, np.zeros(m), fit.whole(zero[1]), 1, True, zero[0])
    starts = [np.zeros(m)]
    rng = np.random.default_rng(0)
    starts += [rng.uniform(-1, 1, m) for _ in range(3 if m > 1 else 1)]
    best: tuple[float, Array] = (np.inf, np.zeros(m))
    least = zero[0]
    for k, start in enumerate(starts):
        found, excess = _descend(fit, start, scaled, precision, budget)
        least = min(least, excess)
        size = _size(found, scaled) if excess <= 1 + SLACK else np.inf
        if size < best[0]:
            best = size, found
        if k == 0 and np.isinf(size):  # often a few boxes show that there is nothing to be found
            tried = _branch(fit, best, least, scaled, precision, budget, FEW)
            if tried.finished:
                return tried
    return _branch(fit, best, least, scaled, precision, budget)


def _size(delta: Array, scaled: NDArray[np.bool_]) -> float:
    if (np.abs(delta[~scaled]) > 1 + 1e-9).any():
        return np.inf
    return float(np.abs(delta[scaled]).max(initial=0.0))


def _descend(
    fit: WindowFit, delta: Array, scaled: NDArray[np.bool_], precision: float, budget: Budget
) -> tuple[Array, float]:
    """Successive linear programmes: first into the noise bound, then to the smallest delta."""
    at = fit.windows(delta)
    excess, noise, _ = fit.excess(at)
    radius, m = 0.5, len(delta)
    best, creeps = (np.inf, delta, excess), 0
    for _ in range(MOVES):
        if creeps >= CREEPS or at is None or budget.over:
            break
        step = 1e-5 * max(1.0, float(np.abs(delta).max(initial=0.0)))
        sides = [[fit.windows(delta + s * step * np.eye(m)[k]) for s in (1, -1)] for k in range(m)]
        if any(side is None for pair in sides for side in pair):
            break
        lean = [
            np.column_stack([(ahead.e[i] - back.e[i]) / (2 * step) for ahead, back in sides])  # pyright: ignore[reportOptionalMemberAccess]
            for i in fit.every
        ]
        move = _linear_move(fit, delta, noise, lean, at.basis, scaled, radius)
        if move is None:
            break
        new = delta + move
        new_at = fit.windows(new)
        new_excess, new_noise, _ = fit.excess(new_at)
        was, now = max(excess - 1, 0.0) * 1e4, max(new_excess - 1, 0.0) * 1e4
        creeps = creeps + 1 if now > CREEP * was > 0 else 0
        gain = was + _size(delta, scaled) - now - _size(new, scaled)
        if new_excess <= 1 + SLACK and _size(new, scaled) < best[0]:
            best = _size(new, scaled), new, new_excess
        if gain > 0:
            moved = float(np.abs(new - delta).max())
            delta, at, excess, noise = new, new_at, new_excess, new_noise
            radius = min(2 * radius, max(4 * moved, 1e-3), WIDEST)
            if moved < 0.02 * precision * max(_size(delta, scaled), 1e-9) and (excess <= 1 + SLACK or moved < 1e-9):
                break
        else:
            radius /= 4
            if radius < 1e-9:
                break
    return (best[1], best[2]) if np.isfinite(best[0]) else (delta, excess)


def _linear_move(
    fit: WindowFit,
    delta: Array,
    noise: list[Array],
    lean: list[Array],
    basis: tuple[Array, ...],
    scaled: NDArray[np.bool_],
    radius: float,
) -> Array | None:
    """Change of delta that the linearised problem asks for; a programme over a few samples of each window at a time.

    Variables: change of delta, size of delta, excess of the noise, free states of each window.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    m = len(delta)
    limits = [_peaks(fit, noise, i) for i in fit.every]
    taken = [_first_samples(x / limit, m + Q.shape[1]) for x, limit, Q in zip(noise, limits, basis, strict=True)]
    starts = np.cumsum([m + 2, *(Q.shape[1] for Q in basis)])
    signs = np.where(scaled, -1.0, 0.0)[:, None]
    box = np.hstack(
        [np.vstack([np.eye(m), -np.eye(m)]), np.vstack([signs, signs]), np.zeros((2 * m, starts[-1] - m - 1))]
    )
    room = np.where(scaled, 0.0, 1.0)
    cost = np.zeros(starts[-1])
    cost[m], cost[m + 1] = 1.0, 1e4
    bounds = [(-radius, radius)] * m + [(0, WIDEST), (0, None)] + [(None, None)] * int(starts[-1] - m - 2)
    x = np.zeros(0)
    for _ in range(EXCHANGES):
        moved = _rows_of(taken, lean, basis, starts)
        at = np.arange(moved.shape[0]), np.full(moved.shape[0], m + 1)
        spare = sparse.csr_matrix((np.ones(moved.shape[0]), at), moved.shape)
        here = np.concatenate([each[rows] for each, rows in zip(noise, taken, strict=True)])
        limit = np.concatenate([each[rows] for each, rows in zip(limits, taken, strict=True)])
        matrix = sparse.vstack([moved - spare, -moved - spare, sparse.csr_matrix(box)])
        right = np.concatenate([limit - here, limit + here, room - delta, room + delta])
        found = linprog(cost, matrix, right, bounds=bounds, method="highs")
        fit.budget.spend(PROGRAMME + matrix.nnz)
        if found.x is None or not np.isfinite(found.x).all():
            return None
        x, missed = np.asarray(found.x), 0
        for i, rows in enumerate(taken):
            after = noise[i] + lean[i] @ x[:m]
            after -= basis[i] @ x[starts[i] : starts[i + 1]] * np.sqrt(len(after))
            beyond = np.abs(after) - limits[i] - x[m + 1]
            worst = [k for k in np.argsort(-beyond)[:3] if beyond[k] > 1e-8]
            missed += len(set(worst) - set(rows))
            taken[i] = sorted({*rows, *worst})
        if not missed:
            break
    return x[:m]


def _rows_of(taken: list[list[int]], lean: list[Array], basis: tuple[Array, ...], starts: NDArray[np.int_]) -> Any:
    """Change of the noise at the taken samples: sparse, (samples, variables)."""
    from scipy import sparse

    counts = [len(rows) for rows in taken]
    m = lean[0].shape[1]
    first = np.concatenate([part[rows] for part, rows in zip(lean, taken, strict=True)])
    data, at_row, at_col = [first.ravel()], [np.arange(len(first)).repeat(m)], [np.tile(np.arange(m), len(first))]
    top = 0
    for i, rows in enumerate(taken):
        k = basis[i].shape[1]
        data.append((-np.sqrt(len(basis[i])) * basis[i][rows]).ravel())
        at_row.append((top + np.arange(counts[i])).repeat(k))
        at_col.append(np.tile(starts[i] + np.arange(k), counts[i]))
        top += counts[i]
    where = np.concatenate(at_row), np.concatenate(at_col)
    return sparse.csr_matrix((np.concatenate(data), where), (top, int(starts[-1])))


def _first_samples(noise: Array, count: int) -> list[int]:
    """The largest samples, and some spread over the window."""
    largest = np.argsort(-np.abs(noise))[: 2 * count + 2]
    spread = np.linspace(0, len(noise) - 1, 2 * count + 2) if len(noise) else []
    return sorted({*map(int, largest), *map(int, spread)})


def _peaks(fit: WindowFit, noise: list[Array], window: int) -> Array:
    """What each sample may be off: 1 for peak bounds; for rms those of the present noise, scaled into the bound."""
    x = noise[window]
    if fit.recorded.norm == "peak":
        return np.full(len(x), 1 - 1e-7)
    allowed = np.empty_like(x)
    for part, size in zip(fit.outputs(window), fit.sizes(noise), strict=True):
        allowed[part] = 0.999 * (np.abs(x[part]) / max(size, 1e-12) + 1e-9)
    return allowed


def _branch(
    fit: WindowFit,
    best: tuple[float, Array],
    least: float,
    scaled: NDArray[np.bool_],
    precision: float,
    budget: Budget,
    most: float = np.inf,
) -> Parameters:
    """Branch and bound over delta, boxes nearest to nominal first; not finished where ``most`` boxes are not enough."""
    m = len(fit.blocks)
    points = np.array([q for q in itertools.product((-1.0, 1.0, 0.0), repeat=m) if any(q)])
    counter = itertools.count()
    outer = np.where(scaled, WIDEST if not np.isfinite(best[0]) else best[0], 1.0)
    outer = np.where(scaled & (outer > 4.0) & (not np.isfinite(best[0])), 4.0, outer)
    heap: list[tuple[float, int, Array, Array]] = [(0.0, next(counter), np.zeros(m), outer)]
    reach = float(outer[scaled].max(initial=0.0))
    boxes, lower, finished = 0, 0.0, True
    while heap:
        nearest, _, centre, half = heapq.heappop(heap)
        lower = max(lower, nearest)
        if nearest >= best[0] * (1 - precision):
            lower = min(nearest, best[0])
            break
        if boxes >= most or budget.over:
            finished = False
            break
        boxes += 1
        excess, _, weights = fit.excess(fit.windows(centre))
        least = min(least, excess)
        if excess <= 1 + SLACK:
            size = _size(centre, scaled)
            best = min(best, (size, centre), key=lambda pair: pair[0])
        else:
            values = [fit.witness(weights, centre)]
            for q in points:  # a box that holds a point without witness is not worth the others
                values.append(fit.witness(weights, centre + half * q))
                if values[-1] <= 1:
                    break
            if min(values) - SPARE * (max(values) - min(values)) > 1:
                continue
        k = int(np.argmax(half))
        for side in (-0.5, 0.5):
            part, middle = half.copy(), centre.copy()
            part[k] *= 0.5
            middle[k] += side * half[k]
            inner = np.maximum(np.abs(middle) - part, 0.0)
            near = float(inner[scaled].max(initial=0.0))
            if near < best[0]:
                heapq.heappush(heap, (near, next(counter), middle, part))
    else:
        lower = best[0] if np.isfinite(best[0]) else reach
    _, noise, _ = fit.excess(fit.windows(best[1]))
    return Parameters(float(lower), float(best[0]), best[1], fit.whole(noise), boxes, finished, float(least))
