"""Loops as fractions of polynomials with whole coefficients, and where on the axis they have gain 1 or are real."""

# L = N / D, D = det(loop opened), N + D = det(loop closed), of one matrix that holds A, B, C, D of plant and
# controller as given. With N(j omega) = N_e(x) + j omega N_o(x), x = omega^2: |L| = 1 where N_e^2 + x N_o^2 - D_e^2 -
# x D_o^2 = 0, L real where N_o D_e - N_e D_o = 0. Their positive roots are the crossings, all of them; nothing is
# rounded before.

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.exact import (
    MOST_STATES,
    all_left,
    determinant,
    even_and_odd,
    from_the_circle,
    roots,
    wired,
)
from robustlab.statespace import StateSpaceModel

if TYPE_CHECKING:
    from flint import fmpz_poly

# |L| (or the angle of L to the real axis) this near to 1 (to 0) without reaching it, compared with its neighbourhood:
# it is touched. Complex roots x whose imaginary part is a larger share of them than BESIDE are not looked at for that.
TOUCHED = Fraction(1, 10**9)
BESIDE = Fraction(1, 10)


@dataclass(frozen=True, eq=False)
class Point:
    """The loop at one frequency: ``real + j omega imag``, exactly."""

    real: Fraction
    imag: Fraction
    x: Fraction  # omega^2

    @property
    def size_squared(self) -> Fraction:
        """``|L|^2``."""
        return self.real**2 + self.x * self.imag**2

    def lag(self) -> float:
        """From a response of size 1 to -1, in rad."""
        return math.atan2(math.copysign(_square_root(self.x * self.imag**2), -self.imag), -self.real)


@dataclass(frozen=True, eq=False)
class LoopFraction:
    """A loop N / D without common factors; powers of s, or of ``v = (z - 1) / (z + 1)`` of a discrete loop."""

    N: fmpz_poly
    D: fmpz_poly
    dt: float

    @property
    def last_frequency(self) -> float:
        """The end of the axis in rad/s."""
        return math.pi / self.dt if self.dt else math.inf

    def frequency(self, x: Fraction) -> float:
        """In rad/s."""
        omega = _square_root(x)
        return 2 / self.dt * math.atan(omega) if self.dt else omega

    @cached_property
    def _parts(self) -> tuple[fmpz_poly, fmpz_poly, fmpz_poly, fmpz_poly]:
        return *even_and_odd(self.N), *even_and_odd(self.D)

    def at(self, x: Fraction) -> Point | None:
        """The response at ``omega = sqrt(x)``; None at a pole."""
        ne, no, de, do = (_value(part, x) for part in self._parts)
        size = de**2 + x * do**2
        return Point((ne * de + x * no * do) / size, (no * de - ne * do) / size, x) if size else None

    def at_infinity(self) -> Fraction:
        """The real limit at infinite frequency (z = -1); D is the larger polynomial, or as large."""
        if self.N.degree() > (degree := self.D.degree()):
            raise NoTrustworthyNumber("classical_margins", "a loop of infinite gain at the end of the axis")
        return Fraction(int(self.N[degree]), int(self.D[degree]))

    def with_gain_one(self) -> list[Fraction] | None:
        """``omega^2`` of all frequencies where ``|L| = 1``; None where it is 1 everywhere, to within TOUCHED."""
        from flint import fmpz_poly

        ne, no, de, do = self._parts
        found = _size_squared(ne, no) - _size_squared(de, do)
        size = _size_squared(*(fmpz_poly([abs(c) for c in part.coeffs()]) for part in (de, do)))
        if all(abs(found[k]) * TOUCHED.denominator <= size[k] for k in range(found.degree() + 1)):
            return None
        return self._crossed(found, lambda at: abs(at.size_squared - 1))

    def with_real_response(self) -> list[Fraction]:
        """``omega^2`` of all positive frequencies where L is real; none where it is real everywhere."""
        ne, no, de, do = self._parts
        return self._crossed(
            no * de - ne * do, lambda at: at.x * at.imag**2 / at.size_squared if at.size_squared else Fraction(1)
        )

    def _crossed(self, f: fmpz_poly, height: Callable[[Point], Fraction]) -> list[Fraction]:
        """Positive roots of f by rising size, and where a height comes so near to zero that it counts as touched."""
        found = list[Fraction]()
        for root in roots(f):
            if root.re <= 0 or not 0 <= root.im < BESIDE * root.re:
                continue
            if root.im:
                here, *beside = (self.at(root.re * share) for share in (1, 1 - 2 * BESIDE, 1 + 2 * BESIDE))
                near = min([Fraction(1), *(height(point) for point in beside if point is not None)])
                if here is None or height(here) > TOUCHED * near:
                    continue
            found.append(root.re)
        return sorted(found)

    def stable_with(self, factor: float) -> bool:
        """Whether the loop is stable when it is closed with so much gain; modes of no loop are left out."""
        gain = Fraction(factor)
        closed = self.D * gain.denominator + self.N * gain.numerator
        return closed.degree() == self.D.degree() and all_left(closed)


def loop_fractions(
    P: StateSpaceModel, K: StateSpaceModel, sign: int, places: Iterable[int]
) -> tuple[bool, list[LoopFraction]]:
    """Whether the loop ``y = P u``, ``u = sign K y`` is stable, and what each loop is with the others closed."""
    n, k, m, p = P.n_states, K.n_states, P.n_inputs, P.n_outputs
    if n + k > MOST_STATES:
        found = f"a loop of {n + k} states"
        hint = "rl.reduce_model; or cut the axis: rl.classical_margins(rl.with_delays(P), K)"
        raise NoTrustworthyNumber("classical_margins", found, f"at most {MOST_STATES}", hint)
    u, y = np.split(np.arange(m + p), [m])
    M, _ = wired([(P, u, y, 1), (K, y, u, sign)], -np.eye(m + p))
    (closed, scale), found = determinant(M, n + k), list[LoopFraction]()
    for place in places:
        cut = M.copy()
        signal = n + k + place
        cut[:signal, signal] = cut[signal + 1 :, signal] = 0.0
        D, exponent = determinant(cut, n + k)
        if D.degree() < n + k and not P.dt:
            raise NoTrustworthyNumber("classical_margins", "a loop of infinite gain at infinite frequency")
        D, whole = D * (1 << max(exponent - scale, 0)), closed * (1 << max(scale - exponent, 0))
        N = whole - D
        if P.dt:
            N, D = from_the_circle(N, n + k), from_the_circle(D, n + k)
        shared = N.gcd(D)
        found.append(LoopFraction(N // shared, D // shared, P.dt))
    poles = from_the_circle(closed, n + k) if P.dt else closed
    return poles.degree() == n + k and all_left(poles), found


def _size_squared(even: fmpz_poly, odd: fmpz_poly) -> fmpz_poly:
    """``even^2 + x odd^2``."""
    return even * even + (odd * odd).left_shift(1)


def _value(f: fmpz_poly, x: Fraction) -> Fraction:
    """``f(x)``."""
    from flint import fmpq

    found = f(fmpq(x.numerator, x.denominator))
    return Fraction(int(found.p), int(found.q))


def _square_root(x: Fraction) -> float:
    """Also of what overflows."""
    half = (x.numerator.bit_length() - x.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(x / Fraction(4) ** half), half) if x else 0.0
