r"""Stacks of complex matrices in twice the working precision: unevaluated sums of two doubles.

.. math:: x = x_{hi} + x_{lo}, \qquad |x_{lo}| \le \tfrac12 \operatorname{ulp}(x_{hi})

About 30 digits from ordinary arithmetic alone, the same on every machine.

References
----------
Dekker, "A floating-point technique for extending the available precision" (1971); Joldes, Muller, Popescu, "Tight and
rigorous error bounds for basic building blocks of double-word arithmetic" (2017).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import AnyArray

SPLIT = 134217729.0  # 2^27 + 1


class DoubleDouble:
    """A stack of k complex matrices; ``high`` and ``low`` have shape (2, k, n, m), real and imaginary parts first.

    Every operation has a relative error below ``unit`` in each entry's magnitude (before cancellation).
    """

    unit = 2.0**-103

    def __init__(self, high: AnyArray, low: AnyArray | None = None) -> None:
        self.high = high
        self.low = np.zeros_like(high) if low is None else low

    @classmethod
    def of(cls, matrices: AnyArray) -> DoubleDouble:
        """Complex or real double matrices, exactly."""
        return cls(np.stack([np.real(matrices), np.imag(matrices)]).astype(float))

    def rounded(self) -> AnyArray:
        """The nearest complex doubles."""
        return self.high[0] + 1j * self.high[1]

    def __abs__(self) -> AnyArray:
        return np.hypot(self.high[0], self.high[1])

    def __getitem__(self, index: Any) -> DoubleDouble:
        """Of the stack: ``x[:, rows, columns]``."""
        index = index if isinstance(index, tuple) else (index,)
        return DoubleDouble(self.high[(slice(None), *index)], self.low[(slice(None), *index)])

    def __add__(self, other: DoubleDouble) -> DoubleDouble:
        return DoubleDouble(*_sum(self.high, self.low, other.high, other.low))

    def __neg__(self) -> DoubleDouble:
        return DoubleDouble(-self.high, -self.low)

    def __sub__(self, other: DoubleDouble) -> DoubleDouble:
        return self + -other

    def __mul__(self, other: DoubleDouble) -> DoubleDouble:
        """Entry by entry, with broadcasting."""
        high, low = _product(self.high[:, None], self.low[:, None], other.high[None], other.low[None])
        one = np.stack([high[0, 0], high[0, 1]]), np.stack([low[0, 0], low[0, 1]])
        two = np.stack([-high[1, 1], high[1, 0]]), np.stack([-low[1, 1], low[1, 0]])
        return DoubleDouble(*_sum(*one, *two))

    def __matmul__(self, other: DoubleDouble) -> DoubleDouble:
        k, n, m = self.high.shape[1], self.high.shape[2], other.high.shape[3]
        total = DoubleDouble(np.zeros((2, k, n, m)))
        for i in range(self.high.shape[3]):
            total = total + self[:, :, i : i + 1] * other[:, i : i + 1, :]
        return total


def inverse(A: DoubleDouble) -> tuple[DoubleDouble, AnyArray]:
    """Inverse and logarithm of the determinant (k,) of every matrix, by Gauss-Jordan elimination with row exchanges.

    NaN where a pivot is zero.
    """
    k, n = A.high.shape[1], A.high.shape[2]
    eye = np.zeros((2, k, n, n))
    eye[0] = np.eye(n)
    work = DoubleDouble(np.concatenate([A.high, eye], axis=3), np.concatenate([A.low, np.zeros_like(eye)], axis=3))
    log_det, each = np.zeros(k, complex), np.arange(k)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for i in range(n):
            pivot = i + np.argmax(abs(work[:, i:, i]), axis=1)
            for part in (work.high, work.low):
                part[:, each, pivot], part[:, :, i] = part[:, :, i].copy(), part[:, each, pivot].copy()
            top = work[:, i : i + 1, :]
            head = top.rounded()[:, 0, i]
            log_det += np.log(head) + np.where(pivot != i, 1j * np.pi, 0)
            top = top * _reciprocal(top[:, :, i : i + 1])
            column = work[:, :, i : i + 1]
            column = DoubleDouble(column.high.copy(), column.low.copy())
            column.high[:, :, i], column.low[:, :, i] = 0.0, 0.0
            work = work - column * top
            work.high[:, :, i], work.low[:, :, i] = top.high[:, :, 0], top.low[:, :, 0]
    return work[:, :, n:], log_det


def sum_of_products(*pairs: tuple[AnyArray, AnyArray]) -> AnyArray:
    """``X1 @ Y1 + X2 @ Y2 + ...`` of real matrices, shape (n, m), rounded once: what cancels in it keeps its digits."""
    return close_sum_of_products(*pairs)[0]


def close_sum_of_products(*pairs: tuple[AnyArray, AnyArray]) -> tuple[AnyArray, AnyArray]:
    """The same in two parts, the rounded sum and what it leaves out; the error is 2^-100 of the terms' sizes."""
    shape = len(pairs[0][0]), pairs[0][1].shape[1]
    total = np.zeros(shape), np.zeros(shape)
    for x, y in pairs:
        for k in range(len(y)):
            total = _sum(*total, *_product(x[:, k : k + 1], 0.0, y[k : k + 1], 0.0))
    return total


def _reciprocal(x: DoubleDouble) -> DoubleDouble:
    """``1/x``: Newton's iteration from ordinary precision."""
    found = DoubleDouble.of(1 / x.rounded())
    two = DoubleDouble.of(np.full(x.high.shape[1:], 2.0))
    for _ in range(2):
        found = found * (two - x * found)
    return found


def _two_sum(a: AnyArray, b: AnyArray) -> tuple[AnyArray, AnyArray]:
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def _normal(s: AnyArray, e: AnyArray) -> tuple[AnyArray, AnyArray]:
    t = s + e
    return t, e - (t - s)


def _sum(a: AnyArray, a_low: AnyArray, b: AnyArray, b_low: AnyArray) -> tuple[AnyArray, AnyArray]:
    s, e = _two_sum(a, b)
    t, f = _two_sum(a_low, b_low)
    s, e = _normal(s, e + t)
    return _normal(s, e + f)


def _halves(a: AnyArray) -> tuple[AnyArray, AnyArray]:
    c = SPLIT * a
    high = c - (c - a)
    return high, a - high


def _product(a: AnyArray, a_low: AnyArray | float, b: AnyArray, b_low: AnyArray | float) -> tuple[AnyArray, AnyArray]:
    p = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    e = ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2
    return _normal(p, e + (a * b_low + a_low * b))
