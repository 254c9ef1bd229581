r"""Smallest constant real parameters that explain a record, by descent: an upper bound of the smallest size.

For fixed :math:`\delta` the noise is affine in the free states: windows with free starts are fits
:math:`e_i - F_i \xi_i` of a few unknowns each, by least squares (rms bounds) or in the largest deviation (peak bounds,
a linear programme by exchange). The dual gives weights of a few samples that witness against :math:`\delta`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import Search
from robustlab.identification.validation.sampled_problem import Recorded, held, powers, shown, states
from robustlab.uncertainty.blocks import Block

WIDEST = 1e3  # parameters beyond this many times their range are not tried
MOVES = 40  # of a descent
MOVE_EXCHANGES = 20  # programmes over a few samples each, of one move
# After so many moves in a row that leave more than this share of what is beyond the noise bound no more is tried.
CREEP = 0.995
CREEPS = 3
FIT_EXCHANGES = 60  # of a fit of free states in the largest deviation
KEPT_NUMBERS = 4_000_000  # of simulated members that are kept in memory: more, fewer simulations
PROGRAMME_WORK = 3000.0  # of a linear programme, besides its entries
SIMULATION_WORK = 500.0  # of a simulation, besides its samples
FITTING_WORK = 5000.0  # of a fit by linear programmes

# Rounding in the noise of an explanation, over its bound, and of the fits in the largest deviation.
SLACK = ENOUGH = 1e-9
# A loop whose condition is larger counts as ill-posed.
ILL_POSED = 1e12


# --- the noise that constants leave ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Windows:
    """E of each window at its used samples, output after output, and an orthonormal basis of what free states do."""

    e: tuple[Array, ...]
    basis: tuple[Array, ...]


@dataclass(frozen=True)
class Member:
    """State-space matrices and the sample time (0: continuous)."""

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float


class WindowFit:
    """Noise of a record for values of its real blocks; what it simulates and fits is spent of the budget."""

    def __init__(self, recorded: Recorded, blocks: Sequence[Block], budget: Budget) -> None:
        self.recorded, self.blocks, self.budget = recorded, blocks, budget
        ends = [*recorded.starts[1:], len(recorded.t)]
        self.cuts = [slice(a, b) for a, b in zip(recorded.starts, ends, strict=True)]
        self.count = recorded.counts
        self._repeats = [b.rows for b in blocks]
        self._known: dict[tuple[bytes, tuple[int, ...]], Windows | None] = {}
        self._kept = max(16, KEPT_NUMBERS // (recorded.used.size + 1))

    @property
    def every(self) -> tuple[int, ...]:
        """All windows."""
        return tuple(range(len(self.cuts)))

    def windows(self, delta: Array, which: Sequence[int] | None = None) -> Windows | None:
        """The windows at delta, or the named ones; None where delta is ill-posed."""
        chosen = self.every if which is None else tuple(which)
        key = np.asarray(delta, dtype=np.float64).tobytes(), chosen
        if key not in self._known:  # boxes that touch share their corners
            if len(self._known) >= self._kept:
                self._known.clear()
            self._known[key] = self._simulated(delta, chosen)
        return self._known[key]

    def _simulated(self, delta: Array, chosen: tuple[int, ...]) -> Windows | None:
        record = self.recorded
        samples = sum(self.cuts[i].stop - self.cuts[i].start for i in chosen)
        self.budget.spend(SIMULATION_WORK + 0.3 * samples * len(record.bound))
        closed = self._member(delta)
        if closed is None:
            return None
        try:
            A, B, C, D = held(closed, record.dt)
        except NoTrustworthyNumber:
            return None
        C, D = C / record.bound[:, None], D / record.bound[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            responses = self._forced(A, B, C, D, chosen)
            free = shown(A, C)
            longest = max(self.cuts[i].stop - self.cuts[i].start for i in chosen)
            moved = C @ powers(A, free, longest)  # (longest, n_y, k)
        if not np.isfinite(moved).all() or not all(np.isfinite(r).all() for r in responses):
            return None
        bases: dict[bytes, Array] = {}
        e, basis = [], []
        for i, response in zip(chosen, responses, strict=True):
            cut = self.cuts[i]
            used = record.used[cut].T
            e.append((record.y[cut] / record.bound - response).T[used])
            if i == 0 and record.at_rest:
                basis.append(np.zeros((len(e[-1]), 0)))
                continue
            key = used.tobytes()
            if key not in bases:
                bases[key] = _orthonormal(moved[: used.shape[1]].transpose(1, 0, 2)[used])
            basis.append(bases[key])
        return Windows(tuple(e), tuple(basis))

    def _member(self, delta: Array) -> Member | None:
        """``F_u(M, Delta)`` as plain matrices; None where it is (nearly) ill-posed."""
        M = self.recorded.uncertain.M
        if not self.blocks:
            return Member(M.A, M.B, M.C, M.D, M.dt)
        each = np.repeat(np.asarray(delta, dtype=np.float64), self._repeats)
        q = len(each)
        loop = np.eye(q) - each[:, None] * M.D[:q, :q]
        if np.linalg.cond(loop) > ILL_POSED:
            return None
        gain = np.linalg.solve(loop, np.diag(each))  # w = gain (C1 x + D12 u)
        B1, C1, D12, D21 = M.B[:, :q], M.C[:q], M.D[:q, q:], M.D[q:, :q]
        return Member(
            M.A + B1 @ gain @ C1, M.B[:, q:] + B1 @ gain @ D12, M.C[q:] + D21 @ gain @ C1,
            M.D[q:, q:] + D21 @ gain @ D12, M.dt,
        )  # fmt: skip

    def _forced(self, A: Array, B: Array, C: Array, D: Array, which: Sequence[int]) -> list[Array]:
        """Response of each window from the state zero, (length, n_y); windows of one length run side by side."""
        record = self.recorded
        found: dict[int, Array] = {}
        for _, same in itertools.groupby(
            sorted(which, key=lambda i: (self.cuts[i].stop - self.cuts[i].start, i)),
            key=lambda i: self.cuts[i].stop - self.cuts[i].start,
        ):
            group = list(same)
            u = np.stack([record.u[self.cuts[i]] for i in group])
            drive = u @ B.T
            if len(group) == 1:
                x = states(A, drive[0], np.zeros(len(A)))[None]
            else:
                x = np.zeros((*drive.shape[:2], len(A)))
                for t in range(drive.shape[1] - 1):
                    x[:, t + 1] = x[:, t] @ A.T + drive[:, t]
            found.update(zip(group, x @ C.T + u @ D.T, strict=True))
        return [found[i] for i in which]

    def excess(self, at: Windows | None) -> tuple[float, list[Array], dict[int, Array]]:
        """Least noise over its bound, the noise of each window, and the dual weights: window -> (its samples,)."""
        if at is None:
            return np.inf, [], {}
        rest: list[Array] = [e - Q @ (Q.T @ e) for e, Q in zip(at.e, at.basis, strict=True)]
        if self.recorded.norm == "rms":
            return self._rms(rest)
        peaks = np.array([np.abs(r).max(initial=0.0) for r in rest])
        worst, weights = -1.0, {}
        for i in np.argsort(-peaks):
            if peaks[i] <= worst:  # the fit in the largest deviation is not worse than least squares
                break
            size, rest[i], dual = _chebyshev(rest[i], at.basis[i], FIT_EXCHANGES)
            self.budget.spend(FITTING_WORK if at.basis[i].size else 0)
            if size > worst:
                worst, weights = size, {int(i): dual}
        return worst, rest, weights

    def _rms(self, rest: list[Array]) -> tuple[float, list[Array], dict[int, Array]]:
        sizes = self.sizes(rest)
        j = int(np.argmax(sizes))
        weights = {}
        for i in self.every:
            part = self.outputs(i)[j]
            weights[i] = np.zeros_like(rest[i])
            weights[i][part] = rest[i][part]
        return float(sizes.max()), rest, weights

    def outputs(self, window: int) -> list[slice]:
        """Samples of each output in a window."""
        ends = np.cumsum([0, *self.recorded.used[self.cuts[window]].sum(axis=0)])
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    def sizes(self, noise: Sequence[Array]) -> Array:
        """Noise of each output over its bound."""
        parts = [[x[p] for p in self.outputs(i)] for i, x in enumerate(noise)]
        if self.recorded.norm == "peak":
            return np.array([max(np.abs(w[j]).max(initial=0.0) for w in parts) for j in range(len(self.count))])
        return np.sqrt([sum(float(w[j] @ w[j]) for w in parts) for j in range(len(self.count))] / self.count)

    def whole(self, noise: Sequence[Array]) -> Array:
        """Noise at the used samples as (n, n_y), zero elsewhere."""
        full = np.zeros(self.recorded.used.shape)
        for cut, x in zip(self.cuts, noise, strict=True):
            full[cut].T[self.recorded.used[cut].T] = x
        return full

    def witness(self, weights: Mapping[int, Array], delta: Array) -> float:
        """F(delta): above 1, no noise within the bound explains the record at delta."""
        at = self.windows(delta, tuple(weights))
        if at is None:
            return np.inf
        gained, norms = 0.0, np.zeros(len(self.count))
        for (i, weight), e, Q in zip(weights.items(), at.e, at.basis, strict=True):
            turned = weight - Q @ (Q.T @ weight)
            gained += float(turned @ e)
            for j, part in enumerate(self.outputs(i)):
                piece = turned[part]
                norms[j] += np.abs(piece).sum() if self.recorded.norm == "peak" else piece @ piece
        norm = float(norms.sum() if self.recorded.norm == "peak" else np.sqrt(norms) @ np.sqrt(self.count))
        return gained / norm if norm > 0 else 0.0


def _chebyshev(e: Array, basis: Array, exchanges: int) -> tuple[float, Array, Array]:
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
    for _ in range(exchanges):
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
    fit = WindowFit(recorded, blocks, search.budget)
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
        sides = [[fit.windows(delta + s * step * np.eye(m)[k]) for s in (1, -1)] for k in range(m)]
        if any(side is None for pair in sides for side in pair):
            break
        lean: list[Array] = [
            np.column_stack([(ahead.e[i] - back.e[i]) / (2 * step) for ahead, back in sides])  # pyright: ignore[reportOptionalMemberAccess]
            for i in fit.every
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
            if moved < 0.02 * search.precision * max(_size(delta, search), 1e-9) and (
                excess <= 1 + SLACK or moved < 1e-9
            ):
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
    search: Search,
    radius: float,
) -> Array | None:
    """Change of delta that the linearised problem asks for; a programme over a few samples of each window at a time.

    Variables: change of delta, size of delta, excess of the noise, free states of each window.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    m, scaled = len(delta), search.scaled
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
    for _ in range(MOVE_EXCHANGES):
        moved = _rows_of(taken, lean, basis, starts)
        at = np.arange(moved.shape[0]), np.full(moved.shape[0], m + 1)
        spare = sparse.csr_matrix((np.ones(moved.shape[0]), at), moved.shape)
        here = np.concatenate([each[rows] for each, rows in zip(noise, taken, strict=True)])
        limit = np.concatenate([each[rows] for each, rows in zip(limits, taken, strict=True)])
        matrix = sparse.vstack([moved - spare, -moved - spare, sparse.csr_matrix(box)])
        right = np.concatenate([limit - here, limit + here, room - delta, room + delta])
        found = linprog(cost, matrix, right, bounds=bounds, method="highs")
        fit.budget.spend(PROGRAMME_WORK + matrix.nnz)
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


def _rows_of(taken: list[list[int]], lean: list[Array], basis: tuple[Array, ...], starts: Indices) -> Any:
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
