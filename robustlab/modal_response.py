r"""Frequency responses from one eigenvalue decomposition, with a bound of their error at every frequency.

.. math:: \hat G(s) = \hat C (s I - \Lambda)^{-1} \hat B + D, \qquad \hat C = C V, \quad V \hat B = B, \quad
   V^{-1} A V = \Lambda + F

A frequency costs n products instead of the n^3/3 of a linear system. Nothing is trusted: what V leaves of A and B is
computed, rounding included, and what it can move the response by is told beside it. Where modes are nearly the same
the bound is large, and the response has to be computed from A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robustlab.arrays import AnyArray

EPS = float(np.finfo(float).eps)
# Share of the inverse of V that may be rounding, and |F (sI - Lambda)^-1|: beyond them first-order bounds mean nothing.
KNOWN = 0.01
# Stands for the terms of second order, which the two shares keep below it.
SECOND_ORDER = 1.25
# Numbers of an array that stays in the cache: larger ones cost fresh pages of memory, which take longer than the sums.
STRETCH = 3000


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
            # Real times complex as real products: half the work.
            turned = (A @ V.view(float)).view(V.dtype)
            left = np.abs(turned - V * poles) + u * (np.abs(A) @ size + size * np.abs(poles))
            missed = np.abs(B - V @ into) + u * (np.abs(B) + size @ np.abs(into))
            return cls(
                poles, into, out, D, (_lengths(into, 1), _lengths(out, 0), _lengths(size, 0), float(np.linalg.norm(D))),
                back @ left, back @ missed, u * (np.abs(C) @ size),
            )  # fmt: skip

    @cached_property
    def _terms(self) -> AnyArray:
        """``out[:, k] into[k]`` of every mode, shape (n, p m): the sum over the modes is a product with it."""
        return (self.out.T[:, :, None] * self.into[:, None, :]).reshape(len(self.poles), self.direct.size)

    @cached_property
    def _weights(self) -> tuple[AnyArray, AnyArray, AnyArray, float]:
        """What `response` weighs its modes by: column sums of F, errors of rows and columns, rounding of D."""
        into_size, _, _, direct_size = self.sizes
        rounding = (len(self.poles) + 8) * EPS
        rows = _lengths(self.into_error, 1) + rounding * into_size
        return self.defect.sum(0), rows, _lengths(self.out_error, 0), rounding * direct_size

    def _stretches(self, evaluate: Callable[[AnyArray], tuple[AnyArray, ...]], s: AnyArray) -> tuple[AnyArray, ...]:
        """What ``evaluate`` makes of the points, a stretch at a time."""
        step = max(1, STRETCH // len(self.poles))
        with np.errstate(all="ignore"):  # a point on a pole has an infinite bound
            if len(s) <= step:
                return evaluate(s)
            parts = [evaluate(s[first : first + step]) for first in range(0, len(s), step)]
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))

    def response(self, s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        r"""``G(s)`` at finite points s, shape (k, p, m), bounds of its error, and of ``|(sI - A)^{-1} B|``.

        .. math:: |G - \hat G| \le |\hat C R| F |R \hat B| + |\hat C R| f_B + f_C |R \hat B| + \text{rounding},
           \qquad R = (s I - \Lambda)^{-1}

        to first order, in Frobenius norms; infinite where that order does not suffice.
        """
        into_size, out_size, modes, _ = self.sizes
        spread, rows, columns, rest = self._weights

        def evaluate(s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
            R = 1.0 / (s[:, None] - self.poles)
            near = np.abs(R)
            reach, see = near * into_size, near * out_size
            error = np.einsum("ij,ij->i", see @ self.defect, reach) + see @ rows + reach @ columns + rest
            sound = ((near * spread).max(1) < KNOWN) & (error < np.inf)
            found = (R @ self._terms).reshape(len(s), *self.direct.shape) + self.direct
            return found, np.where(sound, SECOND_ORDER * error, np.inf), reach @ modes

        found, error, reach = self._stretches(evaluate, s)
        return found, error, reach

    def entries(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        """`response` with a bound of the error of every entry, shape (k, p, m); NaN where that is infinite."""
        into, out, spread = np.abs(self.into), np.abs(self.out), self._weights[0]
        rounding = (len(self.poles) + 8) * EPS
        columns, rest = self.out_error + rounding * out, rounding * np.abs(self.direct)

        def evaluate(s: AnyArray) -> tuple[AnyArray, AnyArray]:
            R = 1.0 / (s[:, None] - self.poles)
            near = np.abs(R)
            see, reach = near[:, None, :] * out, near[:, :, None] * into
            error = (see @ self.defect + columns) @ reach + see @ self.into_error + rest
            sound = ((near * spread).max(1) < KNOWN)[:, None, None] & (error < np.inf)
            found = (R @ self._terms).reshape(error.shape) + self.direct
            return np.where(sound, found, np.nan), np.where(sound, SECOND_ORDER * error, np.inf)

        found, error = self._stretches(evaluate, s)
        return found, error

    def gains(self, s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """``sigma_max(G(s))``, shape (k,), with the bounds of `response`."""
        found, error, reach = self.response(s)
        with np.errstate(all="ignore"):
            gain = largest_gain(found)
        sound = np.isfinite(gain)
        return np.where(sound, gain, 0.0), np.where(sound, error, np.inf), reach

    def mean_square(self, discrete: bool) -> tuple[float, float]:
        r"""The square of the H2 norm of a stable model, strictly proper where it is continuous, and bound of its error.

        .. math:: \|\hat G\|_2^2 = \|D\|_F^2 + \sum_{k,l} \frac{\hat c_l^* \hat c_k \, \hat b_k \hat b_l^*}
           {-\lambda_k - \bar\lambda_l} \qquad (1 - \lambda_k \bar\lambda_l \text{ below, discrete}), \qquad
           \|G - \hat G\|_2 \le \sum_{k,l} |\hat c_k| F_{kl} |\hat b_l| \|r_k r_l\|_2 + \sum_k \|r_k\|_2
           (|\hat c_k| f_{B,k} + f_{C,k} |\hat b_k|), \quad r_k = \frac{1}{s - \lambda_k}, \quad \|r_k r_l\|_2^2 =
           \frac{\|r_k\|_2^2 + \|r_l\|_2^2}{|\lambda_k + \bar\lambda_l|^2}

        (one less above and ``|1 - \lambda_k \bar\lambda_l|^2`` below, discrete): the residues of the integral over the
        frequency axis, and a bound to first order, infinite where that does not do.
        """
        into_size, out_size, _, direct_size = self.sizes
        poles, n = self.poles, len(self.poles)
        with np.errstate(all="ignore"):
            decay = 1 - np.abs(poles) if discrete else -np.real(poles)
            if not decay.min() > 0:
                return np.inf, np.inf
            together = np.outer(poles, poles.conj())
            together = 1 - together if discrete else -np.add.outer(poles, poles.conj())
            near, both = 1 / np.abs(together), into_size * out_size
            products = (self.into @ self.into.conj().T) * (self.out.T @ self.out.conj())
            square = float((products / together).real.sum()) + direct_size**2
            lost = (n + sum(self.direct.shape) + 16) + (8 * near if discrete else 0.0)
            rounding = EPS * float(both @ (near * lost) @ both + 8 * direct_size**2)
            length = np.diag(near)
            pair = near * np.sqrt(np.add.outer(length, length) - discrete)
            apart, length = out_size @ (self.defect * pair) @ into_size, np.sqrt(length)
            apart += (out_size * length) @ _lengths(self.into_error, 1) + (into_size * length) @ _lengths(
                self.out_error, 0
            )
            apart *= SECOND_ORDER
            error = 2 * np.sqrt(max(square, 0.0)) * apart + apart**2 + rounding
            sound = (self._weights[0] / decay).max() < KNOWN and error < np.inf
        return square, float(error) if sound else np.inf

    def proves_stable(self, discrete: bool) -> bool:
        """Whether Gershgorin puts every eigenvalue of ``Lambda + F`` in the open left half plane, or the unit disk."""
        margin = 1 - np.abs(self.poles) if discrete else -np.real(self.poles)
        return bool((margin > SECOND_ORDER * self._weights[0] + 4 * EPS).all())

    def log_determinant(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        r"""``log det(sI - A)`` at finite points s, shape (k,), up to whole turns, and bounds of its error.

        .. math:: \log\det(sI - A) = \sum_k \log(s - \lambda_k) + \log\det(I - R F), \qquad
           |\log\det(I - X)| \le \mathrm{tr} |X| + n q^2 / (1 - q), \quad q = \||X|\|_1

        Infinite where q is no small number.
        """
        spread, own, n = self._weights[0], np.diag(self.defect), len(self.poles)

        def evaluate(s: AnyArray) -> tuple[AnyArray, AnyArray]:
            apart = s[:, None] - self.poles
            logs, near = np.log(apart), 1.0 / np.abs(apart)
            worst = (near * spread).max(1)
            error = near @ own + n * worst**2 / (1 - worst) + 8 * EPS * (np.abs(logs).sum(1) + n)
            return logs.sum(1), np.where((worst < KNOWN) & (error < np.inf), SECOND_ORDER * error, np.inf)

        logs, error = self._stretches(evaluate, s)
        return logs, error


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
