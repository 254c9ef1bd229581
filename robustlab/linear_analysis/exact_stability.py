r"""Stability decided in exact arithmetic, for matrices whose eigenvalues lie too close to the boundary for rounding.

The floating-point entries are taken as the rational numbers that they are; the characteristic polynomial is computed
by Faddeev and LeVerrier's recursion in whole numbers,

.. math:: M_k = N M_{k-1} + c_{k-1} I, \qquad c_k = -\mathrm{tr}(N M_k) / k,

and its roots are judged by Routh's array, those on the boundary by Sturm's chain. Nothing is rounded, so the answer is
the truth about the matrix as given.

References
----------
Faddeev, Sominskii 1949; Routh 1877; Sturm 1829; Gantmacher, *The Theory of Matrices*, chapters IV and XV.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

from robustlab.arrays import AnyArray

# Beyond this size whole numbers become long; the doubtful cases of practice are smaller.
MOST_STATES = 12


def exactly_stable(A: AnyArray, discrete: bool = False) -> bool | None:
    """Whether all eigenvalues lie in the open left half plane (discrete: unit disk); None for more than 12 states.

    ``A``: real, finite, shape (n, n).

    Examples
    --------
    >>> import numpy as np
    >>> exactly_stable(np.array([[-1.0, 1e8], [-1e-8, 1.0]])), exactly_stable(np.array([[-1e-300]]))
    (False, True)
    """
    p = _polynomial(A, discrete)
    return None if p is None else _all_left(p)


def exactly_on_boundary(A: AnyArray, discrete: bool = False) -> bool | None:
    """Whether an eigenvalue lies on the imaginary axis (discrete: unit circle); None for more than 12 states.

    ``A``: real, finite, shape (n, n).

    Examples
    --------
    >>> import numpy as np
    >>> exactly_on_boundary(np.array([[0.0, 1.0], [-2.0, 0.0]])), exactly_on_boundary(np.array([[-1e-300]]))
    (True, False)
    """
    p = _polynomial(A, discrete)
    return None if p is None else _has_root_on_axis(p)


def _polynomial(A: AnyArray, discrete: bool) -> list[int] | None:
    """Coefficients of the characteristic polynomial (discrete: its image in s), the highest power first."""
    n = len(A)
    if n > MOST_STATES:
        return None
    ratios = [[float(x).as_integer_ratio() for x in row] for row in A]
    # Denominators are powers of two: the largest is a multiple of all.
    common = max((denominator for row in ratios for _, denominator in row), default=1)
    whole = [[numerator * (common // denominator) for numerator, denominator in row] for row in ratios]
    coefficients = _characteristic(whole)
    if discrete:
        coefficients = _mapped([c * common ** (n - k) for k, c in enumerate(coefficients)])
    return coefficients


def _characteristic(N: list[list[int]]) -> list[int]:
    """Coefficients of det(x I - N), the highest power first."""
    n = len(N)
    M, coefficients = [[0] * n for _ in range(n)], [1]
    for k in range(1, n + 1):
        M = [[sum(N[i][h] * M[h][j] for h in range(n)) for j in range(n)] for i in range(n)]
        for i in range(n):
            M[i][i] += coefficients[-1]
        trace = sum(N[i][h] * M[h][i] for i in range(n) for h in range(n))
        coefficients.append(-trace // k)  # divides without rest
    return coefficients


def _mapped(p: list[int]) -> list[int]:
    """``(1 - s)^n p((1 + s)/(1 - s))``: the unit disk becomes the left half plane, z = -1 infinity."""
    n, found = len(p) - 1, [0] * len(p)
    for k, c in enumerate(p):
        term = [c]
        for sign in [1] * (n - k) + [-1] * k:  # times (sign s + 1), the highest power first
            term = [sign * a + b for a, b in zip([*term, 0], [0, *term], strict=True)]
        found = [a + b for a, b in zip(found, term, strict=True)]
    return found


def _all_left(p: list[int]) -> bool:
    """Whether all roots have a negative real part, by Routh's array; a missing highest power is a root at infinity."""
    above, row = [Fraction(x) for x in p[0::2]], [Fraction(x) for x in p[1::2]]
    sign = above[0]
    while row:
        if sign * row[0] <= 0:
            return False
        factor = above[0] / row[0]
        longer = [*row[1:], *([Fraction(0)] * (len(above) - len(row)))]
        above, row = row, [a - factor * b for a, b in zip(above[1:], longer, strict=True)]
    return sign != 0


def _has_root_on_axis(p: list[int]) -> bool:
    """Whether p has a root on the imaginary axis; a missing highest power is a root at infinity, which lies on it.

    With ``p(s) = e(s^2) + s o(s^2)`` a root ``jw`` is a common root ``x = -w^2`` of e and o.
    """
    if not p[0] or not p[-1]:
        return True
    upwards = [Fraction(x) for x in reversed(p)]
    common, rest = _trimmed(upwards[0::2]), _trimmed(upwards[1::2])
    while rest:
        common, rest = rest, _remainder(common, rest)
    chain, derivative = [common], [k * c for k, c in enumerate(common)][1:]
    while derivative:
        chain.append(derivative)
        derivative = [-c for c in _remainder(chain[-2], chain[-1])]
    far = [f[-1] * (-1) ** (len(f) - 1) for f in chain]
    return _changes(far) > _changes([f[0] for f in chain])


def _remainder(f: list[Fraction], g: list[Fraction]) -> list[Fraction]:
    """Of the division of f by g, lowest powers first."""
    rest = list(f)
    while len(rest) >= len(g):
        factor, shift = rest[-1] / g[-1], len(rest) - len(g)
        rest = _trimmed([c - factor * g[k - shift] if k >= shift else c for k, c in enumerate(rest[:-1])])
    return rest


def _trimmed(f: list[Fraction]) -> list[Fraction]:
    """Without the highest powers that are missing."""
    while f and not f[-1]:
        f = f[:-1]
    return f


def _changes(values: list[Fraction]) -> int:
    """Changes of sign, zeros left out."""
    signs = [v > 0 for v in values if v]
    return sum(a != b for a, b in pairwise(signs))
