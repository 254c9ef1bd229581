r"""Initial state from measured outputs, by least squares over the free response.

For a linear model :math:`y(t) = y_u(t) + S(t) x_0` with the forced response :math:`y_u` and the free response
:math:`S(t) = C e^{A t}`; :math:`x_0` minimises :math:`\sum_k \| W (y_k - y_u(t_k) - S(t_k) x_0) \|^2`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.identification.evidence import Evidence
from robustlab.identification.response import Response, Stretch

__all__ = ["InitialState", "StateFit", "fit_state", "starting_state", "weighted_least_squares"]

Array = NDArray[np.float64]

SHORTEST_START = 20  # samples
RANK_TOLERANCE = (
    1e-10  # singular values of the column-scaled sensitivity below this share of the largest are not observed
)


@dataclass(frozen=True)
class StateFit:
    """Least-squares fit of an initial state to a stretch of measured outputs.

    Attributes
    ----------
    x0
        State at the first sample, shape (n_x,); the smallest one (scaled) where the outputs do not determine it.
    std
        Standard deviation of ``x0`` if the remaining error were white, shape (n_x,).
    rank
        Number of state directions that the outputs determine.
    y
        Simulated outputs from ``x0``, shape (n, n_y).
    """

    x0: Array
    std: Array
    rank: int
    y: Array


@dataclass(frozen=True)
class InitialState(Evidence):
    """The state from which the whole record is simulated.

    Attributes
    ----------
    x0, std
        Estimate and its standard deviation, shape (n_x,), in the units of ``names``.
    names
        Names of the states.
    samples, seconds
        Length of the stretch it was fitted to.
    rank
        Number of state directions that the recorded outputs determine; less than n_x means part of the start is
        unknown.
    """

    x0: Array
    std: Array
    names: tuple[str, ...]
    samples: int
    seconds: float
    rank: int

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return {
            "x0": self.x0,
            "std": self.std,
            "states": list(self.names),
            "samples": self.samples,
            "seconds": self.seconds,
            "rank": self.rank,
        }


def fit_state(response: Response, stretch: Stretch, free: Array | None = None) -> StateFit:
    """Initial state of a stretch; ``free`` is the free response over its clock, where it is known already."""
    forced = response.simulate(stretch.t, stretch.u, np.zeros(response.n_states))
    free = response.free_response(stretch.t) if free is None else free
    x0, std, rank = weighted_least_squares(free, stretch.y - forced, stretch.weight)
    return StateFit(x0, std, rank, forced + free @ x0)


def starting_state(response: Response, whole: Stretch, longest: int) -> InitialState:
    """State at the start of a record, from the longest opening stretch over which the estimate stays consistent.

    A short stretch suffers from noise, a long one from the faults of the model. The stretch is doubled from 20 samples
    (at least 4 n_x) up to ``longest``, as long as the 3-sigma intervals of all estimates so far have a common point
    (intersection of confidence intervals).

    References
    ----------
    Goldenshluger and Nemirovski, "On spatially adaptive estimation of nonparametric regression" (1997).
    """
    n = min(len(whole.t), max(SHORTEST_START, 4 * response.n_states))
    low, high = np.full(response.n_states, -np.inf), np.full(response.n_states, np.inf)
    best: tuple[int, StateFit] | None = None
    while True:
        fit = fit_state(response, whole.cut(0, n))
        low, high = np.maximum(low, fit.x0 - 3.0 * fit.std), np.minimum(high, fit.x0 + 3.0 * fit.std)
        if best is not None and (low > high).any():
            break
        best = n, fit
        if 2 * n > min(longest, len(whole.t)) or not response.n_states:
            break
        n *= 2
    n, fit = best
    return InitialState(fit.x0, fit.std, response.model.state_names, n, float(whole.t[n - 1] - whole.t[0]), fit.rank)


def weighted_least_squares(free: Array, error: Array, weight: Array) -> tuple[Array, Array, int]:
    """Weighted least-squares state, its standard deviation for white errors, and the rank."""
    n_x = free.shape[2]
    if not n_x:
        return np.zeros(0), np.zeros(0), 0
    lhs = (free * weight[:, None]).reshape(-1, n_x)
    rhs = (error * weight).ravel()
    scale = np.linalg.norm(lhs, axis=0)
    scale[scale == 0] = 1.0
    left, sigma, right = np.linalg.svd(lhs / scale, full_matrices=False)
    rank = int((sigma > RANK_TOLERANCE * sigma[0]).sum()) if sigma[0] > 0 else 0
    left, sigma, right = left[:, :rank], sigma[:rank], right[:rank]
    coordinates = left.T @ rhs
    x0 = right.T @ (coordinates / sigma) / scale
    spare = max(1, len(rhs) - rank)
    variance = max(0.0, float(rhs @ rhs - coordinates @ coordinates)) / spare
    std = np.sqrt(variance * ((right / sigma[:, None]) ** 2).sum(axis=0)) / scale
    return x0, std, rank
