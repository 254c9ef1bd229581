"""Delta from a vector in the box [-1, 1]^d, for search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.uncertainty.blocks import Block, RealScalar, block_slices, structure_size

__all__ = ["DeltaBox"]

Array = NDArray[np.float64]


class DeltaBox:
    """Delta from a vector in [-1, 1]^d: a number for a real scalar, real and imaginary parts for the rest.

    A complex scalar or a full matrix outside its ball is drawn back onto it, so every vector gives a Delta of the set.
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.slices: list[slice] = []
        size = 0
        for b in self.blocks:
            width = 1 if isinstance(b, RealScalar) else 2 * self._entries(b)
            self.slices.append(slice(size, size + width))
            size += width
        self.size = size
        self.real = [s.start for b, s in zip(self.blocks, self.slices, strict=True) if isinstance(b, RealScalar)]

    @property
    def all_real(self) -> bool:
        """Whether every block is a real scalar."""
        return len(self.real) == len(self.blocks)

    @staticmethod
    def _entries(block: Block) -> int:
        return block.rows * block.cols if not hasattr(block, "repeats") else 1

    def deltas(self, theta: Array) -> NDArray[Any]:
        """Stack of Deltas (k, q, p) from vectors (k, d)."""
        dtype = float if self.all_real else complex
        delta = np.zeros((len(theta), *structure_size(self.blocks)), dtype=dtype)
        for block, part, (rows, cols) in zip(self.blocks, self.slices, block_slices(self.blocks), strict=True):
            number = theta[:, part]
            if isinstance(block, RealScalar):
                number = np.where(number < 0, number * block.ratio, number)
                delta[:, rows, cols] = number[:, :, None] * np.eye(block.rows)
                continue
            half = number.shape[1] // 2
            entries = number[:, :half] + 1j * number[:, half:]
            if half == 1:
                entries = entries / np.maximum(np.abs(entries), 1.0)
                delta[:, rows, cols] = entries[:, :, None] * np.eye(block.rows, block.cols)
                continue
            matrix = entries.reshape(-1, block.rows, block.cols)
            delta[:, rows, cols] = matrix / np.maximum(np.linalg.norm(matrix, 2, axis=(1, 2)), 1.0)[:, None, None]
        return delta

    def slope(self, theta: Array, delta_slope: Array) -> Array:
        """``dv / dtheta (d,)`` from ``dv / dDelta (q, p)``, for real scalars; at 0 the slope of the upper side."""
        diagonal = np.array(
            [np.trace(delta_slope[rows, cols]) for rows, cols in block_slices(self.blocks)], dtype=float
        )
        below = np.array([b.ratio for b in self.blocks if isinstance(b, RealScalar)])
        return np.where(theta < 0, below, 1.0) * diagonal
