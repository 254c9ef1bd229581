r"""Polynomials with whole coefficients, the constant first: what two have in common, which roots are multiple, and all
roots to about thirty digits.

Greatest common divisors are computed modulo primes and put together until a division without rest confirms them. Roots
are found from there:

.. math:: z_i \leftarrow z_i - \frac{N_i}{1 - N_i \sum_{j \ne i} 1 / (z_i - z_j)}, \qquad N_i = p(z_i) / p'(z_i)

p and p' are evaluated in whole numbers, with as many bits as it takes for N to be known: how sensitive a root is to the
coefficients does not matter. Multiple roots are taken apart before. Around every root lies a disc,

.. math:: |s - z_i| \le n \left| \frac{p(z_i)}{c_n \prod_{j \ne i} (z_i - z_j)} \right|,

and one that meets no other holds exactly one root, whatever the iteration did.

References
----------
Brown 1971; Yun 1976; von zur Gathen, Gerhard, *Modern Computer Algebra*, chapters 6 and 14. Of the roots: Aberth, Math.
Comp. 27 (1973); Bini, Numerical Algorithms 13 (1996), for the first guesses; Smith, J. ACM 17 (1970), for the discs.
"""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.errors import NoTrustworthyNumber
from robustlab.exact_arithmetic.determinant import FEW, joined, primes_below, trimmed

# Primes by which a divisor is first put together; twice as many each time until it divides.
FIRST = 8
SWEEPS = 300
ROUGH = 1e-14  # values of p this small beside their terms are rounding
BITS = 128  # of the first evaluation
STEP = 40  # bits to which a step is known
DONE = 2.0**-100  # a step this small, relative to the root, ends the iteration
APART = 4.0  # sums of two radii that separate two discs, with those of their conjugates


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


# --- roots ------------------------------------------------------------------------------------------------------------


class Root(NamedTuple):
    """A root ``re + j im``, right to about 100 bits, and how often it is one."""

    re: Fraction
    im: Fraction
    multiplicity: int

    @property
    def value(self) -> complex:
        """In floating point; infinite where it overflows."""
        return complex(_float(self.re), _float(self.im))


def roots(f: list[int]) -> list[Root]:
    """All complex roots; those with ``im`` above zero come with their conjugates, real ones have ``im == 0``.

    ``f``: whole coefficients, the constant first, the last not zero.

    Examples
    --------
    >>> [(root.value, root.multiplicity) for root in roots([0, 1, 2, 1])]  # s (s + 1)^2
    [(0j, 1), ((-1+0j), 2)]
    """
    at_zero = next((k for k, c in enumerate(f) if c), 0)
    found = [Root(Fraction(0), Fraction(0), at_zero)] if at_zero else []
    for part, multiplicity in square_free(f[at_zero:]):
        found += [Root(re, im, multiplicity) for re, im in _simple_roots(part)]
    return found


def _simple_roots(f: list[int]) -> list[tuple[Fraction, Fraction]]:
    """Those of a polynomial without multiple roots that is not zero at zero."""
    n = len(f) - 1
    if n == 1:
        return [(Fraction(-f[0], f[1]), Fraction(0))]
    # In a unit in which the roots' geometric mean is of order one.
    unit = round((abs(f[0]).bit_length() - abs(f[-1]).bit_length()) / n)
    p = _Polynomial([c << (unit * k if unit > 0 else unit * (k - n)) for k, c in enumerate(f)])
    z = _iterated(p, _Points(_in_floating_point(p, _first_guesses(p))))
    real, upper = _told_apart(p, z)
    scale, found = Fraction(2) ** unit, list[tuple[Fraction, Fraction]]()
    for i in np.flatnonzero(real).tolist():
        found.append((z.exactly(i)[0] * scale, Fraction(0)))
    for i in np.flatnonzero(upper).tolist():
        re, im = z.exactly(i)
        re = Fraction(0) if abs(re) < DONE * im else re
        found += [(re * scale, im * scale), (re * scale, -im * scale)]
    return found


