# pyright: reportMissingParameterType=false
# (the compiler infers the types of inner functions; the entries have signatures in the decorator)
r"""Compiled square-root Kalman filter and Rauch-Tung-Striebel smoother: covariances are roots, P = S S^T, outputs are
processed one at a time (Potter), the time update is the QR of [[S^T Phi^T, S^T], [L, 0]] = Q [[S_p^T, W], [0, V]] with
the gain W^T S_p^-1 and the covariance given the next state V^T V (Park, Kailath, IEEE TAC 41, 1996).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, types

from robustlab.arrays import Array, Indices

REPEATS = 1e-12  # relative change of a root's row below which it counts as stationary

_1, _2, _3 = (types.Array(types.float64, k, "C") for k in (1, 2, 3))


class Filter(NamedTuple):
    """Linear system of the filter; ``root`` is L."""

    phi: Array
    root: Array
    forced: Array
    H: Array
    sigma: Array
    S0: Array


class Kept(NamedTuple):
    """Results of the filter for the smoother; the matrices of sample k are at index ``slot[k]``."""

    predicted: Array
    filtered: Array
    slot: Indices
    root: Array
    G: Array
    rest: Array
    last: Array

    @classmethod
    def of(cls, n: int, n_z: int) -> Kept:
        """Allocate for n samples of n_z states; n = 0 if only the last root is needed."""
        means, matrices = np.empty((n, n_z)), np.empty((n, n_z, n_z))
        return cls(
            means, means.copy(), np.zeros(n, np.int64), matrices, matrices.copy(), matrices.copy(),
            np.zeros((n_z, n_z)),
        )  # fmt: skip


_FILTER = (_2, _2, _2, _2, _1, _2)
_KEPT = (_2, _2, types.Array(types.int64, 1, "C"), _3, _3, _3, _2)


@njit(nogil=True, error_model="numpy")
def _triangle(m, columns):
    """Reduce the first ``columns`` columns of m by Householder reflections to an upper triangle with diagonal >= 0."""
    rows, width = m.shape
    for j in range(columns):
        norm = 0.0
        for i in range(j, rows):
            norm += m[i, j] * m[i, j]
        norm = math.sqrt(norm)
        if norm == 0.0:
            continue
        alpha = -norm if m[j, j] > 0 else norm
        head = m[j, j] - alpha
        beta = -1.0 / (alpha * head)
        for c in range(j + 1, width):
            total = head * m[j, c]
            for i in range(j + 1, rows):
                total += m[i, j] * m[i, c]
            total *= beta
            m[j, c] -= total * head
            for i in range(j + 1, rows):
                m[i, c] -= total * m[i, j]
        m[j, j] = alpha
        for i in range(j + 1, rows):
            m[i, j] = 0.0
        if alpha < 0:
            for c in range(j, width):
                m[j, c] = -m[j, c]


@njit(nogil=True, error_model="numpy")
def _update(z, S, h, sigma, v, gain, direction):
    """Update z and S by one output with innovation v (Potter), fill ``gain``; return the innovation's variance."""
    n = len(z)
    a = sigma * sigma
    for j in range(n):
        total = 0.0
        for i in range(n):
            total += S[i, j] * h[i]
        direction[j] = total
        a += total * total
    shrink = 1.0 / (a + sigma * math.sqrt(a))
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += S[i, j] * direction[j]
        gain[i] = total / a
        z[i] += gain[i] * v
        total *= shrink
        for j in range(n):
            S[i, j] -= total * direction[j]
    return a


@njit(nogil=True, error_model="numpy")
def _advance(work, phi, S, root, S_new, G, rest):
    """Apply the time update: predicted root, smoother's gain, and covariance given the next state."""
    n = len(S)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for c in range(n):
                total += phi[j, c] * S[c, i]
            work[i, j], work[i, n + j] = total, S[j, i]
            work[n + i, j], work[n + i, n + j] = root[i, j], 0.0
    _triangle(work, n)
    for i in range(n):
        for j in range(n):
            S_new[i, j] = work[j, i] if j <= i else 0.0
            total = 0.0
            for c in range(n, 2 * n):
                total += work[c, n + i] * work[c, n + j]
            rest[i, j] = total
    for i in range(n):  # row i of G solves G_i S_p = W_i^T
        for j in range(n - 1, -1, -1):
            total = work[j, n + i]
            for c in range(j + 1, n):
                total -= G[i, c] * S_new[c, j]
            G[i, j] = total / S_new[j, j]


