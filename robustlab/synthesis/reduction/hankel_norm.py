r"""Optimal Hankel-norm approximation of a stable continuous model, by the all-pass dilation of its balanced states.

With :math:`\Sigma = \mathrm{diag}(\Sigma_1, \sigma I)`, :math:`\sigma = \sigma_{k+1}`, and A, B, C cut alike,

.. math:: U = -(C_2^T)^+ B_2, \quad \Gamma = \Sigma_1^2 - \sigma^2 I, \quad
   \hat A = \Gamma^{-1} (\sigma^2 A_{11}^T + \Sigma_1 A_{11} \Sigma_1 - \sigma C_1^T U B_1^T), \quad
   \hat B = \Gamma^{-1} (\Sigma_1 B_1 + \sigma C_1^T U), \quad \hat C = C_1 \Sigma_1 + \sigma U B_1^T, \quad
   \hat D = D - \sigma U

differs from the model by no more than sigma at any frequency. Its k stable modes are the nearest model of order k in
the Hankel norm, at a distance of exactly sigma; the others are as unstable as the values beyond sigma are many, and a
constant stands for them.

References
----------
Glover, "All optimal Hankel-norm approximations of linear multivariable systems and their L-infinity error bounds", Int.
J. Control 39 (1984), theorems 6.3 and 9.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.reduction.balancing import Balancing, gramian_factors, split_stable

__all__ = ["hankel_bound", "hankel_norm", "nearest_in_hankel_norm"]

# Hankel values that agree to this share are one repeated value: dividing by their difference would cost more digits.
REPEATED = 1e-8


@dataclass(frozen=True, eq=False)
class _Balanced:
    """A, B, C in balanced states, their values, and what was taken from D on the way."""

    a: AnyArray
    b: AnyArray
    c: AnyArray
    values: AnyArray
    direct: AnyArray

    @classmethod
    def of(cls, model: StateSpaceModel, balancing: Balancing) -> _Balanced:
        a, b, c = balancing.left @ model.A @ balancing.right, balancing.left @ model.B, model.C @ balancing.right
        return cls(a, b, c, balancing.values[: len(a)], model.D)

    def dilated(self, k: int) -> _Balanced:
        """Without the value at index k, however often it comes; states scaled by the root of ``|Gamma|``.

        In these states it is balanced again where that value was the smallest.
        """
        level = self.values[k]
        cut = np.abs(self.values - level) <= REPEATED * level
        kept = ~cut
        s, a = self.values[kept], self.a[np.ix_(kept, kept)]
        b, c = self.b[kept], self.c[:, kept]
        u = -np.linalg.pinv(self.c[:, cut].T) @ self.b[cut]
        gamma = s**2 - level**2
        root, sign = np.sqrt(np.abs(gamma)), np.sign(gamma)
        middle = level**2 * a.T + s[:, None] * a * s - level * c.T @ u @ b.T
        return _Balanced(
            (sign / root)[:, None] * middle / root,
            (sign / root)[:, None] * (s[:, None] * b + level * c.T @ u),
            (c * s + level * u @ b.T) / root,
            s,
            self.direct - level * u,
        )


def nearest_in_hankel_norm(model: StateSpaceModel, balancing: Balancing, order: int) -> StateSpaceModel:
    """The nearest model of at most this order; of fewer where the value after the cut is a repeated one.

    Raises
    ------
    NoTrustworthyNumber
        As many modes are stable as there should not be: digits were lost.
    """
    full = _Balanced.of(model, balancing)
    if order >= len(full.values):
        return balancing.reduced(model, order, "truncation")
    order = int((full.values > full.values[order] * (1 + REPEATED)).sum())
    near = full.dilated(order)
    parts = split_stable(StateSpaceModel(near.a, near.b, near.c, near.direct))
    if parts.stable.n_states != order:
        found = f"{parts.stable.n_states} stable modes where there should be {order}: digits were lost"
        raise NoTrustworthyNumber("Hankel-norm approximation", found, hint="another order, or method='truncation'")
    m = parts.stable
    return StateSpaceModel(m.A, m.B, m.C, m.D + _constant_near(parts.apart), 0.0, model.inputs, model.outputs)


def _constant_near(unstable: StateSpaceModel) -> AnyArray:
    """A constant no farther from a strictly proper model without stable modes than the sum of its Hankel values.

    One value after another, the smallest first: each dilation moves the model by no more than the value that it takes.
    """
    mirrored = StateSpaceModel(-unstable.A, -unstable.B, unstable.C, unstable.D)
    left = _Balanced.of(mirrored, Balancing.of(*gramian_factors(mirrored)))
    while len(left.values):
        left = left.dilated(len(left.values) - 1)
    return left.direct


def hankel_bound(values: AnyArray, order: int) -> float:
    """What the H-infinity error cannot exceed: the value after the cut once, and the sum of all that are smaller."""
    if order >= len(values):
        return 0.0
    level = values[order]
    return float(level + values[values < level * (1 - REPEATED)].sum())


def hankel_norm(model: StateSpaceModel) -> float:
    """The largest Hankel value of a stable model, continuous or discrete."""
    return float(Balancing.of(*gramian_factors(model)).values.max(initial=0.0))