class _Polynomial:
    """Coefficients, and their sizes: ``share * 2^exponent``."""

    def __init__(self, f: list[int]) -> None:
        self.f, self.n = f, len(f) - 1
        self.exponent = np.array([c.bit_length() for c in f])
        self.share = np.array([c / (1 << e) for c, e in zip(f, self.exponent.tolist(), strict=True)])
        with np.errstate(divide="ignore"):
            self.log2 = np.log2(np.abs(self.share)) + self.exponent


class _Points:
    """Points with twice the digits: the sums of two complex numbers, of which the second is the first's rounding."""

    def __init__(self, high: ComplexArray) -> None:
        self.high, self.low = high, np.zeros_like(high)

    def less(self, step: ComplexArray) -> None:
        """Go back by a step."""
        low = self.low - step
        high = self.high + low
        back = high - self.high
        self.high, self.low = high, (self.high - (high - back)) + (low - back)

    def apart(self) -> ComplexArray:
        """Differences of all pairs, (n, n); infinite on the diagonal."""
        found = (self.high[:, None] - self.high) + (self.low[:, None] - self.low)
        np.fill_diagonal(found, np.inf)
        return found

    def exactly(self, i: int) -> tuple[Fraction, Fraction]:
        high, low = self.high[i], self.low[i]
        return Fraction(high.real) + Fraction(low.real), Fraction(high.imag) + Fraction(low.imag)


def _first_guesses(p: _Polynomial) -> ComplexArray:
    """Points on circles whose radii the upper convex hull of the coefficients' logarithms tells (Bini 1996)."""
    hull: list[tuple[int, float]] = []
    for k, y in [(k, float(y)) for k, y in enumerate(p.log2) if np.isfinite(y)]:
        while len(hull) > 1:
            (k0, y0), (k1, y1) = hull[-2:]
            if (y - y0) * (k1 - k0) < (y1 - y0) * (k - k0):
                break
            hull.pop()
        hull.append((k, y))
    found = []
    for turn, ((low, y0), (high, y1)) in enumerate(pairwise(hull)):
        count = high - low
        angle = 2 * np.pi * (np.arange(count) / count + turn / p.n) + 0.7
        found.append(2.0 ** np.clip((y0 - y1) / count, -1000, 1000) * np.exp(1j * angle))
    return np.concatenate(found)


def _in_floating_point(p: _Polynomial, z: ComplexArray) -> ComplexArray:
    """Aberth's iteration in double precision, of each root as long as rounding allows: better guesses, no more."""
    active, k = np.ones(p.n, dtype=bool), np.arange(p.n + 1)
    for _ in range(SWEEPS):
        unit = np.floor(np.log2(np.abs(z))).astype(int) + 1
        w, terms = z * np.ldexp(1.0, -unit), p.exponent + k * unit[:, None]
        c = np.ldexp(p.share, terms - terms.max(axis=1, keepdims=True))
        value, slope, size = np.zeros_like(z), np.zeros_like(z), np.zeros(p.n)
        for j in reversed(k.tolist()):
            slope = slope * w + value
            value, size = value * w + c[:, j], size * np.abs(w) + np.abs(c[:, j])
        active &= np.abs(value) > ROUGH * size
        with np.errstate(all="ignore"):
            step = value / slope * np.ldexp(1.0, unit)
            next_z = z - _corrected(step, z[:, None] - z)
        active &= np.isfinite(next_z) & (next_z != 0)
        if not active.any():
            break
        z = np.where(active, next_z, z)
    return z


def _corrected(step: ComplexArray, apart: ComplexArray) -> ComplexArray:
    """Newton's steps, with the other roots taken out."""
    np.fill_diagonal(apart, np.inf)
    return step / (1 - step * (1 / apart).sum(axis=1))


