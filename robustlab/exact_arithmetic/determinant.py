r"""Determinants of matrix pencils, exactly: polynomials in whole numbers.

.. math:: \det(M - s E) = 2^{e} \sum_k c_k s^k, \qquad E = \begin{bmatrix} I_n & 0 \\ 0 & 0 \end{bmatrix},
   \qquad c_k \text{ whole}

Rows and columns are multiplied by powers of two until all entries are whole numbers. The determinant is computed modulo
as many primes as Hadamard's bound of its coefficients asks for, and put together by the Chinese remainder theorem: no
digit is lost, whatever the entries' sizes.

References
----------
Hadamard 1893; Garner 1959. Modular determinants: von zur Gathen, Gerhard, *Modern Computer Algebra*, chapter 5.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel

# Beyond this size, or with so many primes times cubed rows, the answer takes more than about ten seconds.
MOST_STATES, MOST_WORK = 200, 1e10
TOP = 2**27  # primes lie below it
# Primes by which a rank or a degree is told: that all are unlucky has a chance of about (n / 2^26)^3.
FEW = 3
FAR = 10**6  # beyond every exponent

Block = tuple[StateSpaceModel, Indices, Indices, int]


class Determinant(NamedTuple):
    """``2^exponent * sum(coefficients[k] s^k)``; the last coefficient is not zero, and there is none of the zero."""

    coefficients: list[int]
    exponent: int

    @property
    def degree(self) -> int:
        """-1 of the zero polynomial."""
        return len(self.coefficients) - 1

    def times_power_of(self, exponent: int) -> list[int]:
        """Coefficients in units of ``2^exponent``, which must be no larger than the own exponent."""
        return [c << (self.exponent - exponent) for c in self.coefficients]


class _Whole(NamedTuple):
    """A pencil in whole numbers: ``M = mantissas 2^exponents``, ``E = 2^weights``, and bits of its coefficients."""

    mantissas: Indices
    exponents: Indices
    weights: Indices
    shift: int  # the determinant is 2^shift times that of the pencil as given
    bits: float


def determinant(M: Array, n: int) -> Determinant:
    """The determinant of ``M - s E`` with E the identity in its first n rows and columns, zero elsewhere.

    Examples
    --------
    >>> found = determinant(np.array([[-2.0, 1.0], [-3.0, 1.0]]), 1)  # (s - 1) / (s + 2) times -(s + 2)
    >>> found.coefficients, found.exponent
    ([1, -1], 0)
    """
    from robustlab.exact_arithmetic.kernels import determinants

    if not len(M):
        return Determinant([1], 0)
    whole = min((_whole(M, n), _transposed(_whole(M.T, n))), key=lambda w: w.bits)
    count = math.ceil((whole.bits + 2) / math.log2(TOP / 2)) + 1
    if count * len(M) ** 3 > MOST_WORK:
        found = f"a pencil of {len(M)} rows with {whole.bits:.0f} digits"
        raise NoTrustworthyNumber("determinant", found, "at most 200 states, of entries less far apart")
    primes = primes_below(count)
    residues = determinants(whole.mantissas, whole.exponents, whole.weights, primes)
    lucky = ~np.isnan(residues[:, 0])
    if not lucky[:FEW].any():
        return Determinant([], 0)
    missing = count - int(lucky.sum())
    while missing:  # a point of the pencil at which it happens to be singular modulo a prime
        more = primes_below(len(primes) + missing)[len(primes) :]
        found = determinants(whole.mantissas, whole.exponents, whole.weights, more)
        primes, residues = np.concatenate([primes, more]), np.concatenate([residues, found])
        lucky = ~np.isnan(residues[:, 0])
        missing = count - int(lucky.sum())
    return Determinant(trimmed(joined(residues[lucky], primes[lucky])), -whole.shift)


def normal_rank(M: Array, n: int) -> int:
    """Rank of ``M - s E`` at almost every s; M of shape (k, l), E the identity in the first n rows and columns.

    Exact but for a chance below 1e-15 of three unlucky primes.
    """
    from robustlab.exact_arithmetic.kernels import ranks

    if not M.size:
        return 0
    whole = _whole(M, n)
    return int(ranks(whole.mantissas, whole.exponents, whole.weights, primes_below(FEW)).max())


def wired(blocks: Iterable[Block], J: Array) -> tuple[Array, int]:
    """The matrix M of models that are wired by signals, and the number n of their states, for `determinant`.

    A block is a model with the indices of the signals that enter it, those of the rows that its outputs are added to,
    and the sign with which. ``J`` (k, k): what the signals add to their rows themselves. No entries are multiplied.
    """
    blocks = list(blocks)
    n, k = sum(model.n_states for model, *_ in blocks), len(J)
    M, first = np.zeros((n + k, n + k)), 0
    M[n:, n:] = J
    for model, into, onto, sign in blocks:
        states = slice(first, first + model.n_states)
        M[states, states] = model.A
        M[states, n + into] = model.B
        M[n + onto, states] = sign * model.C
        M[(n + onto)[:, None], n + into] += sign * model.D
        first += model.n_states
    return M, n


def joined(residues: Array, primes: Array) -> list[int]:
    """The whole numbers next to zero with these residues (n_primes, n) modulo all primes, by Garner's algorithm."""
    values, product = [0] * residues.shape[1], 1
    for row, p in zip(residues.astype(np.int64).tolist(), (int(p) for p in primes), strict=True):
        back = pow(product, -1, p)
        values = [x + product * ((r - x) * back % p) for x, r in zip(values, row, strict=True)]
        product *= p
    half = product // 2
    return [x - product if x > half else x for x in values]


