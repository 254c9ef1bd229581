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
from math import comb

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.statespace import StateSpaceModel

EPS = float(np.finfo(float).eps)
# Share of the inverse of V that may be rounding, and |F (sI - Lambda)^-1|: beyond them first-order bounds mean nothing.
KNOWN = 0.01
# Stands for the terms of second order, which the two shares keep below it.
SECOND_ORDER = 1.25
# Numbers of an array that stays in the cache: larger ones cost fresh pages of memory, which take longer than the sums.
STRETCH = 3000
# Terms of the expansions of `above` after the constant one, and the share of a radius of convergence that is used.
DEGREE, RADIUS = 4, 0.9
# Intervals of a round of `above` that begins with few open ones.
PIECES = 32
# Factors of a determinant that share a logarithm, and the modulus down to which their product keeps its digits.
FACTORS, UNDERFLOW = 4, 1e-290
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
    def of_model(cls, m: StateSpaceModel) -> ModalResponse | None:
        """`of`, with the eigenvectors that are known of a model; None of one without states."""
        return cls.of(m.A, m.B, m.C, m.D, vars(m).get("_eigen")) if m.n_states else None

    @classmethod
    def of(
        cls, A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, known: tuple[AnyArray, AnyArray] | None = None
    ) -> ModalResponse | None:
        """For real matrices of shapes (n, n), (n, m), (p, n), (p, m), n > 0; None where the modes do not span.

        ``known`` are eigenvalues and eigenvectors from elsewhere; whatever they are, bounds are of what they leave.
        """
        with np.errstate(all="ignore"):  # what overflows here has an infinite bound
            try:
                poles, V = known or np.linalg.eig(A)
                poles = poles.astype(complex)
                V = V if known is None else np.ascontiguousarray(V) / _lengths(V, 0)
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
        into_size, _, modes, _ = self.sizes

        def evaluate(s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
            R = 1.0 / (s[:, None] - self.poles)
            near = np.abs(R)
            found = (R @ self._terms).reshape(len(s), *self.direct.shape) + self.direct
            return found, self._doubt(near), (near * into_size) @ modes

        found, error, reach = self._stretches(evaluate, s)
        return found, error, reach

    def _doubt(self, near: AnyArray) -> AnyArray:
        """Bound of the error of responses, shape (k,), wherever ``|(sI - Lambda)^-1| <= near``, shape (k, n)."""
        spread, rows, columns, rest = self._weights
        reach, see = near * self.sizes[0], near * self.sizes[1]
        error = np.einsum("ij,ij->i", see @ self.defect, reach) + see @ rows + reach @ columns + rest
        sound = ((near * spread).max(1) < KNOWN) & (error < np.inf)
        return np.where(sound, SECOND_ORDER * error, np.inf)

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

    def above(self, level: float, ends: AnyArray, most: int) -> AnyArray | None:
        r"""Frequencies beyond the first of some increasing ones whose gain exceeds a level; empty where none does.

        A proof for all frequencies up to the last one, or of all where that is infinite. Between two, with middle c and
        half distance h, the gain is that of a polynomial in :math:`(\omega - c) / h` but for its remainder and for
        errors as in `response`; the square of a polynomial is nowhere larger than the largest of its Bernstein
        coefficients. What is left open is cut, up to ``most`` intervals: None where that does not settle it.
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
                # A few that are open hold the highest peak: narrow at once, for a round costs more than an interval.
                pieces = int(np.clip(PIECES // max(left.sum(), 1), 2, PIECES // 2))
                cuts = np.linspace(low[left], high[left], pieces + 1, axis=1)
                low, high = cuts[:, :-1].ravel(), cuts[:, 1:].ravel()
        return np.zeros(0)

    def _over(self, middle: AnyArray, half: AnyArray, level: float) -> tuple[AnyArray, AnyArray, AnyArray]:
        """The gain in the middle of intervals, its error, and a bound of the gain in all of each."""
        R = 1 / (1j * middle[:, None] - self.poles)
        size, sizes = np.abs(R), self.sizes[0] * self.sizes[1]
        share = half[:, None] * size
        near = np.where(share < RADIUS, size / (1 - share), np.inf)
        error, first = self._doubt(near), (R @ self._terms).reshape(-1, *self.direct.shape) + self.direct
        gain = largest_gain(first)
        # No mode moves by more; where that is too much, the square of the polynomial tells.
        top = (gain + (near * share) @ sizes) * (1 + SQUARED) + 2 * error
        close = np.flatnonzero(~(top <= level))
        rest = (near[close] * share[close] ** (DEGREE + 1)) @ sizes + (DEGREE + 1) * error[close]
        close, rest = close[rest < level], rest[rest < level]
        if len(close):
            step = -1j * half[close, None] * R[close]
            top[close] = self._expanded(R[close], step, first[close], level - rest) + rest
        return gain, error, top

    def _expanded(self, R: AnyArray, step: AnyArray, first: AnyArray, level: AnyArray) -> AnyArray:
        """Bound of the gain of polynomials with these first terms; no sharper than shows it to be below levels."""
        p, m = self.direct.shape
        powers = [R]
        for _ in range(DEGREE):
            powers.append(powers[-1] * step)
        parts = (np.stack(powers, axis=1) @ self._terms).reshape(len(R), DEGREE + 1, p, m)
        parts[:, 0] = first
        if p > m:  # the smaller of the two products
            parts, p, m = parts.transpose(0, 1, 3, 2), m, p
        rows = parts.reshape(len(R), -1, m)
        products = (rows @ rows.conj().transpose(0, 2, 1)).reshape(len(R), DEGREE + 1, p, DEGREE + 1, p)
        square = np.tensordot(BERNSTEIN, products, ((1, 2), (1, 3)))
        size = np.trace(square, axis1=2, axis2=3).real
        if p == 2:
            apart, across = np.real(square[..., 0, 0] - square[..., 1, 1]), np.abs(square[..., 1, 0])
            size = 0.5 * (size + np.hypot(apart, 2 * across))
        top = size.max(0)
        close = top > level**2
        if p > 2 and close.any():
            top[close] = np.linalg.eigvalsh(square[:, close])[:, :, -1].max(0)
        return np.sqrt(np.maximum(top, 0.0)) * (1 + SQUARED)

    def log_determinant(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        r"""``log det(sI - A)`` at finite points s, shape (k,), up to whole turns, and bounds of its error.

        .. math:: \log\det(sI - A) = \sum_k \log(s - \lambda_k) + \log\det(I - R F), \qquad
           |\log\det(I - X)| \le \mathrm{tr} |X| + n q^2 / (1 - q), \quad q = \||X|\|_1

        Infinite where q is no small number.
        """
        spread, own, n = self._weights[0], np.diag(self.defect), len(self.poles)

        def evaluate(s: AnyArray) -> tuple[AnyArray, AnyArray]:
            apart = s[:, None] - self.poles
            near = 1.0 / np.abs(apart)
            worst = (near * spread).max(1)
            # One logarithm of a few factors: it costs more than their product.
            groups = np.multiply.reduceat(apart, np.arange(0, n, FACTORS), axis=1)
            groups[~(np.abs(groups) > UNDERFLOW)] = np.nan
            logs = np.log(groups)
            error = near @ own + n * worst**2 / (1 - worst) + 8 * EPS * (np.abs(logs).sum(1) + n)
            return logs.sum(1), np.where((worst < KNOWN) & (error < np.inf), SECOND_ORDER * error, np.inf)

        logs, error = self._stretches(evaluate, s)
        return logs, error


def _bernstein(degree: int) -> AnyArray:
    """Coefficients of ``t^i t^j``, t in -1 .. 1, in Bernstein's basis of twice this degree, in (.., i, j)."""
    n = 2 * degree
    rows = [np.poly([1.0] * (n - k) + [-1.0] * k) for k in range(n + 1)]  # (t - 1)^(n - k) (t + 1)^k
    powers = np.array([[row[k] / comb(n, k) for k in range(n + 1)] for row in rows])
    return powers[:, np.add.outer(range(degree + 1), range(degree + 1))]


BERNSTEIN = _bernstein(DEGREE)


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