def _iterated(p: _Polynomial, z: _Points) -> _Points:
    """Aberth's iteration, until no root moves."""
    bits, step, active = [BITS] * p.n, np.ones(p.n, dtype=complex), np.ones(p.n, dtype=bool)
    for _ in range(SWEEPS):
        for i in np.flatnonzero(active).tolist():
            step[i], bits[i] = _newton(p, z, i, bits[i])
        with np.errstate(all="ignore"):
            correction = _corrected(step, z.apart())
        lost = ~np.isfinite(correction)  # two points that are one, or a slope of zero: elsewhere
        correction[lost] = 1e-3 * z.high[lost] * np.exp(1j * np.flatnonzero(lost))
        z.less(np.where(active, correction, 0.0))
        active &= ~(np.abs(correction) <= DONE * np.abs(z.high))
        if not active.any():
            break
    return z


class _Value(NamedTuple):
    """``p = 2^exponent (re + j im)`` and ``2^unit p'`` likewise, off by ``error`` in these units at most."""

    value: tuple[int, int]
    slope: tuple[int, int]
    error: int
    exponent: int
    unit: int


def _evaluated(p: _Polynomial, z: _Points, i: int, bits: int) -> _Value:
    """Horner's rule in whole numbers at ``z = 2^unit w``, |w| < 1: errors are about 2^-bits of the largest term."""
    size = math.log2(abs(z.high[i]))
    unit = math.floor(size) + 1
    x, y = (int(part * Fraction(2) ** (bits - unit)) for part in z.exactly(i))
    exponent = math.ceil((p.log2 + size * np.arange(p.n + 1)).max()) - bits
    a = b = c = d = 0  # value a + j b, slope c + j d
    shift = unit * p.n - exponent
    for whole in reversed(p.f):
        c, d = ((c * x - d * y) >> bits) + a, ((c * y + d * x) >> bits) + b
        a, b = ((a * x - b * y) >> bits) + (whole << shift if shift >= 0 else whole >> -shift), (a * y + b * x) >> bits
        shift -= unit
    return _Value((a, b), (c, d), 4 * (p.n + 1) ** 2, exponent, unit)


def _newton(p: _Polynomial, z: _Points, i: int, bits: int) -> tuple[complex, int]:
    """``p / p'`` to STEP bits, or less where it is below the last digit of z; and the bits that it took."""
    while True:
        at = _evaluated(p, z, i, bits)
        value, slope = max(map(abs, at.value)), max(map(abs, at.slope))
        if min(value, slope) > at.error << STEP or slope > (value + at.error) << 106:
            (a, b), (c, d) = at.value, at.slope
            size = c * c + d * d
            return complex((a * c + b * d) / size, (b * c - a * d) / size) * 2.0**at.unit, bits
        bits *= 2


def _told_apart(p: _Polynomial, z: _Points) -> tuple[Mask, Mask]:
    """Which roots are real, and which lie above: from discs with one root each."""
    apart, radius = np.abs(z.apart()), np.empty(p.n)
    for i in range(p.n):
        bits = 2 * BITS
        while True:
            at = _evaluated(p, z, i, bits)
            size = 1.5 * max(map(abs, at.value)) + at.error
            with np.errstate(divide="ignore"):
                rest = np.log2(np.delete(apart[i], i)).sum()
            known = math.log2(size) + at.exponent - p.log2[-1] - rest
            radius[i] = p.n * 2.0 ** min(known, 1000.0)
            if radius[i] <= DONE * abs(z.high[i]) or size > 4 * at.error:
                break
            bits *= 2
    if (apart < APART * (radius[:, None] + radius)).any():
        raise NoTrustworthyNumber("roots", "roots so close together that 30 digits do not tell them apart")
    real = np.abs(z.high.imag) <= radius
    return real, ~real & (z.high.imag > 0)


def _float(part: Fraction) -> float:
    try:
        return float(part)
    except OverflowError:
        return math.inf if part > 0 else -math.inf
