"""The scalings D and G that commute with a block structure, as a linear function of real parameters."""

# With U = [I, M^*] the matrix of the D-G inequality is U E(x) U^* with one sparse Hermitian E of order q + p, so that
# gradients and Hessians of its barrier need products of single entries of U^* P U only.

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.uncertainty.blocks import Block, block_slices, structure_size


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
                parameters.append(
                    [(w.start + i, w.start + j, c, 1) for i, j, c in on_w]
                    + [(self.q + z.start + i, self.q + z.start + j, -c, 0) for i, j, c in on_z]
                )
                identity.append(float(all(i == j for i, j, _ in on_w)))
            for pattern in block.g_basis():
                entries = [(w.start + i, self.q + z.start + j, -1j * c, 0) for i, j, c in pattern]
                parameters.append(entries + [(b, a, np.conj(c), 0) for a, b, c, _ in entries])
                identity.append(0.0)
        flat = [entry for parameter in parameters for entry in parameter]
        self.size = len(parameters)
        self.rows = np.array([e[0] for e in flat], dtype=int)
        self.cols = np.array([e[1] for e in flat], dtype=int)
        self.coefficients = np.array([e[2] for e in flat], dtype=complex)
        self.in_w = np.array([e[3] for e in flat], dtype=float)
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


@lru_cache(maxsize=256)
def scaling_space(blocks: tuple[Block, ...]) -> ScalingSpace:
    """Return the cached scaling space of these blocks."""
    return ScalingSpace(blocks)
