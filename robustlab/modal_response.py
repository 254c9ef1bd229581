r"""Frequency responses from one eigenvalue decomposition, with a bound of their error at every frequency.

.. math:: \hat G(s) = \hat C (s I - \Lambda)^{-1} \hat B + D, \qquad \hat C = C V, \quad V \hat B = B, \quad
   V^{-1} A V = \Lambda + F

A frequency costs n products instead of the n^3/3 of a linear system. Nothing is trusted: what V leaves of A and B is
computed, rounding included, and what it can move the response by is told beside it. Where modes are nearly the same
the bound is large, and the response has to be computed from A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray

EPS = float(np.finfo(float).eps)
# Share of the inverse of V that may be rounding, and |F (sI - Lambda)^-1|: beyond them first-order bounds mean nothing.
KNOWN = 0.01
# Stands for the terms of second order, which the two shares keep below it.
SECOND_ORDER = 1.25


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
        into_size, out_size, modes, direct_size = self.sizes
        with np.errstate(all="ignore"):  # a point on a pole has an infinite bound
            found, near = self._values(s)
            into_defect, out_defect = _lengths(self.into_error, 1), _lengths(self.out_error, 0)
            reach, see = near * into_size, near * out_size
            error = ((see @ self.defect) * reach).sum(1) + see @ into_defect + reach @ out_defect
            error += (len(self.poles) + 8) * EPS * (see @ into_size + direct_size)
            sound = ((near * self.defect.sum(0)).max(1) < KNOWN) & (error < np.inf)
        return found, np.where(sound, SECOND_ORDER * error, np.inf), reach @ modes

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
