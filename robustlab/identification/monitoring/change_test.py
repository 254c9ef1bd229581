r"""Sequential test that a model's parameters are constant, valid at every time (an e-process; docs/watch.md).

E mixes the likelihood ratios of all changes from each piece on, with the parameters integrated out; by Ville's
inequality it reaches 1 / alpha with probability alpha at most while the model is valid.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from robustlab.arrays import Array

DIFFUSE = 1e-4  # precision of the standardised parameters: 100 times their tolerances is practically flat
SIZES = (0.05, 0.5)  # of a change to be detected, over its usual size
GROWING = 5.0  # pieces in which a growing change reaches the size of an abrupt one
SCATTERS = (1.0, 100.0)  # variance of random errors, over the noise; below one half it would test the noise itself
UNNAMED = 0.5  # share of the alternatives that are not a parameter
NEGLIGIBLE = 1e-9  # of a column's own square: rounding


@dataclass(frozen=True, eq=False)
class PieceEquations:
    """A piece with M = [J r], (points, k + 1), its windows' initial states projected out."""

    whole: Array  # M^T M
    slow: Array  # M^T U U^T M with the slow directions U of its windows
    points: int
    slow_points: int


@dataclass(eq=False)
class ChangeTest:
    """The test over the pieces so far; ``size`` (k,): a usual change of each parameter, 0 for nuisances."""

    size: Array
    pieces: list[PieceEquations] = field(default_factory=list)

    def add(self, piece: PieceEquations) -> float:
        """Return log E after one more piece."""
        self.pieces.append(piece)
        return float(np.logaddexp(log_sum(self.evidence()), -np.log(len(self.pieces) + 1.0)))

    def evidence(self) -> Array:
        """Compute the log evidence of a change from each piece on, with its prior share, (n_tau,)."""
        tau = np.arange(len(self.pieces))
        may = self.size > 0.0
        named = self._strengths() + np.log((1.0 - UNNAMED) / 2.0 / max(may.sum(), 1))
        named[0], named[:, :, ~may] = -np.inf, -np.inf  # from the first piece on it is no change
        kinds = ([(p.slow, p.slow_points) for p in self.pieces], [(p.whole, p.points) for p in self.pieces])
        scatter = [
            self._scatter(np.stack([part for part, _ in kind]), np.array([number for _, number in kind]), v)
            for kind in kinds
            for v in SCATTERS
        ]
        unnamed = log_sum(np.array(scatter), axis=0) - np.log(len(scatter)) + np.log(UNNAMED)
        both = np.concatenate([named.reshape(len(tau), -1), unnamed[:, None]], axis=1)
        return log_sum(both, axis=1) - np.log((tau + 1.0) * (tau + 2.0))

    def _strengths(self) -> Array:
        """Compute the log ratio of an abrupt or growing change of each parameter, (n_tau, 2, k)."""
        k, whole = len(self.size), np.stack([p.whole for p in self.pieces])
        once = _since(whole)  # sums over the pieces since each one, next weighted with 1, 2, ..., then 1, 3, 6, ...
        growing = _since(once)
        squares = np.diagonal(np.stack([once, 2.0 * _since(growing) - growing], axis=1), axis1=2, axis2=3)[..., :k]
        rows = np.stack([once, growing], axis=1)[:, :, :k]  # (n_tau, 2, k, k + 1)
        inverse = np.linalg.inv(once[0, :k, :k] + DIFFUSE * np.eye(k))
        cross = rows[..., :k]
        lost = ((cross @ inverse) * cross).sum(axis=-1)
        a = np.maximum(squares - lost, 0.0) + NEGLIGIBLE * squares
        b = rows[..., k] - cross @ (inverse @ once[0, :k, k])
        found = []
        for size in SIZES:
            variance = (size * self.size / np.array([[1.0], [GROWING]])) ** 2
            found.append(0.5 * b**2 * variance / (1.0 + a * variance) - 0.5 * np.log1p(a * variance))
        return log_sum(np.array(found), axis=0) - np.log(len(SIZES))

    def _scatter(self, parts: Array, points: Array, variance: float) -> Array:
        """Compute the log ratio, (n_tau,), of random errors with this variance in the directions of the parts."""
        k, whole = len(self.size), np.sum([p.whole for p in self.pieces], axis=0)
        part, number = _since(parts), _since(points)
        before, after = _profile(whole, k), _profile(whole - variance / (1.0 + variance) * part, k)
        return -0.5 * (after[0] - before[0] + after[1] - before[1] + number * np.log1p(variance))


def onset(evidence: Array) -> tuple[int, int, int]:
    """Return the piece at which the change most probably began, and the ends of its 95 % interval."""
    share = np.exp(evidence - log_sum(evidence))
    below = np.cumsum(share)
    lower, upper = (min(int(np.searchsorted(below, q)), len(below) - 1) for q in (0.025, 0.975))
    return int(np.argmax(share)), lower, upper


def _since(values: Array) -> Array:
    """Sum from each entry of the first axis to its end."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def log_sum(logs: Array, axis: int | None = None) -> Array:
    """Sum numbers given by their logarithms, along an axis or over all."""
    from scipy.special import logsumexp

    return np.asarray(logsumexp(logs, axis=axis))


def _profile(sums: Array, k: int) -> tuple[Array, Array]:
    """Minimise the cost over k parameters; also the log determinant of their information; ``sums`` (..., k+1, k+1)."""
    information = sums[..., :k, :k] + DIFFUSE * np.eye(k)
    right = sums[..., :k, k]
    cost = sums[..., k, k] - (right * np.linalg.solve(information, right[..., None])[..., 0]).sum(axis=-1)
    return cost, np.linalg.slogdet(information)[1]
