r"""A sequential test that a model's parameters stay what they are, valid at every time (an e-process).

What a piece p of a log tells stands in whitened residuals :math:`r_p` and their derivatives :math:`J_p` over the
model's parameters; the starts of its windows are projected out. While the model explains the log,

.. math:: r_p + J_p \zeta = \varepsilon_p, \qquad \varepsilon_p \sim N(0, I),

with one unknown :math:`\zeta` for all pieces: the parameters need not be known, they must not move. If from piece
:math:`\tau` on one of them, with the column :math:`G_p` of :math:`J_p`, moves by :math:`\delta`, at once (:math:`w_p =
1`) or growing (:math:`w_p = p - \tau + 1`), it is :math:`r_p + J_p \zeta + w_p G_p \delta`. With :math:`\zeta`
integrated out under a flat prior in both, and :math:`\delta \sim N(0, s^2)`, the ratio of the two likelihoods is

.. math::
    \log \Lambda_\tau = \tfrac12 \frac{b^2}{A + s^{-2}} - \tfrac12 \log(1 + s^2 A), \qquad
    A = G^T P G, \quad b = G^T P r, \quad P = I - J (J^T J)^{-1} J^T

over all pieces so far (G zero before :math:`\tau`). Whatever else comes in is looked for as random slow errors of each
window, and as more noise: :math:`\varepsilon_p \sim N(0, I + s^2 U_p U_p^T)` from :math:`\tau` on.

:math:`P r` does not depend on :math:`\zeta`, and the ratio of its likelihoods is a martingale under the model, whatever
:math:`\zeta` is (Pérez-Ortiz and others 2024). So is every mixture

.. math:: E_t = \sum_{\tau \le t} \pi_\tau \sum_j \omega_j \Lambda_{\tau j}(t) + \sum_{\tau > t} \pi_\tau, \qquad
    \pi_\tau = \frac{1}{\tau (\tau + 1)},

and by Ville's inequality :math:`P(\exists t: E_t \ge 1/\alpha) \le \alpha`, however long the log is. For the strengths
:math:`\delta` the same holds for any noise that is conditionally sub-Gaussian with variance proxy one, since
:math:`\Lambda` is then a mixture of :math:`e^{\lambda^T \varepsilon - |\lambda|^2 / 2}`.

References
----------
Ville, *Étude critique de la notion de collectif* (1939); Robbins, *Statistical methods related to the law of the
iterated logarithm* (1970); Pérez-Ortiz, Lardy, de Heide, Grünwald, *E-statistics, group invariance and anytime-valid
testing*, Annals of Statistics 52 (2024); Ramdas, Grünwald, Vovk, Shafer, *Game-theoretic statistics and safe
anytime-valid inference*, Statistical Science 38 (2023).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from robustlab.arrays import Array, Indices

DIFFUSE = 1e-4  # precision of the standardised parameters: 100 times their tolerances is as good as flat
SIZES = (0.05, 0.5)  # of a change that is looked for, over its usual size
GROWING = 5.0  # pieces in which a growing change reaches the size of one that came at once
SCATTERS = (
    1.0,
    100.0,
)  # variance of unnamed slow errors, over the noise; below one half it would test the noise itself
UNNAMED = 0.5  # share of the alternatives that are no parameter
NEGLIGIBLE = 1e-9  # of a column's own square: what the parameters make of it by rounding


@dataclass(frozen=True, eq=False)
class PieceEquations:
    """What a piece tells, its windows' starts projected out.

    With M = [J r], (points, k + 1): ``whole`` is :math:`M^T M`, ``slow`` :math:`M^T U U^T M` with the slow
    directions U of its windows; ``points`` and ``slow_points`` their numbers.
    """

    whole: Array
    slow: Array
    points: int
    slow_points: int


@dataclass(frozen=True, eq=False)
class Alternatives:
    """Log likelihood ratios at one time, each with its prior share: of the parameters (n_tau, 2, k) at once and
    growing, of what is unnamed (n_tau,).
    """

    since: Indices  # piece at which the change comes, (n_tau,)
    named: Array
    unnamed: Array

    @property
    def each(self) -> Array:
        """Log evidence of each tau, (n_tau,)."""
        both = np.concatenate([self.named.reshape(len(self.since), -1), self.unnamed[:, None]], axis=1)
        return log_sum(both, axis=1)

    def onset(self) -> tuple[int, int, int]:
        """Piece at which the change most probably began, and the ends of its 95 % interval."""
        share = np.exp(self.each - log_sum(self.each))
        below = np.cumsum(share)
        lower, upper = (int(self.since[min(np.searchsorted(below, q), len(below) - 1)]) for q in (0.025, 0.975))
        return int(self.since[np.argmax(share)]), lower, upper


@dataclass(eq=False)
class ChangeTest:
    """The test over the pieces so far.

    ``size`` (k,): a usual change of each parameter; 0 of those that are no change.
    """

    size: Array
    _whole: Array = field(init=False)  # over all pieces, of the own parameters and the residual, (k + 1, k + 1)
    _since: list[_Since] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self._whole = np.zeros((len(self.size) + 1,) * 2)

    def add(self, piece: PieceEquations) -> float:
        """Log of E after one more piece."""
        self._whole = self._whole + piece.whole
        self._since.append(_Since.empty(len(self.size)))
        for age, there in enumerate(reversed(self._since), 1):
            there.add(piece, float(age))
        return float(np.logaddexp(log_sum(self.alternatives().each), -np.log(len(self._since) + 1.0)))

    def alternatives(self) -> Alternatives:
        """All that may have changed, by the pieces so far."""
        since = np.arange(len(self._since))
        prior = -np.log((since + 1.0) * (since + 2.0))
        once = np.stack([[s.once, s.growing] for s in self._since])  # (n_tau, 2, k, k + 1)
        square = np.stack([[s.square, s.square_growing] for s in self._since])
        may = self.size > 0.0
        named = self._strengths(once, square) + np.log((1.0 - UNNAMED) / 2.0 / max(may.sum(), 1))
        named[0], named[:, :, ~may] = -np.inf, -np.inf  # from the first piece on it is no change
        parts = [
            (np.stack([s.slow for s in self._since]), np.array([s.slow_points for s in self._since])),
            (np.stack([s.whole for s in self._since]), np.array([s.points for s in self._since])),
        ]
        scatter = [self._scatter(part, points, v) for part, points in parts for v in SCATTERS]
        unnamed = log_sum(np.array(scatter), axis=0) - np.log(len(scatter)) + np.log(UNNAMED)
        return Alternatives(since, named + prior[:, None, None], unnamed + prior)

    def _strengths(self, once: Array, square: Array) -> Array:
        """Log ratio of each parameter that moves at once or grows, (n_tau, 2, k)."""
        k = len(self.size)
        inverse = np.linalg.inv(self._whole[:k, :k] + DIFFUSE * np.eye(k))
        cross = once[..., :k]
        lost = ((cross @ inverse) * cross).sum(axis=-1)
        a = np.maximum(square - lost, 0.0) + NEGLIGIBLE * square
        b = once[..., k] - cross @ (inverse @ self._whole[:k, k])
        found = []
        for size in SIZES:
            variance = (size * self.size / np.array([[1.0], [GROWING]])) ** 2
            found.append(0.5 * b**2 * variance / (1.0 + a * variance) - 0.5 * np.log1p(a * variance))
        return log_sum(np.array(found), axis=0) - np.log(len(SIZES))

    def _scatter(self, part: Array, points: Array, variance: float) -> Array:
        """Log ratio, (n_tau,), of errors that are random with this variance in the directions that ``part`` is of."""
        k = len(self.size)
        before, after = _profile(self._whole, k), _profile(self._whole - variance / (1.0 + variance) * part, k)
        return -0.5 * (after[0] - before[0] + after[1] - before[1] + points * np.log1p(variance))


@dataclass(eq=False)
class _Since:
    """Sums over the pieces since one of them.

    ``once``, ``growing``: products of the parameters with themselves and the residual, (k, k + 1), times one and times
    the weight of what grows; ``square``, ``square_growing``: their squares, (k,); ``whole``, ``slow``: of the
    parameters and the residual, (k + 1, k + 1).
    """

    once: Array
    growing: Array
    square: Array
    square_growing: Array
    whole: Array
    slow: Array
    points: int = 0
    slow_points: int = 0

    @classmethod
    def empty(cls, k: int) -> _Since:
        """Of no piece."""
        zero = np.zeros((k + 1, k + 1))
        return cls(zero[:k], zero[:k], np.zeros(k), np.zeros(k), zero, zero)

    def add(self, piece: PieceEquations, age: float) -> None:
        """One more piece, the ``age``-th."""
        once, square = piece.whole[:-1], np.diag(piece.whole)[:-1]
        self.once, self.growing = self.once + once, self.growing + age * once
        self.square, self.square_growing = self.square + square, self.square_growing + age**2 * square
        self.whole, self.slow = self.whole + piece.whole, self.slow + piece.slow
        self.points, self.slow_points = self.points + piece.points, self.slow_points + piece.slow_points


def log_sum(logs: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """Logarithm of the sum of what has these logarithms, along an axis or over all."""
    most = np.max(logs, axis=axis, keepdims=True)
    most = np.where(np.isfinite(most), most, 0.0)
    with np.errstate(divide="ignore"):
        found = np.log(np.sum(np.exp(logs - most), axis=axis, keepdims=True)) + most
    return np.asarray(found.squeeze() if axis is None else found.squeeze(axis))


def _profile(sums: Array, k: int) -> tuple[Array, Array]:
    """Cost at the best of the k parameters, and log determinant of what tells them; ``sums`` (..., k + 1, k + 1)."""
    told = sums[..., :k, :k] + DIFFUSE * np.eye(k)
    right = sums[..., :k, k]
    cost = sums[..., k, k] - (right * np.linalg.solve(told, right[..., None])[..., 0]).sum(axis=-1)
    return cost, np.linalg.slogdet(told)[1]
