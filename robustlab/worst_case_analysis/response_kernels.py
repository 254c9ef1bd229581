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
# Times that `accumulate` goes through with all members before it goes on: what is counted then stays in the cache.
TIMES = 16


@njit(nogil=True, error_model="numpy")
def _outputs(c, d, c_entries, d_entries, x, u, y):
    """``y = C x + D u`` for one group; the entries (i, j) listed are those that are not zero in every member."""
    row = -1
    for e in range(len(c_entries)):
        i, j = c_entries[e]
        if i == row:
            for lane in range(y.shape[1]):
                y[i, lane] += c[i, j, lane] * x[j, lane]
            continue
        for blank in range(row + 1, i):
            y[blank, :] = 0.0
        row = i
        for lane in range(y.shape[1]):
            y[i, lane] = 0.0 + c[i, j, lane] * x[j, lane]  # never -0.0
    for blank in range(row + 1, y.shape[0]):
        y[blank, :] = 0.0
    for e in range(len(d_entries)):
        i, j = d_entries[e]
        for lane in range(y.shape[1]):
            y[i, lane] += d[i, j, lane] * u[j]


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


@njit(nogil=True, error_model="numpy")
def _placed(y, t, bins, last, gap, place, largest):
    """Deviations of one group's outputs from nominal and their bins; whether every one is finite."""
    nominal, low, per_bin = bins
    finite = 0
    for i in range(y.shape[0]):
        centre, start, scale = nominal[t, i], low[t, i], per_bin[t, i]
        for lane in range(y.shape[1]):
            gap[i, lane] = y[i, lane] - centre
            finite += abs(gap[i, lane]) < math.inf
            largest[i, lane] = max(largest[i, lane], abs(gap[i, lane]))
            place[i, lane] = int(min(max((y[i, lane] - start) * scale, 0.0), last))
    return finite == y.size


@njit(nogil=True, error_model="numpy")
def _added(y, t, gap, place, sums, counts):
    """Add the outputs of a whole group without any that is not finite."""
    lower, upper, total, squares, _ = sums
    for i in range(y.shape[0]):
        smallest, greatest, added, added_squares = lower[t, i], upper[t, i], 0.0, 0.0
        for lane in range(y.shape[1]):
            smallest = min(smallest, y[i, lane])
            greatest = max(greatest, y[i, lane])
            added += gap[i, lane]
            added_squares += gap[i, lane] * gap[i, lane]
            counts[t, i, place[i, lane]] += 1
        lower[t, i], upper[t, i] = smallest, greatest
        total[t, i] += added
        squares[t, i] += added_squares


@njit(nogil=True, error_model="numpy")
def _added_with_losses(y, t, used, gap, place, largest, sums, counts):
    """The same of the first lanes; what is not finite is counted as lost."""
    lower, upper, total, squares, lost = sums
    for i in range(y.shape[0]):
        added, added_squares = 0.0, 0.0
        for lane in range(used):
            if not abs(gap[i, lane]) < math.inf:
                lost[t, i] += 1
                largest[i, lane] = math.inf
                continue
            lower[t, i], upper[t, i] = min(lower[t, i], y[i, lane]), max(upper[t, i], y[i, lane])
            added += gap[i, lane]
            added_squares += gap[i, lane] * gap[i, lane]
            counts[t, i, place[i, lane]] += 1
        total[t, i] += added
        squares[t, i] += added_squares


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(lanes, bins, sums, counts, peak):
    """Add the responses of the first ``len(peak)`` members of `Lanes` to the running statistics ``sums``.

    ``bins`` are `streaming.Bins`, ``sums`` `streaming.Sums`; ``counts (n_t, n_y, n_bins)`` gets how many values fall
    into each bin, ``peak (count, n_y)`` each member's largest deviation.
    """
    phi, gamma, c, d, c_entries, d_entries, u, v, x0 = lanes
    n_t, n_y, n_bins = counts.shape
    n, groups = phi.shape[1], min(phi.shape[0], -(-len(peak) // LANES))
    states, next_x, y = np.empty((groups, n, LANES)), np.empty((n, LANES)), np.empty((n_y, LANES))
    gap, place, largest = np.empty((n_y, LANES)), np.empty((n_y, LANES), np.int32), np.zeros((groups, n_y, LANES))
    for group in range(groups):
        for i in range(n):
            states[group, i, :] = x0[i]
    for begin in range(0, n_t, TIMES):
        for group in range(groups):
            used, x = min(LANES, len(peak) - LANES * group), states[group]
            for t in range(begin, min(begin + TIMES, n_t)):
                _outputs(c[group], d[group], c_entries, d_entries, x, u[t], y)
                if _placed(y, t, bins, n_bins - 1.0, gap, place, largest[group]) and used == LANES:
                    _added(y, t, gap, place, sums, counts)
                else:
                    _added_with_losses(y, t, used, gap, place, largest[group], sums, counts)
                if t < n_t - 1:
                    _advance(phi[group], gamma[group], x, v[t], next_x)
                    x[:] = next_x
    for group in range(groups):
        for lane in range(min(LANES, len(peak) - LANES * group)):
            for i in range(n_y):
                peak[LANES * group + lane, i] = largest[group, i, lane]
