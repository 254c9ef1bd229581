r"""Noise that constants leave in each window of a record, with the window's free state fitted.

With w = 0 a window knows of the others only through its initial state, and of that only the part that the outputs show
counts. Where it is free, the windows are fits of a few unknowns each,

.. math:: e_i - F_i \xi_i , \qquad F_i = [C; C A; C A^2; \dots] V ,

by least squares (rms bounds), or in the largest deviation (peak bounds): a linear programme over a few samples at a
time, to which the worst missed one is added until none is left (exchange).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import Recorded, held, powers, shown, states
from robustlab.uncertainty.blocks import Block

__all__ = ["WindowFit", "Windows", "chebyshev"]


ENOUGH = 1e-9
EXCHANGES = 60
# Work of a simulation, besides its samples, and of a fit by linear programmes.
SIMULATION, FITTING = 500, 5000
KEPT_NUMBERS = 4_000_000  # of simulated members that are kept
ILL_POSED = 1e12


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
        self.budget.spend(SIMULATION + 0.3 * samples * len(record.bound))
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
        rest = [e - Q @ (Q.T @ e) for e, Q in zip(at.e, at.basis, strict=True)]
        if self.recorded.norm == "rms":
            return self._rms(rest)
        peaks = np.array([np.abs(r).max(initial=0.0) for r in rest])
        worst, weights = -1.0, {}
        for i in np.argsort(-peaks):
            if peaks[i] <= worst:  # the fit in the largest deviation is not worse than least squares
                break
            size, rest[i], dual = chebyshev(rest[i], at.basis[i])
            self.budget.spend(FITTING if at.basis[i].size else 0)
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


def chebyshev(e: Array, basis: Array) -> tuple[float, Array, Array]:
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
