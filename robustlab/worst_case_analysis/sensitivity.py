r"""Exact sensitivities of responses, poles and gains to the entries of the state-space matrices, and to delta.

With :math:`S = \begin{bmatrix} A & B \\ C & D \end{bmatrix} = M_{22} + M_{21} \Delta (I - M_{11} \Delta)^{-1} M_{12}`

.. math:: dS = P \, d\Delta \, R, \quad P = M_{21} (I - \Delta M_{11})^{-1}, \quad R = (I - M_{11} \Delta)^{-1} M_{12},

so that :math:`G = \partial v / \partial S` gives :math:`\partial v / \partial \Delta = P^T G R^T`.

A response is differentiated by its adjoint: one simulation forwards, one backwards, and one derivative of the matrix
exponential give the sensitivity to all parameters at once.

References
----------
Al-Mohy, Higham, "Computing the Frechet derivative of the matrix exponential" (2009); Higham, *Functions of Matrices*
(2008), section 10.2 (block triangular form).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, Excitation, Hold, lft_parts, transitions


def delta_slope(uncertain: UncertainModel, delta: Array, slope: Array) -> Array:
    """``dv / dDelta`` (q, p) from ``slope = dv / d[A B; C D]`` at a real Delta (q, p)."""
    left, right, d11, _ = lft_parts(uncertain)
    q, p = uncertain.delta_shape
    if d11.any():
        left = np.linalg.solve((np.eye(q) - delta @ d11).T, left.T).T
        right = np.linalg.solve(np.eye(p) - d11 @ delta, right)
    with np.errstate(over="ignore", invalid="ignore"):
        found = left.T @ slope @ right.T
    refuse_overflow("worst_case", found)
    return found


def response_slope(ensemble: Ensemble, drive: Excitation, hold: Hold, weights: Array) -> Array:
    r"""Derivative of ``sum(weights * y)`` with respect to [A B; C D], for an ensemble of one member.

    .. math:: \lambda_j = \Phi^T \lambda_{j+1} + C^T w_j, \quad
              \frac{\partial v}{\partial \Phi} = \sum_j \lambda_{j+1} x_j^T, \quad
              \frac{\partial v}{\partial \Gamma} = \sum_j \lambda_{j+1} u_j^T

    and from there to A and B through the exponential of the block matrix that gave Phi and Gamma.

    ``weights``: ``dv / dy``, shape (n_t, n_y).
    """
    h, u = drive.h, drive.u
    phi, gamma, ramp = (matrix[0] for matrix in transitions(ensemble, h, hold))
    c, n, m = ensemble.C[0], ensemble.A.shape[1], ensemble.B.shape[2]
    steps = np.diff(u, axis=0)
    forced = u[:-1] @ gamma.T + steps @ ramp.T
    last = int(np.flatnonzero(weights.any(axis=1)).max(initial=0))
    x, adjoint = np.zeros((last + 1, n)), np.zeros((last + 1, n))
    for j in range(last):
        x[j + 1] = phi @ x[j] + forced[j]
    back = weights[: last + 1] @ c
    adjoint[last] = back[last]
    for j in range(last - 1, -1, -1):
        adjoint[j] = phi.T @ adjoint[j + 1] + back[j]
    result = np.zeros((n + c.shape[0], n + m))
    result[n:, :n] = weights[: last + 1].T @ x
    result[n:, n:] = weights[: last + 1].T @ u[: last + 1]
    ahead = adjoint[1:].T
    by_phi, by_gamma, by_ramp = ahead @ x[:-1], ahead @ u[:last], ahead @ steps[:last]
    if ensemble.dt:
        result[:n, :n], result[:n, n:] = by_phi, by_gamma
    elif n:
        result[:n] = _through_exponential(ensemble, h, hold, by_phi, by_gamma, by_ramp)
    return result


def _through_exponential(
    ensemble: Ensemble, h: float, hold: Hold, by_phi: Array, by_gamma: Array, by_ramp: Array
) -> Array:
    """``[dv/dA, dv/dB]`` from the derivatives with respect to Phi, Gamma and Gamma_1, in balanced states.

    The adjoint of the derivative of exp at X is the derivative of exp at X^T.
    """
    from scipy.linalg import expm

    a, b, scale = ensemble.A[0], ensemble.B[0], ensemble.scale
    n, m = b.shape
    column = np.exp2(np.rint(np.log2(np.maximum(np.abs(b / scale[:, None]).max(axis=0, initial=0.0), 1e-300))))
    orders = 2 if hold == "foh" else 1
    size = n + orders * m
    block, direction = np.zeros((size, size)), np.zeros((size, size))
    block[:n, :n] = a / scale[:, None] * scale * h
    block[:n, n : n + m] = b / scale[:, None] / column * h
    direction[:n, :n] = by_phi * scale[:, None] / scale
    direction[:n, n : n + m] = by_gamma * scale[:, None] * column
    if orders == 2:
        block[n : n + m, n + m :] = np.eye(m)
        direction[:n, n + m :] = by_ramp * scale[:, None] * column
    # The direction's size is no property of the problem: exp of the block triangular form must not overflow for it.
    unit = float(np.abs(direction).max()) or 1.0
    both = np.block([[block.T, direction / unit], [np.zeros((size, size)), block.T]])
    found = unit * expm(both)[:size, size:]
    by_a = found[:n, :n] * h / scale[:, None] * scale
    by_b = found[:n, n : n + m] * h / scale[:, None] / column
    return np.hstack([by_a, by_b])


def steady_state_slope(ensemble: Ensemble, u: Array) -> Array:
    """Derivative of the first output's final value under constant inputs u (n_u,), with respect to [A B; C D]."""
    a, b, c = ensemble.A[0], ensemble.B[0], ensemble.C[0]
    n = len(a)
    shifted = np.eye(n) - a if ensemble.dt else -a
    x, back = np.linalg.solve(shifted, b @ u), np.linalg.solve(shifted.T, c[0])
    result = np.zeros((n + len(c), n + len(u)))
    result[:n] = np.outer(back, np.concatenate([x, u]))
    result[n] = np.concatenate([x, u])
    return result


def pole_slope(a: Array, index: int) -> tuple[complex, NDArray[np.complex128]]:
    r"""An eigenvalue and ``d lambda / d A_{ij}`` = :math:`\bar y_i x_j / (y^H x)`, shape (n_x, n_x).

    Infinite entries, where the eigenvalue is defective: it moves with the root of a change there.
    """
    from scipy.linalg import eig

    poles, left, right = (np.asarray(part) for part in eig(a, left=True, right=True))
    y, x = left[:, index].conj(), right[:, index]
    overlap = y @ x
    with np.errstate(divide="ignore", invalid="ignore"):
        return complex(poles[index]), np.asarray(np.outer(y, x) / overlap, dtype=np.complex128)
