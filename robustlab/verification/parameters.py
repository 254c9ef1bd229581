"""Gain of a model with time-varying parameters, for all their trajectories, between grid points too.

The model and P are multi-linear in the cells of a grid, the model to within a bound E, entry by entry; the theorem with
its proof is in theorems.md, in the same symbols. A loop is that of a plant and a controller u = K(rho) y,
multi-linear on the same grid; it is multi-linear too where B2, D12, C2, D21 are constant and D22 = 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import Matrix, definite, exact, identity, part, stack, zeros
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar, whole
from robustlab.verification.norms import climb

SIGNED = 3  # entries of E up to which every choice of signs is tested
MOST = 6  # parameters

Index = tuple[int, ...]
Stack = Mapping[Index, Matrix]  # a matrix for each point of the grid


def prove_parameters(claim: Claim, work: Work) -> Verdict:
    """Prove a gain of at most ``gamma`` for all trajectories within the ranges and the bounds ``rate`` (k,) of rates.

    Model: ``points0``, ``points1``, ... (n_i,), ascending; ``n`` states; ``M`` (n_1, ..., n_k, n + n_y, n + n_u) at
    them, or a plant ``M`` with the controller ``K`` of ``n_K`` states, ``n_meas`` and ``n_con``; ``deviation``
    (n_1 - 1, ..., n_k - 1, rows, columns of M) the bound of E. Evidence: ``P`` (n_1 or 1, ..., n_k or 1, n, n).
    """
    rates: list[float] = real(claim, "rate", (None,), infinite=True).tolist()
    k = len(rates)
    if not 0 < k <= MOST or not all(rate >= 0 for rate in rates):
        raise InputError("rate", f"{rates}", f"1 to {MOST} numbers not below zero")
    places: list[list[float]] = [real(claim, f"points{i}", (None,)).tolist() for i in range(k)]
    if not all(len(p) > 1 and all(a < b for a, b in pairwise(p)) for p in places):
        raise InputError("points", f"{places}", "at least two for each parameter, ascending")
    grid, gamma = tuple(len(p) for p in places), scalar(claim, "gamma")
    n, M = _size(claim, "n"), real(claim, "M", (*grid, None, None))
    cells = tuple(size - 1 for size in grid)
    deviation = real(claim, "deviation", (*cells, *M.shape[-2:])) if "deviation" in claim.numbers else None
    if deviation is not None and (deviation < 0).any():
        raise InputError("deviation", "a number below zero", "bounds of absolute values")
    n_K = _size(claim, "n_K") if "K" in claim.numbers else 0
    P = real(claim, "P", (*(None,) * k, n + n_K, n + n_K))
    varies = [size > 1 for size in P.shape[:k]]
    for i, v in enumerate(varies):
        if (v and (P.shape[i] != grid[i] or math.isinf(rates[i]))) or min(M.shape[-2:]) < n:
            raise InputError("P", f"shape {P.shape} over a grid {grid}", "1, or the grid where the rate has a bound")
    if not (np.swapaxes(P, -1, -2) == P).all():
        raise InputError("P", "not symmetric to the last bit", "symmetric matrices")

    def attempt() -> Verdict:
        models: Stack = {at: exact(np.ascontiguousarray(M[at])) for at in np.ndindex(*grid)}
        bounds: Mapping[Index, NDArray[np.float64]] = {}
        if deviation is not None:
            bounds = {cell: deviation[cell] for cell in np.ndindex(*cells)}
        if "K" in claim.numbers:
            models, bounds = _loops(claim, M, bounds, n, n_K)
        squares = {at: exact(np.ascontiguousarray(P[at])) for at in np.ndindex(*P.shape[:k])}
        for at, X in squares.items():
            work.spend(n + n_K)
            if not definite(X).proved:
                return not_proved(f"P > 0 was not proved at the point {at}")
        for cell in np.ndindex(*cells):
            lengths = [arb(p[i + 1]) - arb(p[i]) for p, i in zip(places, cell, strict=True)]
            for shift in _shifts(bounds.get(cell)):
                for L in _coefficients(cell, models, squares, varies, rates, lengths, shift, gamma):
                    work.spend(L.nrows())
                    answer = definite(L)
                    if not answer.proved:
                        return not_proved(f"cell {cell}: smallest eigenvalue {answer.least:.3g} of its size")
        return PROVED

    return climb(attempt)


def _size(claim: Claim, name: str) -> int:
    count = int(whole(claim, name, ()))
    if count < 0:
        raise InputError(name, f"{count}", "a number not below zero")
    return count


def _shifts(bound: NDArray[np.float64] | None) -> Iterator[Matrix | None]:
    """Yield matrices whose convex hull contains every E within its bound."""
    if bound is None or not bound.any():
        yield None
        return
    places = np.argwhere(bound > 0)
    if len(places) > SIGNED:
        yield arb_mat(len(bound), len(bound.T), [arb(0, x) for x in bound.ravel().tolist()])
        return
    for signs in product((1.0, -1.0), repeat=len(places)):
        E = np.zeros_like(bound)
        for (i, j), sign in zip(places, signs, strict=True):
            E[i, j] = sign * bound[i, j]
        yield exact(E)


def _coefficients(
    cell: Index, models: Stack, squares: Stack, varies: Sequence[bool], rates: Sequence[float],
    lengths: Sequence[arb], shift: Matrix | None, gamma: float,
) -> Iterator[Matrix]:  # fmt: skip
    """Yield L_c of a cell, each c and each choice of extreme rates. Where P is constant, c = 1 is a mean of others."""
    k, n = len(cell), next(iter(squares.values())).nrows()
    ends = [(1, -1) if v and rate else (0,) for v, rate in zip(varies, rates, strict=True)]
    for c in product(*((0, 1, 2) if v else (0, 2) for v in varies)):
        pairs = list(product(*(((0, 1), (1, 0)) if x == 1 else ((x // 2, x // 2),) for x in c)))
        means: list[Any] = [0, 0, [0] * k]  # of P [A B], of [C D], of the derivatives of P
        for pair in pairs:
            M = models[tuple(a + v for a, (v, _) in zip(cell, pair, strict=True))]
            M = M if shift is None else M + shift
            w = [a + b if moves else 0 for a, (_, b), moves in zip(cell, pair, varies, strict=True)]
            P, share = squares[tuple(w)], arb(1) / len(pairs)
            means[0] += P * part(M, slice(0, n), slice(None)) * share
            means[1] += part(M, slice(n, None), slice(None)) * share
            for i in range(k):
                if varies[i]:
                    high, low = ((*w[:i], cell[i] + end, *w[i + 1 :]) for end in (1, 0))
                    means[2][i] += (squares[high] - squares[low]) * (share / lengths[i])
        for signs in product(*ends):
            motion = sum((means[2][i] * (arb(rates[i]) * s) for i, s in enumerate(signs) if s), zeros(n, n))
            yield _dissipation(means[0], means[1], motion, gamma)


def _dissipation(PAB: Matrix, CD: Matrix, motion: Matrix, gamma: float) -> Matrix:
    """Return L from P [A B] (n, n + n_u), [C D] and the derivative of P."""
    n, u, y = PAB.nrows(), PAB.ncols() - PAB.nrows(), CD.nrows()
    half = stack([[PAB, zeros(n, y)], [zeros(u, n + u + y)], [stack([[CD, zeros(y, y)]])]])
    level = identity(u + y) * arb(gamma)
    whole_motion = stack([[motion, zeros(n, u + y)], [zeros(u + y, n), -level]])
    return -half - half.transpose() - whole_motion


def _loops(
    claim: Claim, M: NDArray[np.float64], bounds: Mapping[Index, NDArray[np.float64]], n: int, n_K: int
) -> tuple[Stack, Mapping[Index, NDArray[np.float64]]]:
    """Return the loop at each point, states of the plant first, and its E. InputError: it is not multi-linear."""
    y, u, grid = _size(claim, "n_meas"), _size(claim, "n_con"), M.shape[:-2]
    z, w = M.shape[-2] - n - y, M.shape[-1] - n - u
    K = real(claim, "K", (*grid, n_K + u, n_K + y))
    if z < 0 or w < 0:
        raise InputError("n_meas, n_con", f"{y}, {u}", "some of the plant's outputs and inputs")
    fixed = np.zeros((n + z + y, n + w + u), dtype=bool)
    fixed[n + z :], fixed[:, n + w :] = True, True
    first = M[(0,) * len(grid)]
    same = (first == M)[..., fixed].all() and not any(E[fixed].any() for E in bounds.values())
    if not same or M[..., n + z :, n + w :].any():
        raise InputError("M", "B2, C2, D12 or D21 that depend on a parameter, or D22", "constant ones, and D22 = 0")
    # With K = [A_K B_K; C_K D_K] the loop is [M_11 0; 0 0] + U K V, rows (x, x_K, z), columns (x, x_K, w).
    inner = slice(n, n + n_K)
    rows, cols = (np.r_[:n, n + n_K : n + n_K + rest] for rest in (z, w))
    U, V = np.zeros((n + n_K + z, n_K + u)), np.zeros((n_K + y, n + n_K + w))
    U[inner, :n_K] = V[:n_K, inner] = np.eye(n_K)
    U[rows, n_K:], V[n_K:, cols] = first[: n + z, n + w :], first[n + z :, : n + w]

    def widened(X: NDArray[np.float64]) -> NDArray[np.float64]:
        wide = np.zeros((len(U), V.shape[1]))
        wide[np.ix_(rows, cols)] = X[: n + z, : n + w]
        return wide

    loops = {at: exact(widened(M[at])) + exact(U) * exact(np.ascontiguousarray(K[at])) * exact(V)
             for at in np.ndindex(*grid)}  # fmt: skip
    return loops, {cell: widened(E) for cell, E in bounds.items()}