@njit(nogil=True, error_model="numpy")
def _repeats(S_new, S):
    for i in range(len(S)):
        change, size = 0.0, 0.0
        for j in range(i + 1):
            change = max(change, abs(S_new[i, j] - S[i, j]))
            size = max(size, abs(S_new[i, j]))
        if change > REPEATS * size:
            return False
    return True


@njit(
    [(types.NamedTuple(_FILTER, Filter), _2, types.boolean, types.NamedTuple(_KEPT, Kept))],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def forward(model, y, keep, kept):
    """Run the filter from zero mean and the root S0; ``kept.last`` receives the filtered root of the last sample."""
    # Returns the sums of log variance and of squared innovation over variance after the first n_z full updates.
    phi, noise, forced, H, sigma, S0 = model
    predicted, filtered, slot, root, G, rest, last = kept
    n, n_y, n_z = y.shape[0], y.shape[1], len(phi)
    z, z_next, S = np.zeros(n_z), np.zeros(n_z), S0.copy()
    S_pred, S_new, work = S0.copy(), np.zeros((n_z, n_z)), np.zeros((2 * n_z, 2 * n_z))
    gain, variance, direction = np.zeros((n_y, n_z)), np.zeros(n_y), np.zeros(n_z)
    one_G, one_rest = np.zeros((n_z, n_z)), np.zeros((n_z, n_z))
    frozen, place, seen = False, -1, 0  # seen: samples with all outputs
    logs, squares, count = 0.0, 0.0, 0
    for k in range(n):
        complete = True
        for i in range(n_y):
            complete = complete and not math.isnan(y[k, i])
        frozen = frozen and complete
        if keep:
            predicted[k] = z
        if not frozen:
            place += 1
            S[:] = S_pred
            if keep:
                root[place] = S_pred
        slot_k = place
        for i in range(n_y):
            if math.isnan(y[k, i]):
                continue
            v = y[k, i]
            for c in range(n_z):
                v -= H[i, c] * z[c]
            if frozen:
                for c in range(n_z):
                    z[c] += gain[i, c] * v
            else:
                variance[i] = _update(z, S, H[i], sigma[i], v, gain[i], direction)
            if seen >= n_z:
                logs += math.log(variance[i])
                squares += v * v / variance[i]
                count += 1
        seen += complete
        if keep:
            filtered[k] = z
            slot[k] = slot_k
        if k == n - 1:
            last[:] = S
            break
        if not frozen:
            _advance(work, phi, S, noise, S_new, one_G, one_rest)
            if keep:
                G[place], rest[place] = one_G, one_rest
            frozen = complete and _repeats(S_new, S_pred)
            S_pred[:] = S_new
        for i in range(n_z):
            total = forced[k, i]
            for c in range(n_z):
                total += phi[i, c] * z[c]
            z_next[i] = total
        z[:] = z_next
    return logs, squares, count


@njit([(types.NamedTuple(_KEPT, Kept), _2, _3)], cache=True, nogil=True, error_model="numpy")
def backward(kept, mean, covariance):
    """Fill the smoothed mean (n, n_z) and covariance (n, n_z, n_z)."""
    predicted, filtered, slot, _, G, rest, last = kept
    n, n_z = filtered.shape
    mean[n - 1] = filtered[n - 1]
    covariance[n - 1] = last @ last.T
    error = np.zeros(n_z)
    half = np.zeros((n_z, n_z))
    for k in range(n - 2, -1, -1):
        after = covariance[k + 1]
        for i in range(n_z):
            error[i] = mean[k + 1, i] - predicted[k + 1, i]
        gain, add, out = G[slot[k]], rest[slot[k]], covariance[k]
        for i in range(n_z):
            total = filtered[k, i]
            for j in range(n_z):
                total += gain[i, j] * error[j]
                part = 0.0
                for c in range(n_z):
                    part += gain[i, c] * after[c, j]
                half[i, j] = part
            mean[k, i] = total
        for i in range(n_z):
            for j in range(i + 1):
                total = add[i, j]
                for c in range(n_z):
                    total += half[i, c] * gain[j, c]
                out[i, j] = total
                out[j, i] = total
