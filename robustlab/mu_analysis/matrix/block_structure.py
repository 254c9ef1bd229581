"""Block structures: index arrays of Delta, the scalings D and G, strongly connected components of M."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.linear_analysis.structural import strong_components
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

SWEEPS, BALANCED = 400, 0.005  # of balancing at most, and its accuracy in binary digits


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
    real = np.array([b.interval is not None for b in blocks])
    full = np.array([not b.is_scalar and b.rows * b.cols > 1 for b in blocks])
    of_w, of_z = np.repeat(parts, [b.rows for b in blocks]), np.repeat(parts, [b.cols for b in blocks])
    return DeltaLayout(q, p, real, full, of_w, of_z, entry_w, entry_z, entry_block)


def delta_norm(blocks: Sequence[Block], delta: ComplexArray) -> float:
    """Return the largest singular value of the blocks of Delta (q, p)."""
    pairs = zip(blocks, block_slices(blocks), strict=True)
    return max((block.norm(delta[w, z]) for block, (w, z) in pairs), default=0.0)


def project(blocks: Sequence[Block], delta: ComplexArray) -> ComplexArray:
    """Return the nearest Delta of exactly this structure."""
    result = np.zeros(delta.shape, dtype=complex)
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        result[w, z] = block.project(delta[w, z])
    return result


# --- scalings D and G ----------------------------------------------------------------------------------------------


# With U = [I, M^*] the matrix of the D-G inequality is U E(x) U^* with one sparse Hermitian E of order q + p, so that
# gradients and Hessians of its barrier need products of single entries of U^* P U only.
def hermitian(X: NDArray) -> NDArray:
    """Return the conjugate transpose over the last two axes."""
    return np.conj(np.swapaxes(X, -1, -2))


def supply(M: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> ComplexArray:
    """Return ``M^* D_z M + j (G M - M^* G^*)``, the lower bound of ``beta^2 D_w``, of one matrix or of a stack."""
    product = G @ M
    return hermitian(M) @ Dz @ M + 1j * (product - hermitian(product))


def relative(X: ComplexArray, Y: ComplexArray) -> ComplexArray:
    """Return ``L^-1 Y L^-*`` for ``X = L L^*``: its eigenvalues are those of Y relative to the positive definite X."""
    factor = np.linalg.cholesky(X)
    half = np.linalg.solve(factor, Y)
    value = np.linalg.solve(factor, hermitian(half))
    return (value + hermitian(value)) / 2


class ScalingSpace:
    """Real parameters of all D and G of a block structure."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.q, self.p = structure_size(blocks)
        parameters: list[list[tuple[int, int, complex, int]]] = []
        identity: list[float] = []
        for block, (w, z) in zip(self.blocks, block_slices(blocks), strict=True):
            for on_w, on_z in block.d_basis():
                first = [(w.start + i, w.start + j, c, 1) for i, j, c in on_w]
                parameters.append(first + [(self.q + z.start + i, self.q + z.start + j, -c, 0) for i, j, c in on_z])
                identity.append(float(all(i == j for i, j, _ in on_w)))
            for pattern in block.g_basis():
                entries = [(w.start + i, self.q + z.start + j, -1j * c, 0) for i, j, c in pattern]
                parameters.append(entries + [(b, a, np.conj(c), 0) for a, b, c, _ in entries])
                identity.append(0.0)
        flat = [entry for parameter in parameters for entry in parameter]
        self.size = len(parameters)
        rows, cols, coefficients, in_w = zip(*flat, strict=True)
        self.rows, self.cols = np.array(rows), np.array(cols)
        self.coefficients, self.in_w = np.array(coefficients, dtype=complex), np.array(in_w, dtype=float)
        lengths = [len(parameter) for parameter in parameters]
        self.first = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(int)
        # Two parameters (a real and an imaginary part) may share an entry of E: sum them.
        place = self.rows * (self.q + self.p) + self.cols
        order = np.argsort(place, kind="stable")
        self._places, self._begin = np.unique(place[order], return_index=True)
        self._owner = np.repeat(np.arange(self.size), lengths)[order]
        self._ordered = self.coefficients[order]
        self.identity = np.array(identity)
        # The first entry of every parameter is in the rows of w.
        self.scales_with_m = (self.cols[self.first] >= self.q) & (self.rows[self.first] < self.q)

    def matrices(self, x: Array) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return ``D_w (k, q, q)``, ``D_z (k, p, p)``, ``G (k, q, p)`` of parameters x (k, size)."""
        q, n = self.q, self.q + self.p
        e = np.zeros((len(x), n * n), dtype=complex)
        values = x[:, self._owner] * self._ordered
        e[:, self._places] = np.add.reduceat(values, self._begin, axis=1)
        e = e.reshape(len(x), n, n)
        return e[:, :q, :q], -e[:, q:, q:], 1j * e[:, :q, q:]


scaling_space = lru_cache(maxsize=256)(ScalingSpace)  # of a tuple of blocks


# --- components and balancing --------------------------------------------------------------------------------------


# Without balancing AB13MD calls 32 196 a bound where mu is 1.914 (entries over 12 decades); on reducible matrices it
# is 20 to 40 times slower. mu of a block-triangular M is the largest mu of its diagonal components. LAPACK's balancing
# (gebal) ends too early: on sparse matrices over eight decades it loses up to 80 % of the lower bound.
@dataclass(frozen=True)
class Component:
    """A strongly connected set of blocks of one matrix."""

    members: tuple[int, ...]  # indices of its blocks
    depth: int  # number of components before it on the longest path; w flows from a lower to a higher depth
    exponents: Array  # scaling `2^exponent` per member: `M_ij 2^(e_i - e_j)` is balanced
    matrix: ComplexArray  # the balanced diagonal part of M


def block_norms(M: ComplexArray, blocks: Sequence[Block]) -> Array:
    """Return the largest entry of each block ``M_ij`` (outputs of block i, inputs of block j), of one M or a stack."""
    if not M.size:
        return np.zeros((*M.shape[:-2], len(blocks), len(blocks)))
    w, z = (np.array([part[side].start for part in block_slices(blocks)]) for side in (0, 1))
    return np.maximum.reduceat(np.maximum.reduceat(np.abs(M), z, axis=-2), w, axis=-1)


def expand(blocks: Sequence[Block], values: Array) -> tuple[Array, Array]:
    """Repeat one value per block over its entries of w and of z."""
    return np.repeat(values, [b.rows for b in blocks]), np.repeat(values, [b.cols for b in blocks])


def entries(blocks: Sequence[Block], members: Sequence[int] | Indices) -> tuple[Indices, Indices]:
    """Return the rows (entries of w) and columns (entries of z) of Delta of some blocks, in their order."""
    slices = block_slices(blocks)
    w, z = ([np.arange(slices[i][side].start, slices[i][side].stop) for i in members] for side in (0, 1))
    return np.concatenate(w), np.concatenate(z)


def components(M: ComplexArray, blocks: Sequence[Block]) -> list[Component]:
    """Return the strongly connected components of M in the direction of signals, each balanced."""
    if not blocks:
        return []
    norms = block_norms(M, blocks)
    labels = strong_components(norms > 0)
    # M_ij != 0: w_j drives z_i, so component of j comes before that of i.
    depth = depths(norms > 0, labels, np.ones(len(blocks), dtype=bool))
    result = []
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        exponents = _osborne(norms[None, members[:, None], members])[0]
        w, z = expand([blocks[int(i)] for i in members], np.exp2(exponents))
        of_w, of_z = entries(blocks, members)
        matrix = M[of_z[:, None], of_w] * z[:, None] / w
        result.append(Component(tuple(int(i) for i in members), int(depth[members[0]]), exponents, matrix))
    return result


def depths(acts: Mask, labels: Indices, counted: Mask) -> Indices:
    """Return for each node the most components with counted nodes on a path to it; ``acts[i, j]``: edge j to i."""
    owner = np.arange(labels.max(initial=-1) + 1)[:, None] == labels
    before = (owner @ acts @ owner.T) & ~np.eye(len(owner), dtype=bool)
    weights, depth = (owner & counted).any(axis=1).astype(int), np.zeros(len(owner), dtype=int)
    for _ in before:  # a path has at most this many components
        depth = np.where(before, depth + weights, 0).max(axis=1, initial=0)
    return depth[labels]


def balancing_exponents(M: ComplexArray, blocks: Sequence[Block]) -> Array:
    """Return exponents per block (k, n) that balance M (k, p, q) as wholes; smaller couplings count as 1e-6."""
    norms = block_norms(M, blocks)
    least = 1e-6 * norms.max(axis=(1, 2), keepdims=True, initial=0.0)
    return _osborne(np.maximum(norms, np.maximum(least, 1e-300)))


def _osborne(norms: Array) -> Array:
    """Return integer exponents e (k, n) that balance the norms of row i and column i of ``norms_ij 2^(e_i - e_j)``."""
    k, n = norms.shape[:2]
    e = np.zeros((k, n))
    if n < 2:
        return e
    with np.errstate(divide="ignore"):
        log = np.log2(np.where(np.eye(n, dtype=bool), 0.0, norms))
    for _ in range(SWEEPS):
        scaled = log + e[:, :, None] - e[:, None, :]
        ends = np.stack([scaled, np.swapaxes(scaled, 1, 2)])
        top = ends.max(axis=3, keepdims=True)
        row, column = 0.5 * np.log2((4.0 ** (ends - top)).sum(axis=3)) + top[..., 0]
        # Half of the step that balances one row and column alone: all are moved at once.
        step = 0.25 * (column - row)
        e += step
        if np.abs(step).max() < BALANCED:
            break
    return np.round(e - np.round(e.mean(axis=1, keepdims=True)))
