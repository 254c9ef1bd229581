"""Sizes of the entries of matrices: balancing by powers of two, which is exact, and refusal of extremes."""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrix_equations import lapack
from robustlab.statespace import StateSpaceModel

# Bounds of the largest entry of an ordinary matrix: products of several neither overflow nor vanish. Single entries may
# be smaller, as long as their squares do not vanish.
SMALLEST, LARGEST, LEAST = 2.0**-166, 2.0**166, 2.0**-500
SWEEPS = 20
# Products of entries between these neither overflow nor vanish.
FAINTEST, STRONGEST = 1e-100, 1e100


def is_moderate(*matrices: AnyArray) -> bool:
    """Return whether every matrix is of an ordinary size, or zero."""
    for matrix in matrices:
        size = np.abs(matrix[matrix != 0])
        if size.size and not (SMALLEST <= size.max() <= LARGEST and size.min() >= LEAST):
            return False
    return True


def balancing_factors(matrix: AnyArray) -> AnyArray:
    """Return powers of two t (n,): rows and columns of ``matrix / t[:, None] * t`` have one size (LAPACK gebal)."""
    if not matrix.size:
        return np.ones(len(matrix))
    if not np.isfinite(matrix).all():
        raise ValueError("a matrix to be balanced has entries that are NaN or infinite")
    return np.asarray(lapack().dgebal(np.abs(matrix), scale=1, permute=0)[3])


def balancing_exponents(A: AnyArray, into: AnyArray, out: AnyArray) -> AnyArray:
    """Return exponents t (n,) of states ``x = 2^t x'`` that balance rows of [A, into] against columns of [A; out]."""
    n = len(A)
    a, b, c = _exponents(A), _exponents(into).max(1, initial=-np.inf), _exponents(out).max(0, initial=-np.inf)
    off, t = np.where(np.eye(n, dtype=bool), -np.inf, a), np.zeros(n)
    for _ in range(SWEEPS):
        k, w, z = _top(a - t[:, None] + t), _top(b - t), _top(c + t)
        settled = True
        for i in range(n):
            row = max((off[i] + t).max() - t[i] - k, b[i] - t[i] - w)
            column = max((off[:, i] - t).max() + t[i] - k, c[i] + t[i] - z)
            if row == -np.inf and column == -np.inf:
                continue
            step = row if column == -np.inf else -column if row == -np.inf else 0.5 * (row - column)
            step = float(np.round(step))
            t[i] += step
            settled &= abs(step) <= 1
        if settled:
            break
    return t.astype(int)


def equilibrating_exponents(matrix: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return exponents r, c: the largest entries of rows and columns of ``2^r matrix 2^c`` are near 1 (Ruiz 2001)."""
    e, r, c = _exponents(np.abs(matrix)), np.zeros((len(matrix), 1)), np.zeros(matrix.shape[1])
    for _ in range(SWEEPS):
        now = e + r + c
        row, column = now.max(axis=1, initial=-np.inf, keepdims=True), now.max(axis=0, initial=-np.inf)
        r, c = r - 0.5 * np.where(np.isfinite(row), row, 0), c - 0.5 * np.where(np.isfinite(column), column, 0)
    return np.round(r[:, 0]).astype(int), np.round(c).astype(int)


def refuse_extremes(model: StateSpaceModel, where: str) -> None:
    """Refuse models whose entries are too large or too small to be multiplied with one another."""
    for matrix in (model.A, model.B, model.C, model.D):
        top = float(np.abs(matrix).max(initial=0.0))
        if top and not FAINTEST < top < STRONGEST:
            found, expected = f"the largest entry of a matrix of the model is {top:.0e}", "between 1e-100 and 1e100"
            raise NoTrustworthyNumber(where, found, expected, "choose other units of signals or time")


def refuse_overflow(where: str, *arrays: AnyArray) -> None:
    """Refuse products of finite input that are NaN or infinite."""
    if not all(np.isfinite(array).all() for array in arrays):
        hint = "choose units in which the model's entries are closer to one another"
        raise NoTrustworthyNumber(where, "a product of the model's entries overflows", "numbers below 1e308", hint)


def _exponents(matrix: AnyArray) -> AnyArray:
    """Return the exponent of every entry, -inf for zeros."""
    return np.where(matrix == 0, -np.inf, np.frexp(matrix)[1])


def _top(exponents: AnyArray) -> int:
    top = exponents.max(initial=-np.inf)
    return int(top) if np.isfinite(top) else 0
