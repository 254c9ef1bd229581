r"""Smallest constant real parameters that explain a record, by descent: an upper bound of the smallest size.

For fixed delta the noise is affine in the free states: least squares (rms bounds), or a linear programme by exchange
(peak bounds), whose dual weighs a few samples that witness against delta.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import Search
from robustlab.identification.validation.sampled_problem import Recorded, held, powers, shown, states
from robustlab.uncertainty.blocks import Block

WIDEST = 1e3  # parameters beyond this many times their range are not tried
MOVES = 40  # of a descent
MOVE_SAMPLES = 200  # of each window that a move looks at, the largest and as many spread over it
# After so many moves in a row that leave more than this share of what is beyond the noise bound no more is tried.
CREEP, CREEPS = 0.995, 3
EXCHANGES = 60  # of a fit of free states in the largest deviation
PROGRAMME_WORK = 3000.0  # of a linear programme, besides its entries
SIMULATION_WORK = 500.0  # of a simulation, besides its samples
FITTING_WORK = 5000.0  # of a fit by linear programmes

# Rounding in the noise of an explanation, over its bound, and of the fits in the largest deviation.
SLACK = ENOUGH = 1e-9


# --- the noise that constants leave ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Windows:
    """E of each window at its used samples, output after output, and an orthonormal basis of what free states do."""

    e: tuple[Array, ...]
    basis: tuple[Array, ...]


class WindowFit:
    """Noise of a record for values of its real blocks; what it simulates and fits is spent of the budget."""

    def __init__(self, recorded: Recorded, budget: Budget) -> None:
        self.recorded, self.budget, self.count = recorded, budget, recorded.counts
        self.cuts = [slice(a, b) for a, b in pairwise([*recorded.starts, len(recorded.t)])]
        ends = [np.cumsum([0, *recorded.used[cut].sum(axis=0)]) for cut in self.cuts]
        self.outputs = [[slice(a, b) for a, b in pairwise(each)] for each in ends]  # of each window

    def windows(self, delta: Array) -> Windows | None:
        """The windows at delta; None where it is ill-posed or its responses outgrow every number."""
        record = self.recorded
        self.budget.spend(SIMULATION_WORK + 0.3 * len(record.t) * len(record.bound))
        names = [b.name for b in record.uncertain.blocks]
        try:
            A, B, C, D = held(record.uncertain.evaluate(dict(zip(names, delta.tolist(), strict=True))), record.dt)
        except NoTrustworthyNumber:
            return None
        C, D = C / record.bound[:, None], D / record.bound[:, None]
        e, basis = [], []
        with np.errstate(over="ignore", invalid="ignore"):
            moved = C @ powers(A, shown(A, C), max(cut.stop - cut.start for cut in self.cuts))  # (longest, n_y, k)
            for i, cut in enumerate(self.cuts):
                u, used = record.u[cut], record.used[cut].T
                response = states(A, u @ B.T, np.zeros(len(A))) @ C.T + u @ D.T
                e.append((record.y[cut] / record.bound - response).T[used])
                rests = i == 0 and record.at_rest
                basis.append(moved[: used.shape[1]].transpose(1, 0, 2)[used][:, : 0 if rests else None])
        if not all(np.isfinite(part).all() for part in (*e, *basis)):
            return None
        return Windows(tuple(e), tuple(_orthonormal(F) for F in basis))

    def excess(self, at: Windows | None) -> tuple[float, list[Array], dict[int, Array]]:
        """Least noise over its bound, the noise of each window, and the dual weights: window -> (its samples,)."""
        if at is None:
            return np.inf, [], {}
        rest: list[Array] = [e - Q @ (Q.T @ e) for e, Q in zip(at.e, at.basis, strict=True)]
        if self.recorded.norm == "rms":
            sizes = self.sizes(rest)
            j, weights = int(np.argmax(sizes)), {}
            for i, parts in enumerate(self.outputs):
                weights[i] = np.zeros_like(rest[i])
                weights[i][parts[j]] = rest[i][parts[j]]
            return float(sizes.max()), rest, weights
        peaks = np.array([np.abs(r).max(initial=0.0) for r in rest])
        worst, weights = -1.0, {}
        for i in np.argsort(-peaks):
            if peaks[i] <= worst:  # the fit in the largest deviation is not worse than least squares
                break
            size, rest[i], dual = _chebyshev(rest[i], at.basis[i])
            self.budget.spend(FITTING_WORK if at.basis[i].size else 0)
            if size > worst:
                worst, weights = size, {int(i): dual}
        return worst, rest, weights

    def sizes(self, noise: Sequence[Array]) -> Array:
        """Noise of each output over its bound."""
        parts = [[x[p] for p in self.outputs[i]] for i, x in enumerate(noise)]
        if self.recorded.norm == "peak":
            return np.array([max(np.abs(w[j]).max(initial=0.0) for w in parts) for j in range(len(self.count))])
        return np.sqrt([sum(float(w[j] @ w[j]) for w in parts) for j in range(len(self.count))] / self.count)

    def whole(self, noise: Sequence[Array]) -> Array:
        """Noise at the used samples as (n, n_y), zero elsewhere."""
        full = np.zeros(self.recorded.used.shape)
        for cut, x in zip(self.cuts, noise, strict=True):
            full[cut].T[self.recorded.used[cut].T] = x
        return full

    def witness(self, weights: Mapping[int, Array], at: Windows) -> float:
        """F: above 1, no noise within the bound explains the record there."""
        gained, norms = 0.0, np.zeros(len(self.count))
        for i, weight in weights.items():
            turned = weight - at.basis[i] @ (at.basis[i].T @ weight)
            gained += float(turned @ at.e[i])
            for j, part in enumerate(self.outputs[i]):
                piece = turned[part]
                norms[j] += np.abs(piece).sum() if self.recorded.norm == "peak" else piece @ piece
        norm = float(norms.sum() if self.recorded.norm == "peak" else np.sqrt(norms) @ np.sqrt(self.count))
        return gained / norm if norm > 0 else 0.0


def _chebyshev(e: Array, basis: Array) -> tuple[float, Array, Array]:
    """Least largest ``|e - basis x|``, the rest, and the dual weights (of sum one, on a few samples)."""
    from scipy.optimize import linprog

    size, k = float(np.abs(e).max(initial=0.0)), basis.shape[1]
    if not k or size == 0.0:
        weights = np.zeros_like(e)
        if len(e):
            worst = int(np.abs(e).argmax())
            weights[worst] = np.sign(e[worst])
        return size, e, weights
    rows, target = basis * np.sqrt(len(e)), e / size
    taken = list(np.argsort(-np.abs(target))[: 4 * (k + 1)])
    taken += [i for i in np.linspace(0, len(e) - 1, 4 * (k + 1)).astype(int) if i not in taken]
    cost, rest, dual = np.append(np.zeros(k), 1.0), target, np.zeros(2 * len(taken))
    judged = list(taken)
    for _ in range(EXCHANGES):
        part = rows[taken]
        one = np.ones((len(taken), 1))
        found = linprog(
            cost,
            np.vstack([np.hstack([-part, -one]), np.hstack([part, -one])]),
            np.concatenate([-target[taken], target[taken]]),
            bounds=[(None, None)] * (k + 1),
            method="highs",
        )
        if found.x is None or not np.isfinite(found.x).all():
            raise NoTrustworthyNumber("validate", f"the fit of the free states gave no answer ({found.message})")
        rest, dual, judged = target - rows @ found.x[:-1], -found.ineqlin.marginals, list(taken)
        beyond = np.abs(rest) - found.x[-1]
        if beyond.max() <= ENOUGH:
            break
        missed = [i for i in np.argsort(-beyond)[:8] if beyond[i] > ENOUGH and i not in taken]
        if not missed:
            break
        taken += missed
    weights = np.zeros_like(e)
    np.add.at(weights, judged, dual[: len(judged)] - dual[len(judged) :])
    return float(np.abs(rest).max()) * size, rest * size, weights


def _orthonormal(F: Array) -> Array:
    if not F.size:
        return F
    left, sigma, _ = np.linalg.svd(F, full_matrices=False)
    return left[:, sigma > 1e-11 * sigma[0]] if sigma[0] > 0 else left[:, :0]


# --- the smallest constants ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parameters:
    """What `smallest_parameters` found: the largest ``|delta|`` of the best delta, that delta, and its noise."""

    upper: float
    delta: Array  # normalised values of the real blocks, in order
    noise: Array  # noise that is left (n, n_y), over its bound
    least_excess: float  # smallest noise over its bound that was found anywhere


def smallest_parameters(recorded: Recorded, blocks: Sequence[Block], search: Search) -> Parameters:
    """Smallest known ``|delta|`` over the blocks that are scaled; the others stay within [-1, 1]."""
    fit = WindowFit(recorded, search.budget)
    m = len(blocks)
    zero = fit.excess(fit.windows(np.zeros(m)))
    if zero[0] <= 1 + SLACK:
        return Parameters(0.0, np.zeros(m), fit.whole(zero[1]), zero[0])
    starts = [np.zeros(m)]
    rng = np.random.default_rng(0)
    starts += [rng.uniform(-1, 1, m) for _ in range(3 if m > 1 else 1)]
    best: tuple[float, Array] = (np.inf, np.zeros(m))
    least = zero[0]
    for start in starts:
        found, excess = _descend(fit, start, search)
        least = min(least, excess)
        size = _size(found, search) if excess <= 1 + SLACK else np.inf
        if size < best[0]:
            best = size, found
    _, noise, _ = fit.excess(fit.windows(best[1]))
    return Parameters(best[0], best[1], fit.whole(noise), least)


def _size(delta: Array, search: Search) -> float:
    scaled = search.scaled
    if (np.abs(delta[~scaled]) > 1 + 1e-9).any():
        return np.inf
    return float(np.abs(delta[scaled]).max(initial=0.0))


def _descend(fit: WindowFit, delta: Array, search: Search) -> tuple[Array, float]:
    """Successive linear programmes: first into the noise bound, then to the smallest delta."""
    at = fit.windows(delta)
    excess, noise, _ = fit.excess(at)
    radius, m = 0.5, len(delta)
    best, creeps = (np.inf, delta, excess), 0
    for _ in range(MOVES):
        if creeps >= CREEPS or at is None or search.budget.over:
            break
        step = 1e-5 * max(1.0, float(np.abs(delta).max(initial=0.0)))
        sides = [fit.windows(delta + s * step * unit) for unit in np.eye(m) for s in (1, -1)]
        known = [side for side in sides if side is not None]
        if len(known) < len(sides):
            break
        pairs = list(zip(known[::2], known[1::2], strict=True))
        lean: list[Array] = [
            np.column_stack([(ahead.e[i] - back.e[i]) / (2 * step) for ahead, back in pairs]) for i in range(len(noise))
        ]
        move = _linear_move(fit, delta, noise, lean, at.basis, search, radius)
        if move is None:
            break
        new = delta + move
        new_at = fit.windows(new)
        new_excess, new_noise, _ = fit.excess(new_at)
        was, now = max(excess - 1, 0.0) * 1e4, max(new_excess - 1, 0.0) * 1e4
        creeps = creeps + 1 if now > CREEP * was > 0 else 0
        gain = was + _size(delta, search) - now - _size(new, search)
        if new_excess <= 1 + SLACK and _size(new, search) < best[0]:
            best = _size(new, search), new, new_excess
        if gain > 0:
            moved = float(np.abs(new - delta).max())
            delta, at, excess, noise = new, new_at, new_excess, new_noise
            radius = min(2 * radius, max(4 * moved, 1e-3), WIDEST)
            small = moved < 0.02 * search.precision * max(_size(delta, search), 1e-9)
            if small and (excess <= 1 + SLACK or moved < 1e-9):
                break
        else:
            radius /= 4
            if radius < 1e-9:
                break
    return (best[1], best[2]) if np.isfinite(best[0]) else (delta, excess)


def _linear_move(
    fit: WindowFit, delta: Array, noise: list[Array], lean: list[Array], basis: tuple[Array, ...], search: Search,
    radius: float,
) -> Array | None:  # fmt: skip
    """Change of delta that the linearised problem asks for, over some samples of each window; None without an answer.

    Variables: change of delta, size of delta, excess of the noise, free states of each window. What the other samples
    say the move itself shows: it is taken only where it gains.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    m, scaled = len(delta), search.scaled
    limits = [_peaks(fit, noise, i) for i in range(len(noise))]
    taken = [np.unique([*np.argsort(-np.abs(x / limit))[:MOVE_SAMPLES],
                        *np.linspace(0, len(x) - 1, min(len(x), MOVE_SAMPLES)).astype(int)]).astype(int)
             for x, limit in zip(noise, limits, strict=True)]  # fmt: skip
    free = [-np.sqrt(len(Q)) * Q[rows] for Q, rows in zip(basis, taken, strict=True)]
    n = sum(map(len, taken))
    moved = sparse.hstack([
        np.concatenate([part[rows] for part, rows in zip(lean, taken, strict=True)]), sparse.csr_matrix((n, 2)),
        sparse.block_diag(free),
    ]).tocsr()  # fmt: skip
    width = m + 2 + sum(part.shape[1] for part in free)
    spare = sparse.csr_matrix((np.ones(n), (np.arange(n), np.full(n, m + 1))), (n, width))
    here, limit = (np.concatenate([x[rows] for x, rows in zip(part, taken, strict=True)]) for part in (noise, limits))
    room, signs = np.where(scaled, 0.0, 1.0), np.where(scaled, -1.0, 0.0)
    box = np.zeros((2 * m, width))
    box[:, :m], box[:, m] = np.vstack([np.eye(m), -np.eye(m)]), np.concatenate([signs, signs])
    matrix = sparse.vstack([moved - spare, -moved - spare, sparse.csr_matrix(box)])
    right = np.concatenate([limit - here, limit + here, room - delta, room + delta])
    cost = np.zeros(width)
    cost[m], cost[m + 1] = 1.0, 1e4
    bounds = [(-radius, radius)] * m + [(0, WIDEST), (0, None)] + [(None, None)] * (len(cost) - m - 2)
    found = linprog(cost, matrix, right, bounds=bounds, method="highs")
    fit.budget.spend(PROGRAMME_WORK + matrix.nnz)
    return None if found.x is None or not np.isfinite(found.x).all() else np.asarray(found.x[:m])


def _peaks(fit: WindowFit, noise: list[Array], window: int) -> Array:
    """What each sample may be off: 1 for peak bounds; for rms those of the present noise, scaled into the bound."""
    x = noise[window]
    if fit.recorded.norm == "peak":
        return np.full(len(x), 1 - 1e-7)
    allowed = np.empty_like(x)
    for part, size in zip(fit.outputs[window], fit.sizes(noise), strict=True):
        allowed[part] = 0.999 * (np.abs(x[part]) / max(size, 1e-12) + 1e-9)
    return allowed
