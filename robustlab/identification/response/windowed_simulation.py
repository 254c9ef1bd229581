r"""Simulation in windows, each from its own least-squares initial state, and the residual that such windows leave.

The recursive residual predicts each sample from the state fitted to those before it in its window; it is white with the
variance of the noise where the model is right (Brown, Durbin, Evans 1975).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Indices
from robustlab.identification.response.response import Response, Stretch
from robustlab.result import Evidence

SHORTEST_START = 20  # samples
# Singular values of the column-scaled sensitivity below this share of the largest are not observed.
RANK_TOLERANCE = 1e-10
# Entries of the free response below this share of its largest column carry no information on the state.
NO_INFORMATION = 1e-10


@dataclass(frozen=True)
class StateFit:
    """Least-squares fit of an initial state to a stretch of measured outputs."""

    # state at the first sample, shape (n_x,); the smallest one (scaled) where the outputs do not determine it
    x0: Array
    std: Array  # standard deviation of ``x0`` if the remaining error were white, shape (n_x,)
    rank: int  # number of state directions that the outputs determine
    y: Array  # simulated outputs from ``x0``, shape (n, n_y)


@dataclass(frozen=True)
class InitialState(Evidence):
    """The state from which the whole record is simulated."""

    # x0, std: estimate and its standard deviation, shape (n_x,), in the units of ``names``
    x0: Array
    std: Array
    names: tuple[str, ...]  # names of the states
    # samples, seconds: length of the stretch it was fitted to
    samples: int
    seconds: float
    # number of state directions that the recorded outputs determine; less than n_x means part of the start is unknown
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
    found = fit_starts(free[None], (stretch.y - forced)[None], stretch.weight)
    return StateFit(found.x0[0], found.std[0], int(found.rank[0]), forced + free @ found.x0[0])


def starting_state(response: Response, whole: Stretch, longest: int) -> InitialState:
    """State at the start of a record, from the longest opening stretch over which the estimate stays consistent.

    A short stretch suffers from noise, a long one from the faults of the model. The stretch is doubled from 20 samples
    (at least 4 n_x) up to ``longest``, as long as the 3-sigma intervals of all estimates so far have a common point
    (intersection of confidence intervals).
    """
    shortest = min(len(whole.t), max(SHORTEST_START, 4 * response.n_states))
    names, longest = response.model.state_names, min(longest, len(whole.t))
    return consistent_start(lambda n: fit_state(response, whole.cut(0, n)), whole.t, names, shortest, longest)


def consistent_start(
    fit_to: Callable[[int], StateFit], t: Array, names: tuple[str, ...], shortest: int, longest: int
) -> InitialState:
    """`starting_state` from the fits ``fit_to(n)`` to the first n samples of the clock ``t``."""
    n = shortest
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    best: tuple[int, StateFit] | None = None
    while True:
        fit = fit_to(n)
        low, high = np.maximum(low, fit.x0 - 3.0 * fit.std), np.minimum(high, fit.x0 + 3.0 * fit.std)
        if best is not None and (low > high).any():
            break
        best = n, fit
        if 2 * n > longest or not names:
            break
        n *= 2
    n, fit = best
    return InitialState(fit.x0, fit.std, names, n, float(t[n - 1] - t[0]), fit.rank)


@dataclass(frozen=True, eq=False)
class FitOfWindows:
    """Least-squares fits of the states at the starts of windows."""

    # x0, std, rank: states (n_windows, n_x), their standard deviations for white errors, and how many directions of
    # each are told
    x0: Array
    std: Array
    rank: Indices
    left: Array  # what they leave of the weighted errors, (n_windows, length * n_y)
    basis: Array  # orthonormal basis of what they can do to these, padded with zeros, (n_windows, length * n_y, n_x)


def fit_starts(free: Array, error: Array, weight: Array) -> FitOfWindows:
    """States at the starts of windows side by side, by weighted least squares.

    ``free``: outputs per unit of each state (n_windows, length, n_y, n_x). ``error``: (n_windows, length, n_y).
    ``weight``: factor of each output's error, (n_y,).
    """
    count, n_x = len(free), free.shape[-1]
    lhs = (free * weight[:, None]).reshape(count, error[0].size, n_x)
    rhs = (error * weight).reshape(count, -1)
    scale = np.linalg.norm(lhs, axis=1)
    scale[scale == 0] = 1.0
    left, sigma, right = np.linalg.svd(lhs / scale[:, None], full_matrices=False)
    known = sigma > RANK_TOLERANCE * sigma[:, :1]
    basis = left * known[:, None]
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=known)
    coordinates = np.einsum("wmk,wm->wk", basis, rhs)
    x0 = np.einsum("wkn,wk->wn", right, coordinates * inverse) / scale
    rest = rhs - np.einsum("wmk,wk->wm", basis, coordinates)
    rank = known.sum(axis=1)
    variance = (rest**2).sum(axis=1) / np.maximum(1, rhs.shape[1] - rank)
    std = np.sqrt(variance[:, None] * ((right * inverse[:, :, None]) ** 2).sum(axis=1)) / scale
    return FitOfWindows(x0, std, rank, rest, basis)


@dataclass(frozen=True)
class WindowedSimulation:
    """Windowed simulation of a record."""

    edges: NDArray[np.int_]  # first sample of each window, and the number of samples at the end, shape (n_windows + 1,)
    y: Array  # simulated outputs, shape (n, n_y)
    x0: Array  # fitted initial states, shape (n_windows, n_x)
    # recursive residual in units of the outputs, shape (n, n_y); NaN at the samples that only fix the state of their
    # window
    residual: Array


def window_edges(n: int, length: int) -> NDArray[np.int_]:
    """Edges of windows of ``length`` samples; a rest shorter than half a window belongs to the last one.

    Examples
    --------
    >>> window_edges(99, 40).tolist(), window_edges(110, 40).tolist()
    ([0, 40, 99], [0, 40, 80, 110])
    """
    edges = list(range(0, n, length))
    if len(edges) > 1 and n - edges[-1] < length / 2:
        edges.pop()
    return np.array([*edges, n])


def windowed_simulation(response: Response, whole: Stretch, length: int) -> WindowedSimulation:
    """Simulate every window of ``length`` samples from its own least-squares initial state."""
    t, y = whole.t, whole.y
    edges = window_edges(len(t), length)
    longest = int(np.diff(edges).max())
    # The free response is the same in all windows where the clock is uniform.
    shared = response.free_response(t[:longest]) if whole.is_uniform else None
    n_windows = len(edges) - 1
    simulated, states = np.empty_like(y), np.empty((n_windows, response.n_states))
    error, residual = np.full((longest, y.shape[1], n_windows), np.nan), np.empty_like(y)
    for k, (first, last) in enumerate(pairwise(edges)):
        part, size = slice(first, last), last - first
        free = shared[:size] if shared is not None else response.free_response(t[part])
        fit = fit_state(response, whole.cut(first, last), free)
        simulated[part], states[k] = fit.y, fit.x0
        error[:size, :, k] = y[part] - fit.y
        if shared is None:
            for j in range(y.shape[1]):
                residual[part, j] = recursive_residual(free[:, j], error[:size, j, k : k + 1])[:, 0]
    if shared is not None:
        for j in range(y.shape[1]):
            padded = recursive_residual(shared[:, j], error[:, j])
            residual[:, j] = np.concatenate([padded[:size, k] for k, size in enumerate(np.diff(edges))])
    return WindowedSimulation(edges, simulated, states, residual)


def recursive_residual(free: Array, error: Array) -> Array:
    """Recursive residual (n, n_windows) of one output in windows that share one free response (n, n_x).

    ``error``: measured minus simulated output from any one initial state. A window that ends earlier ends in NaN.
    """
    from robustlab.identification.response.recursion_kernel import predict

    size = np.linalg.norm(free, axis=0)
    floor = NO_INFORMATION * np.where(size > 0, size, 1.0)
    result = np.array(error, order="C")
    predict(np.array(free, order="C"), result, floor)
    return result