def trimmed(coefficients: Iterable[int]) -> list[int]:
    """Without the highest powers that are missing."""
    kept = list(coefficients)
    while kept and not kept[-1]:
        kept.pop()
    return kept


def primes_below(count: int, top: int = TOP) -> Array:
    """The largest primes below ``top``, falling, shape (count,)."""
    have = _primes(1 << max(count - 1, 63).bit_length(), top)
    return have[:count]


@lru_cache(maxsize=8)
def _primes(count: int, top: int) -> Array:
    low = top - 30 * count - 1000
    sieve = np.ones(top - low, dtype=bool)
    for q in range(2, math.isqrt(top) + 1):
        sieve[-low % q :: q] = False
    found = (low + np.flatnonzero(sieve))[::-1][:count].astype(float)
    found.setflags(write=False)
    return found


def _whole(M: Array, n: int) -> _Whole:
    """The pencil in whole numbers: columns brought to one size, then rows multiplied until no fraction is left."""
    share, high = np.frexp(M)
    mantissas, there = np.ldexp(share, 53).astype(np.int64), M != 0
    ends = np.frexp(np.where(there, mantissas & -mantissas, 1).astype(float))[1] - 1  # zeros at the mantissas' ends
    mantissas, low = mantissas >> ends, high - 53 + ends
    column = -np.where(there.any(axis=0), np.where(there, high, -FAR).max(axis=0, initial=-FAR), 0)
    row = np.where(there, -(low + column), -FAR).max(axis=1, initial=-FAR)
    row[:n] = np.maximum(row[:n], -column[:n])
    row[row == -FAR] = 0
    weights = row[:n] + column[:n]
    size = np.where(there, high + row[:, None] + column, 0).max(axis=1, initial=0)
    size[:n] = np.maximum(size[:n], weights + 1)
    bits = float(size.sum()) + 0.5 * len(M) * math.log2(sum(M.shape) + 2)
    exponents = np.where(there, low + row[:, None] + column, 0)
    return _Whole(mantissas, exponents, weights, int(row.sum() + column.sum()), bits)


def _transposed(whole: _Whole) -> _Whole:
    mantissas, exponents = np.ascontiguousarray(whole.mantissas.T), np.ascontiguousarray(whole.exponents.T)
    return _Whole(mantissas, exponents, whole.weights, whole.shift, whole.bits)
