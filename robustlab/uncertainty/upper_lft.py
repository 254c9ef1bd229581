"""The upper linear fractional transformation of a model and a constant Delta, and its well-posedness."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import balancing_factors
from robustlab.linear_analysis.structural import strong_components
from robustlab.statespace import StateSpaceModel

ILL_POSED = 1e12  # condition number of I - M11 Delta above which results are rounding


def is_singular(product: ArrayLike) -> bool:
    """Return whether ``I - product`` (n, n) is singular or too ill-conditioned."""
    matrix = np.asarray(product)
    if not matrix.any():
        return False
    label = strong_components(matrix != 0)
    for k in range(int(label.max()) + 1):
        part = np.flatnonzero(label == k)
        inner = matrix[part[:, None], part]
        scale = balancing_factors(inner)  # the answer is independent of the units of channels
        if inner.any() and not np.linalg.cond(np.eye(len(part)) - inner / scale[:, None] * scale) <= ILL_POSED:
            return True
    return False


def upper_lft(M: StateSpaceModel, delta: ArrayLike) -> StateSpaceModel:
    """Return ``F_u(M, Delta)`` for a constant real Delta (q, p) on the first q inputs and p outputs of M."""
    d = np.asarray(delta)
    if np.iscomplexobj(d):
        raise InputError(
            "upper_lft", "a complex Delta", "a real one", "a complex Delta acts on frequency responses only"
        )
    q, p = d.shape
    n_w, n_z = M.n_inputs, M.n_outputs
    b1, b2 = M.B[:, :q], M.B[:, q:]
    c1, c2 = M.C[:p], M.C[p:]
    d11, d12, d21, d22 = M.D[:p, :q], M.D[:p, q:], M.D[p:, :q], M.D[p:, q:]
    if q > n_w or p > n_z:
        raise InputError("upper_lft", f"Delta is {d.shape}, M has {n_w} inputs and {n_z} outputs", "a smaller Delta")
    loop = np.eye(p) - d11 @ d
    if is_singular(d11 @ d):
        raise NoTrustworthyNumber("upper_lft", "I - D11 Delta is singular: this Delta makes the model ill-posed")
    # z = (I - D11 Delta)^-1 (C1 x + D12 u), w = Delta z
    gain = d @ np.linalg.solve(loop, np.hstack([c1, d12])) if p else np.zeros((q, M.n_states + n_w - q))
    w_x, w_u = gain[:, : M.n_states], gain[:, M.n_states :]
    return StateSpaceModel(
        M.A + b1 @ w_x,
        b2 + b1 @ w_u,
        c2 + d21 @ w_x,
        d22 + d21 @ w_u,
        M.dt,
        M.inputs[q:],
        M.outputs[p:],
        M.states,
        where="upper_lft",
    )


def closed_response(m: AnyArray, d: AnyArray) -> AnyArray:
    """Return ``F_u`` of responses m (n_omega, ..., ...) for Delta d, one (q, p) or one for each frequency."""
    q, p = d.shape[-2:]
    loop = np.eye(p) - m[:, :p, :q] @ d
    return m[:, p:, q:] + m[:, p:, :q] @ d @ np.linalg.solve(loop, m[:, :p, q:])
