"""Preparation of M for the solvers: strongly connected components, and balancing by powers of two."""

# Without balancing AB13MD calls 32 196 a bound where mu is 1.914 (entries over 12 decades); on reducible matrices it
# is 20 to 40 times slower. mu of a block-triangular M is the largest mu of its diagonal components. LAPACK's balancing
# (gebal) ends too early: on sparse matrices over eight decades it loses up to 80 % of the lower bound.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.linear_analysis.structural import strong_components
from robustlab.uncertainty.blocks import Block, block_slices


@dataclass(frozen=True)
class Component:
    """A strongly connected set of blocks of one matrix."""

    members: tuple[int, ...]  # indices of its blocks
    depth: int  # number of components before it on the longest path; w flows from a lower to a higher depth
    exponents: Array  # scaling `2^exponent` per member: `M_ij 2^(e_i - e_j)` is balanced
    matrix: ComplexArray  # the balanced diagonal part of M


def block_norms(M: ComplexArray, blocks: Sequence[Block]) -> Array:
    """Return the largest entry of each block ``M_ij`` (outputs of block i, inputs of block j)."""
    if not M.size:
        return np.zeros((len(blocks), len(blocks)))
    w, z = (np.array([part[side].start for part in block_slices(blocks)]) for side in (0, 1))
    return np.maximum.reduceat(np.maximum.reduceat(np.abs(M), z, axis=0), w, axis=1)


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
        exponents = _osborne(norms[members[:, None], members])
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
    """Return integer exponents per block that balance M as a whole; smaller couplings count as 1e-6."""
    norms = block_norms(M, blocks)
    return _osborne(np.maximum(norms, 1e-6 * max(float(norms.max(initial=0.0)), 1e-300)))


def _osborne(norms: Array) -> Array:
    """Return integer exponents e that balance the norms of row i and column i of ``norms_ij 2^(e_i - e_j)``."""
    n = len(norms)
    if n < 2:
        return np.zeros(n)
    with np.errstate(divide="ignore"):
        log = np.log2(norms)
    np.fill_diagonal(log, -np.inf)
    e = np.zeros(n)
    _compiled_osborne()(log, e, 100, 0.01)
    return np.round(e - np.round(e.mean()))


@cache
def _compiled_osborne() -> Callable[[Array, Array, int, float], None]:
    """Return the compiled Osborne iteration; numba is imported on first use."""
    import numba as nb

    @nb.njit(cache=True, error_model="numpy")
    def osborne(log: Array, e: Array, sweeps: int, tol: float) -> None:
        """Exponents e such that row i and column i of ``2^(log_ij + e_i - e_j)`` have about one norm."""
        n = len(log)
        for _ in range(sweeps):
            largest = 0.0
            for i in range(n):
                top_row, top_column = -np.inf, -np.inf
                for j in range(n):
                    top_row = max(top_row, log[i, j] - e[j])
                    top_column = max(top_column, log[j, i] + e[j])
                row, column = 0.0, 0.0
                for j in range(n):
                    row += 4.0 ** (log[i, j] - e[j] - top_row)
                    column += 4.0 ** (log[j, i] + e[j] - top_column)
                step = 0.5 * (top_column + 0.5 * np.log2(column) - top_row - 0.5 * np.log2(row)) - e[i]
                e[i] += step
                largest = max(largest, abs(step))
            if largest < tol:
                break

    return osborne
