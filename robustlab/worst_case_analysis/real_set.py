r"""Members of a set with real scalar blocks only, many at once and without a Delta matrix for each.

With :math:`S = \begin{bmatrix} A & B \\ C & D \end{bmatrix}` and the diagonal :math:`\Delta = \mathrm{diag}(c)`,

.. math:: S(c) = S_0 + L \, \mathrm{diag}(c) \, (I - D_{11} \mathrm{diag}(c))^{-1} R,

which is :math:`S_0 + \sum_k c_k L_k R_k` where D11 = 0, as in element-wise sets.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.uncertainty.blocks import RealScalar
from robustlab.uncertainty.lft import ILL_POSED, UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, split, state_scale

__all__ = ["RealSet"]

Array = NDArray[np.float64]

# Members are computed in blocks of this size that begin at its multiples: what comes out for a sample cannot depend on
# how many are drawn, nor on who computes its block. Large models take smaller blocks, of so many numbers.
BLOCK, NUMBERS = 512, 2_000_000
# Numbers of the table of all L_k R_k, up to which it is made.
LARGEST_TABLE = 4_000_000


class RealSet:
    """A set of real scalar blocks, prepared for the evaluation of many members.

    `block` is how many members belong in one call.

    Parameters
    ----------
    uncertain
        A set whose blocks are all `RealScalar`.
    """

    def __init__(self, uncertain: UncertainModel) -> None:
        m, (q, p) = uncertain.M, uncertain.delta_shape
        blocks = [b for b in uncertain.blocks if isinstance(b, RealScalar)]
        assert len(blocks) == len(uncertain.blocks)
        self.n_states, self.dt = m.n_states, m.dt
        self.below = np.array([b.ratio for b in blocks])
        self.of_channel = np.repeat(np.arange(len(blocks)), [b.repeats for b in blocks])
        self._scale = state_scale(m.A)
        self._left = np.vstack([m.B[:, :q], m.D[p:, :q]])
        self._right = np.hstack([m.C[:p], m.D[:p, q:]])
        self._d11 = m.D[:p, :q]
        self._nominal = np.block([[m.A, m.B[:, q:]], [m.C[p:], m.D[p:, q:]]])
        self._table: Array | None = None
        self.block = max(1, min(BLOCK, NUMBERS // max(1, self._nominal.size)))
        small = self.block == BLOCK and len(blocks) * self._nominal.size <= LARGEST_TABLE
        if not self._d11.any() and small:
            products = self._left.T[:, :, None] * self._right[:, None, :]
            table = np.zeros((len(blocks), *self._nominal.shape))
            np.add.at(table, self.of_channel, products)
            self._table = table.reshape(len(blocks), self._nominal.size)

    def __len__(self) -> int:
        return len(self.below)

    def channels(self, theta: Array) -> Array:
        """The numbers on Delta's diagonal (k, q) that belong to normalised deltas (k, d)."""
        return np.where(theta < 0, theta * self.below, theta)[:, self.of_channel]

    def members(self, theta: Array) -> Ensemble:
        """The members at normalised deltas (k, d)."""
        k = len(theta)
        ill_posed = np.zeros(k, dtype=bool)
        if self._table is not None:
            # Filled up to whole blocks: a product of another shape may round differently.
            numbers = np.zeros((-(-k // BLOCK) * BLOCK, len(self)))
            numbers[:k] = np.where(theta < 0, theta * self.below, theta)
            change = np.concatenate([numbers[i : i + BLOCK] @ self._table for i in range(0, len(numbers), BLOCK)])
            whole = self._nominal + change[:k].reshape(k, *self._nominal.shape)
            return split(whole, self.n_states, self.dt, ill_posed, self._scale)
        diagonal = self.channels(theta)
        right: NDArray[Any] = np.broadcast_to(self._right, (k, *self._right.shape))
        if self._d11.any():
            loop = np.eye(len(self._d11)) - self._d11 * diagonal[:, None, :]
            ill_posed = ~(np.linalg.cond(loop) <= ILL_POSED)
            loop[ill_posed] = np.eye(len(self._d11))
            diagonal = np.where(ill_posed[:, None], 0.0, diagonal)
            right = np.linalg.solve(loop, right)
        whole = self._nominal + (self._left * diagonal[:, None, :]) @ right
        return split(whole, self.n_states, self.dt, ill_posed, self._scale)
