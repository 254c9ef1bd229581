r"""Simulation in windows, each from its own best initial state, and the residual that such windows leave.

Over a long record a model with an integrator drifts, and its error says little about where the model is wrong. So the
record is cut into windows, and in each the initial state is fitted by least squares over the whole window: what is
left is the part of the error that no initial state explains.

The windowed error itself is not white even for a perfect model, because the fit uses up n_x directions in each
window, and because the fit must weigh outputs of unknown noise against each other. The *recursive residual* has no
such flaw: sample k of an output is predicted with the initial state fitted to the samples of this output in its window
before k,

.. math:: w_k = \frac{y_k - y_{u,k} - s_k^T \hat x_{k-1}}{\sqrt{1 + s_k^T P_{k-1} s_k}}, \qquad
          P_{k-1} = \Big(\sum_{j<k} s_j s_j^T\Big)^{-1}.

If the model is right and the output noise white, the :math:`w_k` are white with the variance of the noise, exactly
and for every window length. They come from a QR decomposition that is updated by one row at a time (no matrix is
inverted).

References
----------
Brown, Durbin, Evans, "Techniques for testing the constancy of regression relationships over time" (1975).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robustlab.identification.initial_state import fit_state
from robustlab.identification.response import Response, Stretch
from robustlab.record import UNIFORM_TOLERANCE

__all__ = ["WindowedSimulation", "recursive_residual", "window_edges", "windowed_simulation"]

Array = NDArray[np.float64]

# Entries of the free response below this share of its largest column carry no information on the state.
NO_INFORMATION = 1e-10


@dataclass(frozen=True)
class WindowedSimulation:
    """Windowed simulation of a record.

    Attributes
    ----------
    edges
        First sample of each window, and the number of samples at the end, shape (n_windows + 1,).
    y
        Simulated outputs, shape (n, n_y).
    x0
        Fitted initial states, shape (n_windows, n_x).
    residual
        Recursive residual in units of the outputs, shape (n, n_y); NaN at the samples that only fix the state of
        their window.
    """

    edges: NDArray[np.int_]
    y: Array
    x0: Array
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
    step = np.diff(t)
    # The free response is the same in all windows where the clock is uniform.
    uniform = bool(np.abs(step - step.mean()).max() <= UNIFORM_TOLERANCE * step.mean())
    shared = response.free_response(t[:longest]) if uniform else None
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
    """Recursive residual of one output in windows that share one free response, shape (n, n_windows).

    Parameters
    ----------
    free
        Free response of this output, shape (n, n_x).
    error
        Measured minus simulated output from any one initial state, shape (n, n_windows); the residual is the same for
        all. A window that ends earlier than the others ends in NaN.

    Returns
    -------
    numpy.ndarray
        NaN at the samples that only fix the state.
    """
    n, n_x = free.shape
    size = np.linalg.norm(free, axis=0)
    floor = NO_INFORMATION * np.where(size > 0, size, 1.0)
    result = np.empty_like(error)
    R, z = np.zeros((n_x, n_x)), np.zeros((n_x, error.shape[1]))
    for k in range(n):
        row, value = free[k].copy(), error[k]
        for i in range(n_x):
            if abs(row[i]) <= floor[i]:
                continue
            if R[i, i] == 0.0:  # the row fixes a direction that was free: it says nothing about the error
                R[i, i:], z[i], value = row[i:], value, np.nan
                break
            norm = np.hypot(R[i, i], row[i])
            c, s = abs(R[i, i]) / norm, np.sign(R[i, i]) * row[i] / norm
            R[i, i:], row[i:] = c * R[i, i:] + s * row[i:], c * row[i:] - s * R[i, i:]
            z[i], value = c * z[i] + s * value, c * value - s * z[i]
        result[k] = value
    return result
