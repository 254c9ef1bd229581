r"""Causal time-invariant systems of bounded gain over a finite time: norm, barrier function, and dual norm.

For pulse responses :math:`H_0 \dots H_{N-1}` (r x c) let T(H) be their block lower-triangular Toeplitz matrix. By
Carathéodory and Fejér a causal stable system with these first N pulse responses and H-infinity norm at most gamma
exists if and only if :math:`\bar\sigma(T(H)) \le \gamma`. The set has the self-concordant barrier

.. math:: \varphi(H, \gamma) = -\log\det \begin{bmatrix} \gamma I & T \\ T^T & \gamma I \end{bmatrix}

of parameter N (r + c). Its Hessian in H consists of sums along diagonals of products of the blocks of the inverse: of
correlations in two dimensions, which fast Fourier transforms give in O(N^2 log N).

References
----------
Poolla et al. (1994), theorem 3.1; Genin, Hachez, Nesterov, Van Dooren, "Optimization problems over positive
pseudopolynomial matrices", SIAM J. Matrix Anal. Appl. 25 (2003), for Hessians of such barriers.
Kailath, Sayed, "Displacement structure: theory and applications", SIAM Review 37 (1995): products of Toeplitz matrices
are sums along diagonals, and a matrix with its flip commutes where the channels are single.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.linear_analysis.matrix_equations import lapack


def toeplitz(h: Array) -> Array:
    """Block lower-triangular Toeplitz matrix (r n, c n), channel after channel, of pulse responses (n, r, c)."""
    n, r, c = h.shape
    lag = np.arange(n)[:, None] - np.arange(n)
    padded = np.concatenate([np.zeros((n, r, c)), h])
    parts = padded[lag + n]  # negative lags are zero
    return np.ascontiguousarray(parts.transpose(2, 0, 3, 1).reshape(r * n, c * n))


def gain(h: Array) -> float:
    """Largest singular value of the Toeplitz matrix: the smallest gamma that a continuation of h can have."""
    T = toeplitz(h)
    square = T @ T.T if len(T) <= T.shape[1] else T.T @ T
    return float(np.sqrt(max(np.linalg.eigvalsh(square)[-1], 0.0)))


def diagonal_sums(X: Array, n: int, r: int, c: int) -> Array:
    """Sums along the lags of X (r n, c n): what pairs with pulse responses (n, r, c)."""
    parts = X.reshape(r, n, c, n)
    found = np.zeros((n, r, c))
    for a in range(r):
        for b in range(c):
            block = parts[a, :, b, :]
            # Row i shifted by i: the lag k = row - column becomes a column of a strided view.
            padded = np.zeros((n, 2 * n))
            padded[:, :n] = block[:, ::-1]
            slid = padded.ravel()[: n * (2 * n - 1)].reshape(n, 2 * n - 1)
            # padded[i, n - 1 - j] moves to column n - 1 - j + i = n - 1 + (i - j)
            found[:, a, b] = slid.sum(axis=0)[n - 1 :] if n > 1 else block.sum()
    return found


def barrier_value(h: Array, gamma: float) -> float:
    """The barrier; +inf outside."""
    if h.shape[1] > h.shape[2]:  # T turned upside down in both directions and transposed: the same singular values
        h = h.transpose(0, 2, 1)
    factor, info = lapack().dpotrf(_room(h, gamma), lower=1, overwrite_a=1)
    return np.inf if info else _value_of(factor, h, gamma)


def _value_of(factor: Array, h: Array, gamma: float) -> float:
    """The barrier from a Cholesky factor of the room."""
    more = len(h) * (h.shape[2] - h.shape[1])
    return float(-2 * np.log(np.diag(factor)).sum() - more * np.log(gamma))


def _room(h: Array, gamma: float) -> Array:
    """``gamma^2 I - T T'`` (r n, r n): entries one further down a diagonal have one product of pulses more."""
    n, r, _ = h.shape
    sheared = np.empty((n, 2 * n - 1))
    step = sheared.itemsize
    # Row i of the view starts at column n - 1 - i: diagonals become columns.
    diagonals = np.lib.stride_tricks.as_strided(sheared[0, n - 1 :], (n, n), ((2 * n - 2) * step, step))
    found = np.empty((r, n, r, n))
    for a in range(r):
        for b in range(r):
            sheared.fill(0.0)
            diagonals[...] = h[:, a] @ h[:, b].T
            found[a, :, b] = -_summed(sheared, diagonals)
    room = found.reshape(r * n, r * n)
    room.flat[:: r * n + 1] += gamma**2
    return room


def _summed(sheared: Array, diagonals: Array) -> Array:
    np.cumsum(sheared, axis=0, out=sheared)
    return diagonals


@dataclass(frozen=True)
class Barrier:
    """Value and derivatives of the barrier: slope and curve over (H as (n, r, c) raveled), the rest over gamma."""

    value: float  # the barrier itself
    # slope, curve: (n r c,) and (n r c, n r c)
    slope: Array
    curve: Array
    # slope_gamma, curve_gamma, cross: first and second derivative in gamma, and the mixed ones (n r c,)
    slope_gamma: float
    curve_gamma: float
    cross: Array
    pull: Array  # ``2 (gamma^2 I - T T')^-1 T``, whose diagonal sums are the slope; the matrix of the dual norm


