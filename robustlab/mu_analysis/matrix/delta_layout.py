"""Index arrays of the blocks of Delta: stacks of Deltas are built and measured without a loop over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.uncertainty.blocks import Block, block_slices, structure_size


@dataclass(frozen=True, eq=False)
class DeltaLayout:
    """Index arrays of one block structure."""

    # q, p: Delta is q x p
    q: int
    p: int
    # real, full: which blocks are real scalars, and which are full blocks of more than one entry; shape (n_blocks,)
    real: Mask
    full: Mask
    # of_w, of_z: the block of each row and each column of Delta, shapes (q,), (p,)
    of_w: Indices
    of_z: Indices
    # entry_w, entry_z, entry_block: row, column and block of every entry of Delta that may be non-zero
    entry_w: Indices
    entry_z: Indices
    entry_block: Indices

    @property
    def n(self) -> int:
        """Number of blocks."""
        return len(self.real)

    def gains(self, row: ComplexArray, x: ComplexArray) -> ComplexArray:
        """Return a (k, n_blocks) with ``row Delta x = sum a_i delta_i``; ``|row_i| |x_i|`` for a full block."""
        sums = self._sum(row[:, self.entry_w] * x[:, self.entry_z], self.entry_block)
        if not self.full.any():
            return sums
        return np.where(self.full, self.vector_sizes(row, self.of_w) * self.vector_sizes(x, self.of_z), sums)

    def deltas(self, values: Array | ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
        """Build Delta (k, q, p) from one number per block (k, n_blocks); full blocks are aligned with row and x."""
        delta = np.zeros((len(values), self.q, self.p), dtype=complex)
        entries = values[:, self.entry_block]
        if self.full.any():
            left = np.conj(row) / np.maximum(self.vector_sizes(row, self.of_w), 1e-300)[:, self.of_w]
            right = np.conj(x) / np.maximum(self.vector_sizes(x, self.of_z), 1e-300)[:, self.of_z]
            rank_one = left[:, self.entry_w] * right[:, self.entry_z]
            entries = np.where(self.full[self.entry_block], entries * rank_one, entries)
        delta[:, self.entry_w, self.entry_z] = entries
        return delta

    def sizes(self, delta: ComplexArray) -> Array:
        """Return the largest singular value of each block of Delta (k, q, p), shape (k, n_blocks)."""
        first_w = np.searchsorted(self.of_w, np.arange(self.n))
        first_z = np.searchsorted(self.of_z, np.arange(self.n))
        result = np.abs(delta[:, first_w, first_z])
        for i in np.flatnonzero(self.full):
            part = delta[:, self.of_w == i][:, :, self.of_z == i]
            result[:, i] = np.linalg.norm(part, 2, axis=(1, 2))
        return result

    def contributions(self, delta: ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
        """Return the parts ``row_i Delta_i x_i`` (k, n_blocks) of ``row Delta x``."""
        entries = row[:, self.entry_w] * delta[:, self.entry_w, self.entry_z] * x[:, self.entry_z]
        return self._sum(entries, self.entry_block)

    def _sum(self, entries: ComplexArray, block: Indices) -> ComplexArray:
        """Sum over the columns of each block; the columns are ordered by block."""
        if len(block) == self.n:
            return entries
        return np.add.reduceat(entries, np.searchsorted(block, np.arange(self.n)), axis=1)

    def vector_sizes(self, vectors: ComplexArray, block: Indices) -> Array:
        """Return the Euclidean norm of the part of each block; block is ``of_w`` or ``of_z``."""
        return np.sqrt(self._sum((vectors * np.conj(vectors)), block).real)


def delta_layout(blocks: Sequence[Block]) -> DeltaLayout:
    """Return the index arrays of these blocks (at least one)."""
    entries: list[tuple[int, int, int]] = []
    for i, (block, (w, z)) in enumerate(zip(blocks, block_slices(blocks), strict=True)):
        if block.is_scalar:
            entries += [(w.start + r, z.start + r, i) for r in range(block.rows)]
        else:
            entries += [(r, c, i) for r in range(w.start, w.stop) for c in range(z.start, z.stop)]
    parts, (q, p) = np.arange(len(blocks)), structure_size(blocks)
    entry_w, entry_z, entry_block = np.array(entries, dtype=np.intp).T
    return DeltaLayout(
        q=q,
        p=p,
        real=np.array([b.interval is not None for b in blocks]),
        full=np.array([not b.is_scalar and b.rows * b.cols > 1 for b in blocks]),
        of_w=np.repeat(parts, [b.rows for b in blocks]),
        of_z=np.repeat(parts, [b.cols for b in blocks]),
        entry_w=entry_w,
        entry_z=entry_z,
        entry_block=entry_block,
    )
