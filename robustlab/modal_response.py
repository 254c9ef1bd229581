r"""Frequency responses from one eigenvalue decomposition, with a bound of their error at every frequency.

.. math:: \hat G(s) = \hat C (s I - \Lambda)^{-1} \hat B + D, \qquad \hat C = C V, \quad V \hat B = B, \quad
   V^{-1} A V = \Lambda + F

A frequency costs n products instead of the n^3/3 of a linear system. Nothing is trusted: what V leaves of A and B is
computed, rounding included, and what it can move the response by is told beside it. Where modes are nearly the same
the bound is large, and the response has to be computed from A.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from robustlab.arrays import AnyArray

__all__ = ["ModalResponse", "largest_gain"]

EPS = float(np.finfo(float).eps)
# Share of the inverse of V that may be rounding, and |F (sI - Lambda)^-1|: beyond them first-order bounds mean nothing.
KNOWN = 0.01
# Stands for the terms of second order, which the two shares keep below it.
SECOND_ORDER = 1.25
# Terms of the expansions of `above` after the constant one, and the share of a radius of convergence that is used.
DEGREE, RADIUS = 4, 0.9
# Share that rounding may be of a bound that comes from the squares of these terms.
SQUARED = 1e-12


@dataclass(frozen=True, eq=False)
class ModalResponse:
    """A model in the states of its modes, and how far these are from diagonalising it.

    Attributes
    ----------
    poles
        Lambda, shape (n,).
    into, out
        The rows of ``V^-1 B``, shape (n, m), and the columns of ``C V``, shape (p, n).
    direct
        D, shape (p, m).
    sizes
        Norms of the rows of ``into``, of the columns of ``out``, of V's columns and of D.
    defect, into_error, out_error
        Bounds of the entries of F, shape (n, n), and of what rounding added to those of ``into`` and ``out``.
    """

    poles: AnyArray
    into: AnyArray
    out: AnyArray
    direct: AnyArray
    sizes: tuple[AnyArray, AnyArray, AnyArray, float]
    defect: AnyArray
    into_error: AnyArray
    out_error: AnyArray

    @classmethod
    def of(cls, A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray) -> ModalResponse | None:
        """For real matrices of shapes (n, n), (n, m), (p, n), (p, m), n > 0; None where the modes do not span."""
        with np.errstate(all="ignore"):  # what overflows here has an infinite bound
            try:
                poles, V = np.linalg.eig(A)
                poles = poles.astype(complex)
                inverse = np.linalg.inv(V)
            except np.linalg.LinAlgError:
                return None
            size, back = np.abs(V), np.abs(inverse)
            u = (len(A) + 4) * EPS  # of a sum of n products, complex ones included
            if not u * float((back @ size).max()) < KNOWN:
                return None
            into, out = inverse @ B, C @ V
            left = np.abs(A @ V - V * poles) + u * (np.abs(A) @ size + size * np.abs(poles))
            missed = np.abs(B - V @ into) + u * (np.abs(B) + size @ np.abs(into))
            return cls(
                poles, into, out, D, (_lengths(into, 1), _lengths(out, 0), _lengths(size, 0), float(np.linalg.norm(D))),
                back @ left, back @ missed, u * (np.abs(C) @ size),
            )  # fmt: skip

    def _values(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        """``G(s)``, shape (k, p, m), and ``|(sI - Lambda)^-1|``, shape (k, n)."""
        R = 1.0 / (s[:, None] - self.poles)
        p, m = self.direct.shape
        # The sum over the modes of out[:, k] into[k] R_k is a product of (points, n) with (n, p m).
        terms = (self.out.T[:, :, None] * self.into[:, None, :]).reshape(len(self.poles), p * m)
        return (R @ terms).reshape(len(s), p, m) + self.direct, np.abs(R)

    def response(self, s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        r"""``G(s)`` at finite points s, shape (k, p, m), bounds of its error, and of ``|(sI - A)^{-1} B|``.

        .. math:: |G - \hat G| \le |\hat C R| F |R \hat B| + |\hat C R| f_B + f_C |R \hat B| + \text{rounding},
           \qquad R = (s I - \Lambda)^{-1}

        to first order, in Frobenius norms; infinite where that order does not suffice.
        """
        with np.errstate(all="ignore"):  # a point on a pole has an infinite bound
            found, near = self._values(s)
            return found, self._doubt(near), (near * self.sizes[0]) @ self.sizes[2]

    def _doubt(self, near: AnyArray) -> AnyArray:
        """Bound of the error of responses, shape (k,), wherever ``|(sI - Lambda)^-1| <= near``, shape (k, n)."""
        into_size, out_size, _, direct = self.sizes
        reach, see = near * into_size, near * out_size
        error = ((see @ self.defect) * reach).sum(1) + see @ _lengths(self.into_error, 1)
        error += reach @ _lengths(self.out_error, 0) + (len(self.poles) + 8) * EPS * (see @ into_size + direct)
        sound = ((near * self.defect.sum(0)).max(1) < KNOWN) & (error < np.inf)
        return np.where(sound, SECOND_ORDER * error, np.inf)

    def entries(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        """`response` with a bound of the error of every entry, shape (k, p, m); NaN where that is infinite."""
        into, out = np.abs(self.into), np.abs(self.out)
        with np.errstate(all="ignore"):
            found, near = self._values(s)
            see, reach = near[:, None, :] * out, near[:, :, None] * into
            rounding = (len(self.poles) + 8) * EPS
            error = (see @ self.defect + self.out_error + rounding * out) @ reach + see @ self.into_error
            error += rounding * np.abs(self.direct)
            sound = ((near * self.defect.sum(0)).max(1) < KNOWN)[:, None, None] & (error < np.inf)
        return np.where(sound, found, np.nan), np.where(sound, SECOND_ORDER * error, np.inf)

    def gains(self, s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """``sigma_max(G(s))``, shape (k,), with the bounds of `response`."""
        found, error, reach = self.response(s)
        with np.errstate(all="ignore"):
            gain = largest_gain(found)
        sound = np.isfinite(gain)
        return np.where(sound, gain, 0.0), np.where(sound, error, np.inf), reach

    def above(self, level: float, ends: AnyArray, most: int) -> AnyArray | None:
        r"""Frequencies beyond the first of some increasing ones whose gain exceeds a level; empty where none does.

        A proof for all frequencies up to the last one, or of all where that is infinite. Between two, with middle c and
        half distance h, the gain is that of a polynomial in :math:`(\omega - c) / h` but for its remainder and for
        errors as in `response`; the square of a polynomial is nowhere larger than the largest of its Bernstein
        coefficients. What is left open is halved, up to ``most`` intervals: None where that does not settle it.
        """
        with np.errstate(all="ignore"):
            if not np.isfinite(ends[-1]):  # from where on the sizes of all terms are enough
                direct, sizes, size = self.sizes[3], self.sizes[0] * self.sizes[1], np.abs(self.poles)
                beyond = 1.01 * sizes.sum() / np.maximum(level - direct, 0.0)
                last = max(2 * ends[-2], 1.1 * size.max(), size.max() + beyond)
                far = 1 / (last - size)[None]
                if not (np.isfinite(last) and (far @ sizes + direct + self._doubt(far))[0] <= level):
                    return None
                ends = np.append(ends[:-1], np.geomspace(ends[-2], last, 2 + int(np.log2(last / ends[-2])))[1:])
            low, high, looked = ends[:-1], ends[1:], 0
            while len(low):
                looked, middle = looked + len(low), 0.5 * (low + high)
                if looked > most or not ((low < middle) & (middle < high)).all():
                    return None
                gain, error, top = self._over(middle, 0.5 * (high - low), level)
                if (gain - error > level).any():
                    return middle[gain - error > level]
                left = ~(top <= level)
                low, high = np.append(low[left], middle[left]), np.append(middle[left], high[left])
        return np.zeros(0)

    def _over(self, middle: AnyArray, half: AnyArray, level: float) -> tuple[AnyArray, AnyArray, AnyArray]:
        """The gain in the middle of intervals, its error, and a bound of the gain in all of each."""
        R = 1 / (1j * middle[:, None] - self.poles)
        p, m = self.direct.shape
        terms = (self.out.T[:, :, None] * self.into[:, None, :]).reshape(len(self.poles), p * m)
        share, step, power, parts = half[:, None] * np.abs(R), -1j * half[:, None] * R, R, []
        for _ in range(DEGREE + 1):
            parts.append((power @ terms).reshape(-1, p, m))
            power = power * step
        parts[0] = parts[0] + self.direct
        if p > m:  # the smaller of the two products
            parts = [part.transpose(0, 2, 1) for part in parts]
        square = np.zeros((len(middle), 2 * DEGREE + 1, min(p, m), min(p, m)), complex)
        for i, one in enumerate(parts):
            for j, two in enumerate(parts):
                square[:, i + j] += one @ two.conj().transpose(0, 2, 1)
        square = np.tensordot(square, BERNSTEIN, (1, 1)).transpose(0, 3, 1, 2)
        top = np.trace(square, axis1=2, axis2=3).real.max(1)
        # What follows the polynomial is smaller than a geometric series; each part may be off by as much as the first.
        error = self._doubt(np.where(share < RADIUS, np.abs(R) / (1 - share), np.inf))
        rest = (np.abs(power) / (1 - share)) @ (self.sizes[0] * self.sizes[1]) + (DEGREE + 1) * error
        close = (top > np.maximum(level - rest, 0.0) ** 2) & (rest < level)
        if min(p, m) > 1 and close.any():
            top[close] = np.linalg.eigvalsh(square[close])[:, :, -1].max(1)
        return largest_gain(parts[0]), error, np.sqrt(np.maximum(top, 0.0)) * (1 + SQUARED) + rest

    def log_determinant(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        r"""``log det(sI - A)`` at finite points s, shape (k,), up to whole turns, and bounds of its error.

        .. math:: \log\det(sI - A) = \sum_k \log(s - \lambda_k) + \log\det(I - R F), \qquad
           |\log\det(I - X)| \le \mathrm{tr} |X| + n q^2 / (1 - q), \quad q = \||X|\|_1

        Infinite where q is no small number.
        """
        with np.errstate(all="ignore"):
            apart = s[:, None] - self.poles
            logs, near = np.log(apart), 1.0 / np.abs(apart)
            worst = (near * self.defect.sum(0)).max(1)
            error = near @ np.diag(self.defect) + len(self.poles) * worst**2 / (1 - worst)
            error += 8 * EPS * (np.abs(logs).sum(1) + len(self.poles))
        return logs.sum(1), np.where((worst < KNOWN) & (error < np.inf), SECOND_ORDER * error, np.inf)


def _bernstein(degree: int) -> AnyArray:
    """Coefficients of powers of t in -1 .. 1, in columns, in Bernstein's basis, in rows."""
    rows = [np.poly([1.0] * (degree - i) + [-1.0] * i) for i in range(degree + 1)]  # (t - 1)^(n - i) (t + 1)^i
    return np.array([[row[k] / comb(degree, k) for k in range(degree + 1)] for row in rows])


BERNSTEIN = _bernstein(2 * DEGREE)


def largest_gain(response: AnyArray) -> AnyArray:
    """Largest singular value of every matrix of a stack (k, p, m), shape (k,)."""
    p, m = response.shape[1:]
    power = np.real(response) ** 2 + np.imag(response) ** 2
    if min(p, m) == 1:
        return np.sqrt(power.sum(axis=(1, 2)))
    if min(p, m) == 2:  # the larger root of the characteristic polynomial of G G^H, or of G^H G
        first, second = response.transpose(1, 0, 2) if p == 2 else response.transpose(2, 0, 1)
        size = power.sum(axis=2 if p == 2 else 1)
        cross = np.abs((first * second.conj()).sum(axis=1))
        return np.sqrt(0.5 * (size.sum(axis=1) + np.hypot(size[:, 0] - size[:, 1], 2 * cross)))
    if np.isfinite(power).all():
        return np.linalg.svd(response, compute_uv=False)[:, 0]
    return np.full(len(response), np.nan)


def _lengths(matrix: AnyArray, axis: int) -> AnyArray:
    return np.sqrt((np.abs(matrix) ** 2).sum(axis))
