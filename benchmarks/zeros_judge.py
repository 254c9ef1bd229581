"""Zeros and crossings of models, exactly: rational arithmetic and balls (python-flint), nothing of robustlab.

The entries are the rational numbers that they are. A determinant is evaluated at as many whole s as it takes and
interpolated; roots are isolated in balls; a model that is not square, or of lower normal rank, is compressed by random
whole matrices from both sides, and what several compressions have in common are its zeros.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from exact_loops import joined, on_the_left, rational
from flint import acb, acb_poly, arb, ctx, fmpq, fmpq_mat, fmpq_poly

ctx.prec = 400


def _at(M: fmpq_mat, n: int, s: int) -> fmpq_mat:
    found = fmpq_mat(M)
    for i in range(n):
        found[i, i] -= s
    return found


def interpolated(values: list[fmpq]) -> fmpq_poly:
    """The polynomial with these values at 0, 1, 2, ..."""
    p, w = fmpq_poly([0]), fmpq_poly([1])
    for s, value in enumerate(values):
        p += (value - p(s)) / w(s) * w
        w *= fmpq_poly([-s, 1])
    return p


def determinant(S: fmpq_mat, n: int) -> fmpq_poly:
    """``det(S - s E)``, E the identity in the first n rows and columns."""
    return interpolated([_at(S, n, s).det() if S.nrows() else fmpq(1) for s in range(n + 1)])


def roots(p: fmpq_poly) -> list[complex]:
    """All roots, each as often as it is one."""
    if p.degree() < 1:
        return []
    return [complex(ball) for ball, multiplicity in p.numer().complex_roots() for _ in range(multiplicity)]


def invariant_zeros(A: Any, B: Any, C: Any, D: Any, seed: int = 0) -> tuple[list[complex], int]:
    """All finite invariant zeros and the normal rank of the transfer matrix."""
    a, b, c, d = map(rational, (A, B, C, D))
    S, n, rng = joined([[a, b], [c, d]]), a.nrows(), np.random.default_rng(seed)
    p, m = d.nrows(), d.ncols()
    rank = (
        max((_at(S, n, int(s)).rank() for s in rng.integers(10**6, 10**9, 3)), default=0)
        if S.nrows() and S.ncols()
        else 0
    )
    if rank == n + p == n + m:
        return roots(determinant(S, n)), rank - n
    if rank == 0:
        return [], 0
    shared = fmpq_poly([0])
    for _ in range(3):
        left, right = (
            fmpq_mat(*shape, [int(x) for x in rng.integers(-(10**4), 10**4, shape).ravel()])
            for shape in ((rank, n + p), (n + m, rank))
        )
        found = interpolated([(left * _at(S, n, s) * right).det() for s in range(n + 1)])
        shared = shared.gcd(found)
    return roots(shared), rank - n


def fraction(A: Any, B: Any, C: Any, D: Any) -> tuple[fmpq_poly, fmpq_poly]:
    """Numerator and denominator of one channel, without common factors."""
    a, b, c, d = map(rational, (A, B, C, D))
    over, under = determinant(joined([[a, b], [c, d]]), a.nrows()), determinant(a, a.nrows())
    shared = over.gcd(under)
    return over / shared, under / shared


class Loop:
    """L = N / D of one channel on the axis: powers of s, or of ``v = (z - 1)/(z + 1)``."""

    def __init__(self, A: Any, B: Any, C: Any, D: Any, dt: float = 0.0) -> None:
        self.N, self.D = fraction(A, B, C, D)
        self.dt = dt
        if dt:
            n = max(self.N.degree(), self.D.degree())
            self.N, self.D = (on_the_left(p.coeffs(), fmpq_poly, n) for p in (self.N, self.D))

    def _parts(self) -> list[fmpq_poly]:
        parts = []
        for p in (self.N, self.D):
            c = [*p.coeffs(), fmpq(0), fmpq(0)]
            parts += [fmpq_poly([x * (-1) ** k for k, x in enumerate(c[i::2])]) for i in (0, 1)]
        return parts

    def crossings(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """``(omega, lag)`` where |L| = 1, ``(omega, factor)`` where L is negative, inside the axis."""
        ne, no, de, do = self._parts()
        x = fmpq_poly([0, 1])
        gain = self._positive(ne * ne + x * no * no - de * de - x * do * do)
        phase = self._positive(no * de - ne * do)
        lags = [(self._omega(r), float(self._response(r).arg() + arb.pi())) for r in gain]
        factors = [(self._omega(r), float(self._response(r).real)) for r in phase]
        return sorted(lags), sorted((w, -1 / real) for w, real in factors if real < 0)

    def _positive(self, q: fmpq_poly) -> list[arb]:
        if q.degree() < 1:
            return []
        found = [ball for ball, _ in q.numer().complex_roots()]
        return [ball.real for ball in found if ball.imag.contains(0) and ball.real > 0]

    def _omega(self, x: arb) -> float:
        w = x.sqrt()
        return float(2 * w.atan() / self.dt) if self.dt else float(w)

    def _response(self, x: arb) -> acb:
        s = acb(0, x.sqrt())
        return acb_poly(self.N)(s) / acb_poly(self.D)(s)

    def above_one(self, omega: float) -> bool:
        """Whether |L| > 1 at a frequency, by another way than the roots: exact values."""
        x = Fraction(float(np.tan(omega * self.dt / 2) if self.dt else omega)) ** 2
        at = fmpq(x.numerator, x.denominator)
        ne, no, de, do = (p(at) for p in self._parts())
        return bool(ne * ne + at * no * no > de * de + at * do * do)

    def stable_closed(self) -> bool:
        """Whether the loop closed by negative feedback has all its poles on the left."""
        closed = self.N + self.D
        return closed.degree() == max(self.N.degree(), self.D.degree()) and all(z.real < 0 for z in roots(closed))


def matched(found: list[complex], wanted: list[complex]) -> float:
    """Largest relative distance of two sets of numbers, each to a partner of its own; inf for different counts."""
    if len(found) != len(wanted):
        return np.inf
    if not found:
        return 0.0
    from scipy.optimize import linear_sum_assignment

    a, b = np.array(found)[:, None], np.array(wanted)[None, :]
    size = np.maximum(np.abs(a), np.abs(b))
    cost = np.divide(np.abs(a - b), size, out=np.zeros(size.shape), where=size > 0)
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].max())
