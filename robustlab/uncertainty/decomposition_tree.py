"""Low-order LFTs of matrices of polynomials: structured tree decomposition.

Cockburn, Morton, Automatica 33 (1997); Varga, Looye, "Symbolic and numerical software tools for LFT-based low order
uncertainty modeling" (1999).
"""

# One step factors a variable out of every term that contains it: M = M0 + v L R = [I, v L] [M0; R] or [M0, L] [I; v R]
# with a constant L or R of the smallest inner size r, so v is repeated r times. The stacked matrix goes through the
# same step until it is constant, so that equal sub-expressions of different entries are realised once. The number of
# repetitions depends on the order of the variables; several orders are tried. Ranks are exact for rational numbers
# (arrays of objects), numerical for floats. Where M is affine in v, no LFT has fewer repetitions.

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array


@dataclass(frozen=True)
class ConstantLft:
    """A constant matrix with Delta channels: ``z = d11 w + d12 u``, ``y = d21 w + d22 u``, ``w = Delta z``."""

    names: tuple[Any, ...]
    d11: Array
    d12: Array
    d21: Array
    d22: Array

    def inverse(self) -> ConstantLft:
        """Return the LFT of the inverse of a 1 x 1 matrix, not zero at Delta = 0."""
        gain = 1.0 / self.d22
        out = -gain @ self.d21
        return ConstantLft(self.names, self.d11 + self.d12 @ out, self.d12 @ gain, out, gain)

    def closed(self, gains: Mapping[Any, ConstantLft]) -> ConstantLft:
        """Substitute a 1 x 1 LFT for each channel; d11 is that of a tree, so it is nilpotent."""
        from scipy.linalg import block_diag

        parts = [gains[name] for name in self.names]
        t11, t12, t21, t22 = (
            np.asarray(block_diag(*(getattr(part, name) for part in parts))).reshape(
                sum(len(part.names) for part in parts) if row else len(parts),
                sum(len(part.names) for part in parts) if col else len(parts),
            )
            for name, row, col in (("d11", 1, 1), ("d12", 1, 0), ("d21", 0, 1), ("d22", 0, 0))
        )
        around, loop = self.d11 @ t22, np.eye(len(parts))
        power = around
        while power.any():
            loop, power = loop + power, around @ power
        z_w, z_u = loop @ self.d11 @ t21, loop @ self.d12
        return ConstantLft(
            tuple(name for part in parts for name in part.names),
            t11 + t12 @ z_w, t12 @ z_u,
            self.d21 @ (t21 + t22 @ z_w), self.d22 + self.d21 @ t22 @ z_u,
        )  # fmt: skip


