r"""Determinants of pencils as polynomials in whole numbers, and their roots, without rounding.

.. math:: \det(M - s E) = 2^{e} \sum_k c_k s^k, \qquad E = \begin{bmatrix} I_n & 0 \\ 0 & 0 \end{bmatrix},
   \qquad c_k \text{ whole}

A floating-point number is a fraction, so zeros, poles and crossings of a model are roots of polynomials with whole
coefficients. Rows and columns are multiplied by powers of two until all entries are whole; the determinant is computed
modulo as many primes as Hadamard's bound of its coefficients requires. Roots come from FLINT as balls that are proved
to contain one root each. There are no tolerances.

References
----------
von zur Gathen, Gerhard, *Modern Computer Algebra*, chapter 5; Johansson, "Arb: efficient arbitrary-precision
midpoint-radius interval arithmetic", IEEE Trans. Computers 66 (2017).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array, Indices
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import equilibrating_exponents
from robustlab.statespace import StateSpaceModel

if TYPE_CHECKING:
    from flint import acb, arb, fmpz_poly

# Largest size, and primes times cubed rows: above them the result takes more than about ten seconds.
MOST_STATES, MOST_WORK = 200, 4e9
# Most states for which stability is decided exactly.
MOST_DECIDED = 12
TOP = 2**62  # upper bound of the primes
FEW = 3  # primes that decide a rank: all are unlucky with a probability below 1e-40
BITS = 128  # of a root, relative to its modulus
POINT = 0x9E3779B97F4A7C15  # at which a pencil is singular by chance only
FAR = 10**6  # above every exponent

# A model, the indices of its input signals, those of the rows to which its outputs are added, and their sign.
Block = tuple[StateSpaceModel, Indices, Indices, int]


class Root(NamedTuple):
    """A root ``re + j im``, accurate to BITS, and its multiplicity; ``re`` is 0 where indistinguishable from 0."""

    re: Fraction
    im: Fraction
    multiplicity: int

    @property
    def value(self) -> complex:
        """The root in floating point; infinite if it overflows."""
        return complex(_float(self.re), _float(self.im))


def determinant(M: Array, n: int) -> tuple[fmpz_poly, int]:
    """Compute the polynomial c and the exponent e of ``det(M - s E)``; c is zero if the determinant is.

    Raises NoTrustworthyNumber: more work than MOST_WORK, from the number and the range of the entries.
    """
    from flint import fmpz_mat, fmpz_poly, nmod_mat, nmod_poly

    k = len(M)
    if not k:
        return fmpz_poly([1]), 0
    rows, weights, shift = _whole(M, n)
    sizes = ((abs(x) + (weights[i] if i == j < n else 0) for j, x in enumerate(row)) for i, row in enumerate(rows))
    bound = 2 * math.prod(math.isqrt(sum(x * x for x in row)) + 1 for row in sizes)
    if bound.bit_length() / TOP.bit_length() * k**3 > MOST_WORK:
        found = f"a pencil of {k} rows with {bound.bit_length()} binary digits"
        raise NoTrustworthyNumber("determinant", found, "at most 200 states, of entries less far apart")
    whole, E = fmpz_mat(k, k, [x for row in rows for x in row]), fmpz_mat(k, n)
    for i in range(n):
        E[i, i] = weights[i]
        whole[i, i] -= weights[i] * POINT
    # With t = s - POINT and W the first rows of whole^-1 E the determinant is det(whole) det(I - t W).
    c, modulus, tried = fmpz_poly([]), 1, 0
    while modulus <= bound:
        p, tried = _prime(tried), tried + 1
        G = nmod_mat(whole, p)
        size = G.det()
        if size == 0:
            if modulus == 1 and tried == FEW:
                return fmpz_poly([]), 0
            continue
        W = nmod_mat(n, n, G.solve(nmod_mat(E, p)).entries()[: n * n], p)
        found = nmod_poly(W.charpoly().coeffs()[::-1], p)(nmod_poly([-POINT, 1], p)) * size
        step = (found - nmod_poly(c, p)) * pow(modulus, -1, p)
        c, modulus = c + modulus * fmpz_poly([int(x) for x in step.coeffs()]), modulus * p
    return fmpz_poly([x - modulus if 2 * x > modulus else x for x in c.coeffs()]), -shift


def wired(blocks: Iterable[Block], J: Array) -> tuple[Array, int]:
    """Return M and n, for `determinant`, of `Block` models wired by signals, with the part J in their own rows."""
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


def _whole(M: Array, n: int) -> tuple[list[list[int]], list[int], int]:
    """Return M and E with rows and columns scaled to one size and to whole numbers, and the sum of exponents."""
    nonzero = M != 0
    share, high = np.frexp(M)
    mantissas = np.ldexp(share, 53).astype(np.int64)
    ends = np.frexp(np.where(nonzero, mantissas & -mantissas, 1).astype(float))[1] - 1  # trailing zeros
    mantissas, low = mantissas >> ends, high - 53 + ends
    row, column = equilibrating_exponents(M)
    lowest = np.where(nonzero, low + row[:, None] + column, FAR).min(axis=1, initial=FAR)
    lowest[:n] = np.minimum(lowest[:n], row[:n] + column[:n])
    row -= np.where(lowest < FAR, lowest, row)
    exponents = np.where(nonzero, low + row[:, None] + column, 0)
    rows = [[x << e for x, e in zip(*pair, strict=True)]
            for pair in zip(mantissas.tolist(), exponents.tolist(), strict=True)]  # fmt: skip
    return rows, [1 << e for e in (row[:n] + column[:n]).tolist()], int(row.sum() + column.sum())


@cache
def _prime(index: int) -> int:
    from flint import fmpz

    p = (_prime(index - 1) if index else TOP) - 1
    while not fmpz(p).is_prime():
        p -= 1
    return p


def from_the_circle(f: fmpz_poly, degree: int) -> fmpz_poly:
    """Return ``(1 - v)^degree f((1 + v) / (1 - v))``: the unit disk becomes the left half plane, -1 infinity."""
    from flint import fmpz_poly

    found, lower = fmpz_poly([]), fmpz_poly([1])  # Horner's rule, with the missing powers of 1 - v
    for k in reversed(range(degree + 1)):
        found = found * fmpz_poly([1, 1]) + lower * f[k]
        lower *= fmpz_poly([1, -1])
    return found


def roots(f: fmpz_poly) -> list[Root]:
    """Find all complex roots, in conjugate pairs; real ones have ``im == 0``."""
    found = []
    for z, multiplicity in _balls(f, BITS):
        re = Fraction(0) if z.real.contains(0) else _middle(z.real)
        found.append(Root(re, _middle(z.imag), multiplicity))
    return found


def even_and_odd(f: fmpz_poly) -> tuple[fmpz_poly, fmpz_poly]:
    """Return e, o with ``f(j omega) = e(x) + j omega o(x)``, ``x = omega^2``."""
    from flint import fmpz_poly

    even, odd = (fmpz_poly([c * (-1) ** k for k, c in enumerate(part)]) for part in (f.coeffs()[::2], f.coeffs()[1::2]))
    return even, odd


def on_axis(f: fmpz_poly) -> bool:
    """Decide whether a root lies on the imaginary axis: a common root ``x >= 0`` of the even and the odd part."""
    even, odd = even_and_odd(f)
    return f[0] == 0 or any(z.imag == 0 and z.real > 0 for z, _ in _balls(even.gcd(odd), BITS))


def all_left(f: fmpz_poly) -> bool:
    """Decide whether all roots lie in the open left half plane."""
    if on_axis(f):
        return False
    bits, balls = BITS, _balls(f, BITS)
    while any(z.real.contains(0) for z, _ in balls):
        bits *= 2
        balls = _balls(f, bits)
    return all(z.real < 0 for z, _ in balls)


def exactly_stable(A: AnyArray, discrete: bool = False) -> bool | None:
    """Decide whether all eigenvalues of A lie in the open left half plane (unit disk); None for more than 12 states."""
    p = _characteristic(A, discrete)
    return None if p is None else p.degree() == len(A) and all_left(p)


def exactly_on_boundary(A: AnyArray, discrete: bool = False) -> bool | None:
    """Decide whether an eigenvalue of A lies on the imaginary axis (unit circle); None for more than 12 states."""
    p = _characteristic(A, discrete)
    return None if p is None else p.degree() < len(A) or on_axis(p)


def _characteristic(A: AnyArray, discrete: bool) -> fmpz_poly | None:
    """Return the characteristic polynomial (discrete: its image in v, of lower degree if -1 is an eigenvalue)."""
    if len(A) > MOST_DECIDED:
        return None
    p, _ = determinant(np.asarray(A, dtype=float), len(A))
    return from_the_circle(p, len(A)) if discrete else p


def _balls(f: fmpz_poly, bits: int) -> list[tuple[acb, int]]:
    """Return disjoint balls of all roots and their multiplicities; FLINT gives real roots no imaginary part."""
    from flint import ctx

    before, ctx.prec = ctx.prec, bits
    try:
        found: Any = f.complex_roots() if f.degree() > 0 else []
        return found
    finally:
        ctx.prec = before


def _middle(ball: arb) -> Fraction:
    man, exp = (int(x) for x in ball.mid().man_exp())
    return Fraction(man << max(exp, 0), 1 << max(-exp, 0))


def _float(part: Fraction) -> float:
    try:
        return float(part)
    except OverflowError:
        return math.inf if part > 0 else -math.inf