def barrier(h: Array, gamma: float) -> Barrier:
    """Derivatives of the barrier at a point inside."""
    n, r, c = h.shape
    T = toeplitz(h)
    left, info = lapack().dpotrf(_room(h, gamma), lower=1, overwrite_a=1)
    value = _value_of(left, h, gamma)
    half, info_inverse = lapack().dpotri(left, lower=1, overwrite_c=1)  # LAPACK has left zeros above the diagonal
    if info or info_inverse:
        raise np.linalg.LinAlgError("outside of the barrier's domain")
    Q = half + half.T  # (gamma^2 I - T T')^-1
    Q.flat[:: r * n + 1] *= 0.5
    S12 = -(Q @ T)
    S11 = gamma * Q
    if r == c == 1:  # T' is T turned upside down in both directions
        S22 = S11
        curve = _single_curvature(S11, S12)
    else:  # (gamma^2 I - T'T)^-1 = (I + T' Q T) / gamma^2
        S22 = (np.eye(c * n) - T.T @ S12) / gamma
        curve = _curvature(S11, S12, S22, n, r, c)
    pull = -2 * S12
    slope = diagonal_sums(pull, n, r, c).ravel()
    # phi(s H, s gamma) = phi(H, gamma) - n (r + c) log s: its slope is homogeneous of degree -1.
    return Barrier(
        value,
        slope,
        curve,
        float(-np.trace(S11) - np.trace(S22)),
        float(np.vdot(S11, S11) + 2 * np.vdot(S12, S12) + np.vdot(S22, S22)),
        -(slope + curve @ h.ravel()) / gamma,
        pull,
    )


@cache
def _fft() -> Any:
    """The module scipy.fft, untyped."""
    return import_module("scipy.fft")


def _transform(X: Array, size: int) -> NDArray[np.complex128]:
    """Transform of X (n, n) with zeros up to (size, size), right half of its columns left out."""
    return _fft().fft(_fft().rfft(X, size, axis=1), size, axis=0, overwrite_x=True)


def _back(spectrum: NDArray[np.complex128], n: int) -> Array:
    """First (n, n) entries of the inverse transform."""
    size = len(spectrum)
    return _fft().irfft(_fft().ifft(spectrum, axis=0, overwrite_x=True)[:n], size, axis=1)[:, :n]


def _upside_down(spectrum: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Spectrum of the same signal with its rows in the order 0, -1, -2, ..."""
    return np.concatenate([spectrum[:1], spectrum[:0:-1]])


def _single_curvature(S11: Array, S12: Array) -> Array:
    """`_curvature` for one channel: S22 is S11, and S12' is S12, turned upside down in both directions."""
    n = len(S11)
    size = _fft().next_fast_len(2 * n - 1, real=True)
    turn = np.exp(2j * np.pi * (n - 1) / size * np.arange(size))
    straight = _transform(S11, size)
    crossed = _transform(S12, size)
    for part in (straight, crossed):
        part *= part
        part *= turn[:, None]
        part *= turn[: part.shape[1]]
    straight += _upside_down(np.conj(crossed))
    return 2 * _back(straight, n)


def _curvature(S11: Array, S12: Array, S22: Array, n: int, r: int, c: int) -> Array:
    r"""``2 tr(S12 E' S12 K') + 2 tr(S11 E S22 K')`` for all unit pulse responses E, K, as (n r c, n r c)."""
    size = _fft().next_fast_len(2 * n - 1, real=True)

    def part(X: Array, rows: int, cols: int) -> list[list[Array]]:
        view = X.reshape(rows, n, cols, n)
        return [[np.ascontiguousarray(view[a, :, b, :]) for b in range(cols)] for a in range(rows)]

    ones, mixed, twos = part(S11, r, r), part(S12, r, c), part(S22, c, c)
    first = [[_transform(x, size) for x in row] for row in ones]
    second = [[_transform(x, size) for x in row] for row in twos]
    upright = [[_transform(x, size) for x in row] for row in mixed]
    turned = [[_transform(x.T, size) for x in row] for row in mixed]
    found = np.empty((n, r, c, n, r, c))
    for a in range(r):
        for b in range(c):
            for a2 in range(r):
                for b2 in range(c):
                    if (a2, b2) < (a, b):
                        continue
                    # sum over p, q of S22[b, b2][p, q] S11[a, a2][p + j, q + k]
                    straight = np.conj(second[b][b2]) * first[a][a2]
                    # sum over p, q of S12[a, b2][p, q] S12'[b, a2][p - j, q + k]
                    crossed = np.conj(upright[a][b2]) * turned[a2][b]
                    both = 2 * _back(straight + _upside_down(crossed), n)
                    found[:, a, b, :, a2, b2] = both
                    found[:, a2, b2, :, a, b] = both.T
    return found.reshape(n * r * c, n * r * c)


def pull_after(h: Array, step: Array, gamma: float, more: float) -> Array:
    """``2 (gamma^2 I - T T')^-1 T`` after a step of h and gamma, to first order: (r n, c n)."""
    T, E = toeplitz(h), toeplitz(step)
    Q = np.linalg.inv(gamma**2 * np.eye(len(T)) - T @ T.T)
    right = Q @ T  # -S12
    # The (1, 2) block of S dF S with dF = [more I, E; E', more I].
    straight = Q @ (E + (E @ T.T) @ right)  # S11 E S22 = gamma Q E (I + T'Q T) / gamma
    crossed = right @ E.T @ right
    return 2 * right + 2 * (straight + crossed) - 4 * gamma * more * (Q @ right)


def trace_norm_bound(X: Array, c_wanted: Array) -> float:
    r"""Upper bound of ``max {sum c H : sigma_max(T(H)) <= 1}``: trace norm of any matrix with these diagonal sums.

    X is changed along its diagonals until its sums are exactly those wanted (n, r, c).
    """
    n, r, c = c_wanted.shape
    miss = c_wanted - diagonal_sums(X, n, r, c)
    count = (n - np.arange(n))[:, None, None]
    corrected = X + toeplitz(miss / count)
    return float(np.linalg.svd(corrected, compute_uv=False).sum())