Exponents = tuple[int, ...]  # the power of each variable, in the order of the polynomial's names
Terms = Mapping[Exponents, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class MatrixPolynomial:
    """A matrix polynomial."""

    names: tuple[Hashable, ...]  # the variables
    terms: Terms  # exponents -> coefficient (m, n); the constant one is always there

    @property
    def is_affine(self) -> bool:
        return all(sum(exponents) <= 1 for exponents in self.terms)

    def __call__(self, t: Array) -> Array:
        """Evaluate the matrix (..., m, n) at t, shape (..., number of names)."""
        powers = np.stack([np.prod(t**exponents, axis=-1) for exponents in self.terms], axis=-1)
        coefficients: Any = np.stack(list(self.terms.values()))
        return np.tensordot(powers, coefficients, 1)


def polynomial_lft(polynomial: MatrixPolynomial, scale: Array, tolerance: float) -> ConstantLft:
    """Return the smallest LFT ``w = diag(t_k I) z`` of a polynomial among several orders of the variables."""
    rows, cols = scale[:, 0], scale[0] / scale[0, 0]
    plain = MatrixPolynomial(polynomial.names, {e: part / scale for e, part in polynomial.terms.items()})
    lft = decomposition(plain, tolerance)
    return ConstantLft(lft.names, lft.d11, lft.d12 * cols, rows[:, None] * lft.d21, lft.d22 * scale)


def decomposition(
    polynomial: MatrixPolynomial, tolerance: float = 0.0, weight: Callable[[Any], int] = lambda _: 1
) -> ConstantLft:
    """Return the LFT of a polynomial of least weight among several orders of the variables."""
    names, terms = polynomial.names, polynomial.terms
    least = sum(weight(name) for k, name in enumerate(names) if any(e[k] for e in terms))
    every = list(range(len(names)))
    orders = [every, every[::-1]]  # forwards, backwards, and with each one put first and last
    for k in every:
        rest = [j for j in every if j != k]
        orders += [[k, *rest], [*rest, k]]
    found: list[tuple[int, list[int], list[NDArray[Any]]]] = []
    for order in orders[:1] if polynomial.is_affine else orders:
        channels, *parts = _expanded(terms, order, tolerance)
        found.append((sum(weight(names[k]) for k in channels), channels, parts))
        if found[-1][0] == least:
            break
    _, channels, parts = min(found, key=lambda one: one[0])
    return ConstantLft(tuple(names[k] for k in channels), *(np.asarray(part, dtype=np.float64) for part in parts))


def _expanded(
    terms: Terms, order: Sequence[int], tolerance: float
) -> tuple[list[int], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the variable of each channel, and d11 .. d22; the first variable of the order is factored out."""
    occurring = {k for exponents in terms for k, e in enumerate(exponents) if e}
    some = next(iter(terms.values()))
    (m, n), zero = some.shape, (0,) * len(order)

    def zeros(rows: int, cols: int) -> NDArray[Any]:
        return np.zeros_like(some, shape=(rows, cols))

    if not occurring:
        return [], zeros(0, 0), zeros(0, n), zeros(m, 0), terms.get(zero, zeros(m, n))
    k = next(v for v in order if v in occurring)
    quotient = {(*e[:k], e[k] - 1, *e[k + 1 :]): part for e, part in terms.items() if e[k]}
    parts = list(quotient.values())
    left, below = rank_factors(np.hstack(parts), tolerance)
    if left.shape[1] > len(rank_factors(np.vstack(parts), tolerance)[1]):  # a constant R: as L of the transposed
        names, d11, d12, d21, d22 = _expanded({e: part.T for e, part in terms.items()}, order, tolerance)
        return names, d11.T, d21.T, d12.T, d22.T
    r, rest = left.shape[1], {zero: zeros(m, n)} | {e: part for e, part in terms.items() if not e[k]}
    low = dict(zip(quotient, np.hsplit(below, len(parts)), strict=True))
    stacked = {e: np.vstack([rest.get(e, zeros(m, n)), low.get(e, zeros(r, n))]) for e in {**rest, **low}}
    names, d11, d12, d21, d22 = _expanded(stacked, order, tolerance)
    # z = the last r outputs, y += left w
    inner = np.block([[zeros(r, r), d21[m:]], [zeros(len(names), r), d11]])
    return [k] * r + names, inner, np.vstack([d22[m:], d12]), np.hstack([left, d21[:m]]), d22[:m]


def rank_factors(matrix: NDArray[Any], tolerance: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return ``matrix = left @ right`` with as few columns of left as its entries above the tolerance require."""
    if matrix.dtype == object:
        return _exact_rank_factors(matrix)
    # Elimination with full pivoting keeps zeros of rows and columns exact, unlike an SVD.
    rest = matrix.copy()
    columns, rows = [rest[:, :0]], [rest[:0]]
    while np.abs(rest).max(initial=0.0) > tolerance:
        i, j = np.unravel_index(np.argmax(np.abs(rest)), rest.shape)
        root, sign = np.sqrt(abs(rest[i, j])), np.sign(rest[i, j])
        column, row = rest[:, [j]] / root, rest[[i], :] * (sign / root)
        columns.append(column)
        rows.append(row)
        rest = rest - column @ row
        rest[i, :], rest[:, j] = 0.0, 0.0
    return np.hstack(columns), np.vstack(rows)


def _exact_rank_factors(matrix: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Do the same for rational numbers (flint); right consists of rows of the matrix, the sparsest possible."""
    from flint import fmpq_mat

    order = np.argsort((matrix != 0).sum(axis=1), kind="stable")
    echelon, rank = fmpq_mat(matrix.shape[1], len(matrix), matrix[order].T.ravel().tolist()).rref()
    entries = np.array(echelon.tolist(), dtype=object).reshape(matrix.shape[1], len(matrix))[:rank]
    left = np.zeros_like(matrix, shape=(len(matrix), rank))
    left[order] = entries.T
    return left, matrix[order[(entries != 0).argmax(axis=1)]] if rank else matrix[:0]
