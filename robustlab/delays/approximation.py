r"""Rational delays: the diagonal Padé approximation of any order, and a proved bound of its error at all frequencies.

With :math:`R_n(s) = Q_n(-s) / Q_n(s)`, :math:`Q_n(0) = 1`, the approximation of :math:`e^{-s}`, for all x >= 0

.. math:: |e^{-jx} - R_n(jx)| = 2 \left| \sin \tfrac12 \theta_n(x) \right| \le \min(2, c_n x^{2n+1}), \qquad
   \theta_n'(x) = \left( \frac{n!}{(2n)!} \right)^2 \frac{x^{2n}}{|Q_n(jx)|^2}, \qquad |Q_n(jx)| \ge 1 .

Lam, "Model reduction of delay systems using Padé approximants", Int. J. Control 57 (1993).
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache, lru_cache
from math import factorial, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel, series

if TYPE_CHECKING:
    from flint import fmpz_poly

# Times in s beyond which squares of corner frequencies overflow; the longest is one over it.
SHORTEST = 1e-100
# Above this order |Q_n| leaves double precision at the frequencies where the error is large.
HIGHEST_ORDER = 40
# Gain of the weight at high frequencies; the error itself reaches 2. Nearer to 2, the weight is larger below.
HIGH_GAIN = 2.2
# Cells of the proof, the phase at which they begin, and their allowance for rounding.
CELLS, FIRST_PHASE, ROUNDING = 4000, 1e-4, 1e-9
# Below the first cell the approximation error is at most this share of the spread's.
FIRST_SHARE = 0.02


def _polynomial(order: int) -> fmpz_poly:
    """Return :math:`P_n = (2n)!/n! Q_n`: ``P_k = (4k - 2) P_(k-1) + s^2 P_(k-2)``."""
    from flint import fmpz_poly

    before, last = fmpz_poly([1]), fmpz_poly([2, 1])
    for k in range(2, order + 1):
        before, last = last, (4 * k - 2) * last + before.left_shift(2)
    return last if order else before


@cache
def phase_bound(order: int) -> float:
    r"""Return c_n of the bound :math:`\theta_n(x) \le c_n x^{2n+1}`, proved for all x >= 0 in whole numbers."""
    from flint import fmpz_poly

    p, minus = _polynomial(order), fmpz_poly([0, -1])
    square = p * p(minus)  # P(s) P(-s), in s = jx: the coefficient of s^2i belongs to (-1)^i x^2i
    rate = square - p.derivative() * p(minus) - p * p.derivative()(minus)
    positive = all(square[2 * i] * (-1) ** i > 0 and not square[2 * i + 1] for i in range(order + 1))
    if rate != fmpz_poly([0] * (2 * order) + [(-1) ** order]) or not positive:
        raise NoTrustworthyNumber("pade", f"the error bound of order {order} could not be proved")
    ratio = Fraction(factorial(order), factorial(2 * order))
    return float(ratio * ratio / (2 * order + 1))


def phase_error(x: ArrayLike, order: int) -> Array:
    r""":math:`\theta_n(x)` modulo :math:`2 \pi`, in :math:`(-\pi, \pi]`; x is frequency times delay."""
    point = np.asarray(x, dtype=np.float64)
    before, last = np.ones_like(point, dtype=complex), 2.0 + 1j * point
    if order == 0:
        last = before
    for k in range(2, order + 1):  # scaled at each step: the numbers themselves grow as (2n)!
        before, last = last / (4 * k - 2), last - point**2 * before / (4 * k - 2)
    return np.angle(np.exp(1j * point) * (last.conj() / last))


def pade(delay: float, order: int) -> StateSpaceModel:
    r"""Return the Padé approximation of :math:`e^{-s d}` with equal degrees, of an order from 0 to 40: an all-pass."""
    # Its states are coefficients of Legendre polynomials (Lanczos's tau method): A + A' = -B B', C = -+B'.
    if not 0 < delay < np.inf:
        raise InputError("pade", f"a delay of {delay!r} s", "a positive number of seconds")
    checked_order(order, "pade")
    i, sign = np.arange(order), (-1.0) ** order
    size, odd = np.sqrt(2.0 * i + 1.0), (order - i) % 2.0
    a = 2.0 * np.outer(size, size) * (np.tril((i[:, None] - i) % 2) - odd)
    c = 2.0 * (odd * size)[None] / sqrt(delay)
    return StateSpaceModel(a / delay, -sign * c.T, c, [[sign]], states=[f"delay.{k + 1}" for k in i])


def checked_order(order: int, where: str, least: int = 0) -> int:
    """Return the order; reject one that no Padé approximation has."""
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not least <= order <= HIGHEST_ORDER:
        raise InputError(f"{where}: order", f"{order!r}", f"a whole number from {least} to {HIGHEST_ORDER}")
    return order


class ErrorWeight(NamedTuple):
    """A weight for a delay of 1 s: :math:`|W|^2 = (g^2 x^{2k} + r^2 a^{2k} x^2) / (x^{2k} + a^{2k})`."""

    gain: float
    corner: float
    order: int
    slope: float = 0.0

    def scaled(self, delay: float) -> StateSpaceModel:
        """The weight for a delay in s, as a model with ``order`` states."""
        zero = (self.slope / self.gain * self.corner**self.order) ** (1.0 / (self.order - 1)) if self.slope else 0.0
        return high_pass(self.gain, self.corner / delay, self.order, zero / delay)


@lru_cache(maxsize=256)
def error_weight(order: int, weight_order: int, spread: float = 0.0) -> ErrorWeight:
    r"""Return the weight with the highest corner that the proof below allows; for all delays of 1 +- ``spread``.

    The phase of :math:`e^{-jx(1+\delta)}` is off by at most :math:`\theta_n + s x`, s the spread; the error rises with
    it, up to 2. Below the first cell the bound :math:`c_n x^{2n+1}` decides at the end of that interval, as k is at
    most 2n + 1; with a spread r is the largest slope of the error there, and W is above the smaller of r x and g. In
    each cell after it, x its beginning and E the error at its end, :math:`a^{2k} (r^2 x^2 - E^2) + x^{2k} (g^2 - E^2)
    \ge 0` is required. Where the phase has reached :math:`\pi` the error is at most 2, and the left side still rises.
    """
    c, power, s = phase_bound(order), 2 * order + 1, spread
    if s and not order:  # no approximation: the error is that of the longest delay
        shape = error_weight(0, weight_order)
        return shape._replace(corner=shape.corner / (1.0 + s))
    k, least = weight_order, 2 if s else 1
    if isinstance(k, bool) or not isinstance(k, int) or not least <= k <= power:
        raise InputError("uncertain: weight_order", f"{k!r}", f"a whole number from {least} to {power}")
    first, slope = (FIRST_PHASE / c) ** (1.0 / power), 0.0
    if s:
        first = min(first, (FIRST_SHARE * s / c) ** (1.0 / (power - 1)))
        slope = (s + c * first ** (power - 1)) * (1.0 + ROUNDING)
    last = 2.0 * (np.pi / c) ** (1.0 / power) + 2.0 * np.pi
    spaced = np.geomspace if s else np.linspace  # a slope is tightest at low frequencies
    x = spaced(first, last, CELLS + 1)  # cells shorter than a half turn: the phase can be followed
    theta = np.unwrap(phase_error(x, order))
    theta += 2.0 * np.pi * np.round((FIRST_PHASE - theta[0]) / (2.0 * np.pi))
    rising = 2.0 * np.sin(0.5 * np.clip(theta + s * x + ROUNDING, 0.0, np.pi))
    error = np.minimum(np.maximum.accumulate(rising), (c * x**power + s * x) * (1.0 + ROUNDING))
    error = np.minimum(error, 2.0)
    if theta[-1] + s * x[-1] < np.pi:
        error[-1] = 2.0  # no bound is known beyond
    begin = np.concatenate([[first], x[:-1]])
    until_first = min((c * first**power + s * first) * (1.0 + ROUNDING), 2.0)
    end = np.concatenate([[until_first], error[1:]])
    above = end**2 - (slope * begin) ** 2  # where negative, the slope alone suffices
    short = above > 0
    corners = begin[short] * ((HIGH_GAIN**2 - end[short] ** 2) / above[short]) ** (0.5 / k)
    corner = float(corners.min(initial=HIGH_GAIN / slope if slope else np.inf))  # where the slope meets g: no peak
    return ErrorWeight(HIGH_GAIN, corner * (1.0 - ROUNDING), k, slope)


def high_pass(gain: float, corner: float, order: int, zero: float = 0.0) -> StateSpaceModel:
    """Return a high-pass with Butterworth's poles and zeros on circles of these radii in rad/s, and a zero at 0."""
    # Sections with zeros at 0 block a constant exactly: at low frequencies the product keeps its digits.
    whole = StateSpaceModel([], [], [], [[gain]])
    pairs = _circle(zero, order - 1) if zero else [(0.0, 0.0)] * (order // 2)
    if order % 2:
        whole = series(whole, StateSpaceModel([[-corner]], [[corner]], [[-1.0]], [[1.0]]))
    elif zero:
        pairs = [(zero, 0.0), *pairs]  # s (s + z)
    for (damping, _), (n1, n0) in zip(_circle(corner, order), pairs, strict=True):
        a = [[-damping, -corner], [corner, 0.0]]
        c = [[(n1 - damping) / corner, n0 / corner**2 - 1.0]]
        whole = series(whole, StateSpaceModel(a, [[corner], [0.0]], c, [[1.0]]))
    states = [f"weight.{k + 1}" for k in range(order)]
    return StateSpaceModel(whole.A, whole.B, whole.C, whole.D, states=states)


def _circle(radius: float, order: int) -> list[tuple[float, float]]:
    """Return the factors ``s^2 + d s + e`` of Butterworth's polynomial; an odd order also has ``s + radius``."""
    return [(2.0 * np.sin(np.pi * (2 * i + 1) / (2 * order)) * radius, radius * radius) for i in range(order // 2)]
