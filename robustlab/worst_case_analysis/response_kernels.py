# pyright: reportMissingParameterType=false
r"""Compiled responses of many linear members: LANES of them side by side, so that every step is a vector operation.

.. math:: x_{j+1} = \Phi x_j + \Gamma v_j, \qquad y_j = C x_j + D u_j

Arrays hold their members in the last axis, in groups of LANES: Phi is (n_groups, n_x, n_x, LANES). A member's numbers
do not depend on its neighbours: every lane does the same operations in the same order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Long enough for the compiler to use vector instructions, short enough for Phi to stay in the first caches.
LANES = 32


@njit(nogil=True, error_model="numpy")
def _outputs(c, d, c_entries, d_entries, x, u, y):
    """``y = C x + D u`` for one group; the entries (i, j) listed are those that are not zero in every member."""
    for i in range(y.shape[0]):
        for lane in range(y.shape[1]):
            y[i, lane] = 0.0
    for e in range(len(c_entries)):
        target, factor, state = y[c_entries[e, 0]], c[c_entries[e, 0], c_entries[e, 1]], x[c_entries[e, 1]]
        for lane in range(len(target)):
            target[lane] += factor[lane] * state[lane]
    for e in range(len(d_entries)):
        target, factor, value = y[d_entries[e, 0]], d[d_entries[e, 0], d_entries[e, 1]], u[d_entries[e, 1]]
        for lane in range(len(target)):
            target[lane] += factor[lane] * value


@njit(nogil=True, error_model="numpy")
def _advance(phi, gamma, x, v, next_x):
    """``next_x = Phi x + Gamma v`` for one group."""
    for i in range(x.shape[0]):
        target = next_x[i]
        for lane in range(len(target)):
            target[lane] = 0.0
        for j in range(len(v)):
            factor, value = gamma[i, j], v[j]
            if value != 0.0:
                for lane in range(len(target)):
                    target[lane] += factor[lane] * value
        for j in range(x.shape[0]):
            factor, state = phi[i, j], x[j]
            for lane in range(len(target)):
                target[lane] += factor[lane] * state[lane]


@njit(cache=True, nogil=True, error_model="numpy")
def respond(lanes, out):
    """Responses of all members of `Lanes` into out (k, n_t, n_y); k may end inside the last group."""
    phi, gamma, c, d, c_entries, d_entries, u, v, x0 = lanes
    n_t, n_y = out.shape[1], out.shape[2]
    n = phi.shape[1]
    x, next_x, y = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n_y, LANES))
    for group in range(phi.shape[0]):
        used = min(LANES, out.shape[0] - LANES * group)
        for i in range(n):
            x[i, :] = x0[i]
        for t in range(n_t):
            _outputs(c[group], d[group], c_entries, d_entries, x, u[t], y)
            for lane in range(used):
                for i in range(n_y):
                    out[LANES * group + lane, t, i] = y[i, lane]
            if t < n_t - 1:
                _advance(phi[group], gamma[group], x, v[t], next_x)
                x, next_x = next_x, x


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(lanes, bins, sums, peak):
    """Add the responses of the first ``len(peak)`` members of `Lanes` to the running statistics ``sums``.

    ``bins`` are `streaming.Bins`, ``sums`` `streaming.Sums`; ``peak (count, n_y)`` gets each member's largest
    deviation.
    """
    phi, gamma, c, d, c_entries, d_entries, u, v, x0 = lanes
    nominal, low, per_bin = bins
    lower, upper, total, squares, lost, counts = sums
    n_t, n_y, n_bins = counts.shape
    n = phi.shape[1]
    x, next_x, y = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n_y, LANES))
    largest = np.empty((n_y, LANES))
    for group in range(phi.shape[0]):
        first = LANES * group
        used = min(LANES, len(peak) - first)
        if used <= 0:
            break
        for i in range(n):
            x[i, :] = x0[i]
        largest[:] = 0.0
        for t in range(n_t):
            _outputs(c[group], d[group], c_entries, d_entries, x, u[t], y)
            for i in range(n_y):
                smallest, greatest, centre = lower[t, i], upper[t, i], nominal[t, i]
                added, added_squares = 0.0, 0.0
                start, scale, bin_counts = low[t, i], per_bin[t, i], counts[t, i]
                for lane in range(used):
                    value = y[i, lane]
                    gap = value - centre
                    if not abs(gap) < math.inf:
                        lost[t, i] += 1
                        largest[i, lane] = math.inf
                        continue
                    smallest = min(smallest, value)
                    greatest = max(greatest, value)
                    added += gap
                    added_squares += gap * gap
                    largest[i, lane] = max(largest[i, lane], abs(gap))
                    bin_counts[int(min(max((value - start) * scale, 0.0), n_bins - 1.0))] += 1
                lower[t, i], upper[t, i] = smallest, greatest
                total[t, i] += added
                squares[t, i] += added_squares
            if t < n_t - 1:
                _advance(phi[group], gamma[group], x, v[t], next_x)
                x, next_x = next_x, x
        for lane in range(used):
            for i in range(n_y):
                peak[first + lane, i] = largest[i, lane]
