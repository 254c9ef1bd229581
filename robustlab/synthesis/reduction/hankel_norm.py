r"""Optimal Hankel-norm approximation of a stable continuous model, by the all-pass dilation of its balanced states.

With :math:`\Sigma = \mathrm{diag}(\Sigma_1, \sigma I)`, :math:`\sigma = \sigma_{k+1}`, and A, B, C cut alike,

.. math:: U = -(C_2^T)^+ B_2, \quad \Gamma = \Sigma_1^2 - \sigma^2 I, \quad
   \hat A = \Gamma^{-1} (\sigma^2 A_{11}^T + \Sigma_1 A_{11} \Sigma_1 - \sigma C_1^T U B_1^T), \quad
   \hat B = \Gamma^{-1} (\Sigma_1 B_1 + \sigma C_1^T U), \quad \hat C = C_1 \Sigma_1 + \sigma U B_1^T, \quad
   \hat D = D - \sigma U

differs from the model by no more than sigma at any frequency. Its k stable modes are the nearest model of order k in
the Hankel norm, at a distance of exactly sigma; a constant stands for the others, which are not stable. U is a
contraction: a block of a unitary matrix that does the same for the model with rows and columns of zeros, so that models
need not be square, and no part of U is left to choice.

References
----------
Glover, "All optimal Hankel-norm approximations of linear multivariable systems and their L-infinity error bounds", Int.
J. Control 39 (1984), theorems 6.3 and 9.7.
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.reduction.balancing import Balancing, gramian_factors, split_stable

__all__ = ["error_bound", "hankel_bound", "hankel_norm", "nearest_in_hankel_norm"]

# Hankel values that agree to this share are one repeated value: dividing by their difference would cost more digits.
REPEATED = 1e-8


def _dilated(m: StateSpaceModel, values: AnyArray, k: int, unitary: bool = False) -> tuple[StateSpaceModel, AnyArray]:
    """The dilation of a balanced model that leaves out the value at index k, however often it comes, and the others.

    Its states are times the root of ``|Gamma|``; U may be completed to a unitary matrix for a square model.
    """
    level = values[k]
    cut = np.abs(values - level) <= REPEATED * level
    u = -np.linalg.pinv(m.C[:, cut].T) @ m.B[cut]
    if unitary:
        eye = np.eye(len(u))
        left, _, right = np.linalg.svd(u + (eye - u @ u.T) @ (eye - u.T @ u))
        u = left @ right
    s, a, b, c = values[~cut], m.A[np.ix_(~cut, ~cut)], m.B[~cut], m.C[:, ~cut]
    gamma = s**2 - level**2
    root = np.sqrt(np.abs(gamma))
    inverse = (np.sign(gamma) / root)[:, None]
    middle = level**2 * a.T + s[:, None] * a * s - level * c.T @ u @ b.T
    dilated = StateSpaceModel(
        inverse * middle / root,
        inverse * (s[:, None] * b + level * c.T @ u),
        (c * s + level * u @ b.T) / root,
        m.D - level * u,
    )
    return dilated, s


def nearest_in_hankel_norm(model: StateSpaceModel, balancing: Balancing, order: int) -> StateSpaceModel:
    """The nearest model of at most this order; of fewer where the value after the cut is a repeated one."""
    values = balancing.values[: len(balancing.left)]
    if order >= len(values):
        return balancing.reduced(model, order, "truncation")
    order = int((values > values[order] * (1 + REPEATED)).sum())
    parts = split_stable(_dilated(balancing.reduced(model, len(values), "truncation"), values, order)[0])
    if parts.stable.n_states != order:
        found = f"{parts.stable.n_states} stable modes where there should be {order}: digits were lost"
        raise NoTrustworthyNumber("Hankel-norm approximation", found, hint="another order, or method='truncation'")
    m = parts.stable
    return StateSpaceModel(m.A, m.B, m.C, m.D + _constant_near(parts.apart), 0.0, model.inputs, model.outputs)


def _constant_near(unstable: StateSpaceModel) -> AnyArray:
    """A constant no farther from a strictly proper model without stable modes than the sum of its Hankel values.

    One value after another, the smallest first: each dilation moves the model by no more than the value that it takes,
    and is balanced again with the other values, as long as the model is square and U unitary.
    """
    mirrored = StateSpaceModel(-unstable.A, -unstable.B, unstable.C, unstable.D)
    balancing = Balancing.of(*gramian_factors(mirrored))
    values = balancing.values[: len(balancing.left)]
    left = balancing.reduced(mirrored, len(values), "truncation")
    (p, m), n = left.D.shape, left.n_states
    into, out = np.zeros((n, max(0, p - m))), np.zeros((max(0, m - p), n))
    direct = np.pad(left.D, ((0, len(out)), (0, into.shape[1])))
    left = StateSpaceModel(left.A, np.hstack([left.B, into]), np.vstack([left.C, out]), direct)
    while len(values):
        left, values = _dilated(left, values, len(values) - 1, unitary=True)
    return left.D[:p, :m]


def error_bound(values: AnyArray, order: int) -> float:
    """Twice the sum of the Hankel values after the first ``order``, each counted once where it is repeated.

    Values that agree to 1e-10 count as repeated only where the cut does not separate them from kept ones.
    """
    tail = values[order:]
    if not len(tail):
        return 0.0
    new = np.append(True, tail[1:] < tail[:-1] * (1 - 1e-10))
    distinct = tail[new]
    if order and tail[0] >= values[order - 1] * (1 - 1e-10):  # a repeated value was cut in two: count all of them
        distinct = tail
    return 2 * float(distinct.sum())


def hankel_bound(values: AnyArray, order: int) -> float:
    """What the H-infinity error cannot exceed: the value after the cut once, and the sum of all that are smaller."""
    if order >= len(values):
        return 0.0
    level = values[order]
    return float(level + values[values < level * (1 - REPEATED)].sum())


def hankel_norm(model: StateSpaceModel) -> float:
    """The largest Hankel value of a stable model, continuous or discrete."""
    return float(Balancing.of(*gramian_factors(model)).values.max(initial=0.0))
