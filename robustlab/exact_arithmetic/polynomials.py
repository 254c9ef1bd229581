"""Polynomials with whole coefficients, the constant first: what two have in common, and the roots that are multiple.

Greatest common divisors are computed modulo primes and put together until a division without rest confirms them.

References
----------
Brown 1971; Yun 1976; von zur Gathen, Gerhard, *Modern Computer Algebra*, chapters 6 and 14.
"""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import zip_longest

import numpy as np

from robustlab.arrays import Array
from robustlab.exact_arithmetic.determinant import FEW, joined, primes_below, trimmed

# Primes by which a divisor is first put together; twice as many each time until it divides.
FIRST = 8


def common_factor(f: list[int], g: list[int]) -> list[int]:
    """The greatest common divisor of two polynomials, without a common whole factor of its coefficients.

    Examples
    --------
    >>> common_factor([2, 3, 1], [1, 2, 1])  # (s + 1)(s + 2) and (s + 1)^2
    [1, 1]
    """
    if not f or not g:
        return _primitive(f or g)
    f, g = _primitive(f), _primitive(g)
    lead, count = math.gcd(f[-1], g[-1]), FEW
    while True:
        primes = primes_below(count)
        primes = primes[[bool(lead % int(p)) for p in primes]]
        residues = _common(f, g, primes)
        degrees = [len(trimmed(row)) - 1 for row in residues.tolist()]
        least = min(degrees)
        if least == 0:  # no divisor modulo a prime is none at all
            return [1]
        kept = np.array(degrees) == least
        scaled = [[int(c) * lead % int(p) for c in row[: least + 1]] for row, p in zip(residues, primes, strict=True)]
        found = _primitive(joined(np.array(scaled, dtype=float)[kept], primes[kept]))
        if divided(f, found) is not None and divided(g, found) is not None:
            return found
        count = max(2 * count, FIRST)


def divided(f: list[int], g: list[int]) -> list[int] | None:
    """The quotient of two polynomials; None where a rest or a fraction is left."""
    rest, found = list(f), [0] * max(len(f) - len(g) + 1, 0)
    for k in reversed(range(len(found))):
        factor, left = divmod(rest[k + len(g) - 1], g[-1])
        if left:
            return None
        found[k] = factor
        for j, c in enumerate(g):
            rest[k + j] -= factor * c
    return None if any(rest) else found


def square_free(f: list[int]) -> list[tuple[list[int], int]]:
    """Factors without multiple roots, and the multiplicity that each one's roots have in f.

    Examples
    --------
    >>> square_free([2, 5, 4, 1])  # (s + 2)(s + 1)^2
    [([2, 1], 1), ([1, 1], 2)]
    """
    parts: list[tuple[list[int], int]] = []
    if len(f) < 2:
        return parts
    f = _primitive(f)
    repeated = common_factor(f, trimmed(k * c for k, c in list(enumerate(f))[1:]))
    single, multiplicity = _quotient(f, repeated), 1
    while len(single) > 1:
        further = common_factor(single, repeated)
        part = _quotient(single, further)
        if len(part) > 1:
            parts.append((part, multiplicity))
        single, repeated = further, _quotient(repeated, further)
        multiplicity += 1
    return parts


def _quotient(f: list[int], g: list[int]) -> list[int]:
    found = divided(f, g)
    assert found is not None, "a divisor that was confirmed leaves a rest"
    return found


def _common(f: list[int], g: list[int], primes: Array) -> Array:
    from robustlab.exact_arithmetic.kernels import common_factors

    f_rows, g_rows = (np.array([[_near(c, int(p)) for c in h] for p in primes], dtype=float) for h in (f, g))
    return common_factors(f_rows, g_rows, primes)


def _near(c: int, p: int) -> int:
    """The residue next to zero."""
    rest = c % p
    return rest - p if 2 * rest > p else rest


def _primitive(f: list[int]) -> list[int]:
    """Without common factor of its coefficients, the last one positive."""
    if not f:
        return f
    content = math.gcd(*f) * (1 if f[-1] > 0 else -1)
    return [c // content for c in f]


# --- sums, products, values ------------------------------------------------------------------------------------------


def added(f: list[int], g: list[int], factor: int = 1) -> list[int]:
    """``f + factor g``."""
    return trimmed(a + factor * b for a, b in zip_longest(f, g, fillvalue=0))


def product(f: list[int], g: list[int]) -> list[int]:
    """``f g``."""
    found = [0] * max(len(f) + len(g) - 1, 0)
    for i, a in enumerate(f):
        if a:
            for j, b in enumerate(g):
                found[i + j] += a * b
    return found


def value(f: list[int], x: Fraction) -> Fraction:
    """``f(x)``."""
    above, scale = 0, 1
    for c in reversed(f):
        above, scale = above * x.numerator + c * scale, scale * x.denominator
    return Fraction(above * x.denominator, scale)


def from_the_circle(f: list[int], degree: int) -> list[int]:
    """``(1 - v)^degree f((1 + v) / (1 - v))``: the unit disk becomes the left half plane, -1 infinity."""
    found, lower = [0], [1]  # Horner's rule, with the powers of 1 - v that the rest still lacks
    for k in reversed(range(degree + 1)):
        found = added(product(found, [1, 1]), lower, f[k] if k < len(f) else 0)
        lower = product(lower, [1, -1])
    return found
