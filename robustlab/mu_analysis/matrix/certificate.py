"""Proofs of mu bounds, evaluated from the returned evidence alone.

Fan, Tits, Doyle (1991); Rump, "Verification of positive definiteness", BIT 46 (2006).
"""

# Upper: any D > 0 and G of the structure prove mu(M) <= beta where beta^2 D_w - M^* D_z M - j (G M - M^* G^*) >= 0; a
# bound of all rounding errors is included. Lower: any Delta of the structure with det(I - M Delta) = 0.

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.mu_analysis.matrix.structure import hermitian, relative, supply
from robustlab.uncertainty.blocks import Block, block_slices

EPS = float(np.finfo(float).eps)
SINGULAR = 1e-11  # relative smallest singular value below which I - M Delta counts as singular


def proves(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray, beta: float) -> bool:
    """Return whether D > 0 and N(beta) >= 0 hold for all rounding errors of this evaluation."""
    # Scaling by powers of two is exact; the rounding error of N is bounded entry by entry, and a Cholesky
    # factorisation of N minus that bound has to succeed.
    inequality = _Inequality(M[None], Dw[None], Dz[None], G[None])
    return bool(inequality.proves(np.array([beta]) / inequality.unit, np.array([0]))[0])


def certified_level(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> float:
    """Return the level of D and G, raised until `proves` holds; inf where it never does."""
    return float(certified_levels(M[None], Dw[None], Dz[None], G[None])[0])


def certified_levels(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> Array:
    """Return `certified_level` of each matrix of a stack, shape (k,)."""
    if not M.size:
        return np.zeros(len(M))
    inequality = _Inequality(M, Dw, Dz, G)
    squares = inequality.squares()
    raised = inequality.allowance(np.sqrt(np.maximum(squares, 0.0)))
    zero = ~M.any(axis=(1, 2))
    result = np.where(zero, 0.0, np.inf)
    # beta^2 is raised by the allowance for rounding errors, then in steps of a factor of four.
    todo = np.flatnonzero(~zero & np.isfinite(squares) & np.isfinite(raised))
    for _ in range(40):
        if not len(todo):
            break
        beta = np.sqrt(np.maximum(squares[todo] + raised[todo], 0.0))
        proved = inequality.proves(beta, todo)
        result[todo[proved]] = beta[proved] * inequality.unit[todo[proved]]
        todo = todo[~proved]
        raised[todo] *= 4
    return result


class _Inequality:
    """``N(beta) = beta^2 D_w - supply`` of a stack, with the bounds of its rounding errors."""

    def __init__(self, M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            # D's diagonals are scaled to 1/2 .. 2 by a congruence with powers of two, free of rounding.
            w, z = (
                np.exp2(np.round(-0.5 * np.log2(np.maximum(np.einsum("kii->ki", d).real, 1e-300)))) for d in (Dw, Dz)
            )
            M, G = M * w[:, None, :] / z[:, :, None], G * w[:, :, None] * z[:, None, :]
            Dw, Dz = Dw * w[:, :, None] * w[:, None, :], Dz * z[:, :, None] * z[:, None, :]
            largest = np.abs(M).max(axis=(1, 2), initial=0.0)
            usual = (largest > 0) & np.isfinite(largest)
            self.unit = np.exp2(np.rint(np.log2(np.where(usual, largest, 1.0))))
            M, G = M / self.unit[:, None, None], G / self.unit[:, None, None]
            value, size = supply(M, Dz, G), np.abs(M)
            cross = np.abs(G) @ size
            bound = np.swapaxes(size, 1, 2) @ np.abs(Dz) @ size + cross + np.swapaxes(cross, 1, 2)
        self.supply, self.Dw = (value + hermitian(value)) / 2, Dw
        # Complex products of two factors, summed over p and q terms.
        self.gamma = 4 * (sum(M.shape[1:]) + 4) * EPS
        self.bound, self.d_bound = bound.sum(axis=2), np.abs(Dw).sum(axis=2)
        sums = self.supply.sum(axis=(1, 2)) + Dz.sum(axis=(1, 2)) + self.bound.sum(axis=1) + self.d_bound.sum(axis=1)
        self.finite = np.isfinite(sums)
        self.supply[~self.finite] = self.Dw[~self.finite] = np.eye(self.Dw.shape[1])

    def squares(self) -> Array:
        """Return the smallest t of ``t D_w - supply >= 0``; inf where D is not positive definite."""
        result = np.full(len(self.Dw), np.inf)
        good = np.flatnonzero(self.finite & _positive_definite(self.Dw, np.zeros(len(self.Dw))))
        if len(good):
            result[good] = np.linalg.eigvalsh(relative(self.Dw[good], self.supply[good]))[:, -1]
        return result

    def error(self, beta: Array, which: Any = slice(None)) -> Array:
        """Bound the rounding error of N(beta) in the 2-norm."""
        rows = self.bound[which] + beta[:, None] ** 2 * self.d_bound[which]
        return self.gamma * rows.max(axis=1, initial=0.0)

    def allowance(self, beta: Array) -> Array:
        """Estimate the increase of beta^2 above its level that a proof needs."""
        smallest = np.linalg.eigvalsh(self.Dw)[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):  # NaN proves nothing
            traces = np.einsum("kii->k", beta[:, None, None] ** 2 * self.Dw - self.supply).real
            needed = self.error(beta) + 4 * (self.Dw.shape[1] + 2) * EPS * np.maximum(traces, 0.0)
            return 2 * needed / np.where(smallest > 0, smallest, np.nan) + 1e-300

    def proves(self, beta: Array, which: Indices) -> Mask:
        """Return whether D > 0 and N(beta) >= 0 hold for all rounding errors, for each of these matrices."""
        sure = self.finite[which] & np.isfinite(beta)
        beta = np.where(sure, beta, 0.0)
        n = beta[:, None, None] ** 2 * self.Dw[which] - self.supply[which]
        sure &= _positive_definite(n, self.error(beta, which))
        return sure & _positive_definite(self.Dw[which], np.zeros(len(beta)))


def _positive_definite(X: ComplexArray, error: Array) -> Mask:
    n = X.shape[1]
    if n == 0:
        return np.ones(len(X), dtype=bool)
    diagonal = np.einsum("kii->ki", X).real
    finite = np.isfinite(X).all(axis=(1, 2)) & np.isfinite(error)
    result = finite & (diagonal.min(axis=1) > 0)
    shift = error + 4 * (n + 2) * EPS * diagonal.sum(axis=1)
    shifted = X[result] - shift[result][:, None, None] * np.eye(n)
    result[result] = _factorises(shifted)
    return result


def _factorises(X: ComplexArray) -> Mask:
    """Return whether the Cholesky factorisation succeeds, for each matrix of the stack."""
    try:
        np.linalg.cholesky(X)
    except np.linalg.LinAlgError:
        if len(X) == 1:
            return np.array([False])
        return np.concatenate([_factorises(X[i : i + 1]) for i in range(len(X))])
    return np.ones(len(X), dtype=bool)


def singularity(M: ComplexArray, delta: ComplexArray) -> float:
    """Return the smallest singular value of ``I - M Delta`` over ``1 + ||M Delta||``."""
    loop = M @ delta
    if not np.isfinite(loop).all():
        return float("inf")
    values = np.linalg.svd(np.eye(len(loop)) - loop, compute_uv=False)
    return float(values[-1] / (1 + np.linalg.norm(loop, 2)))


def delta_norm(blocks: Sequence[Block], delta: ComplexArray) -> float:
    """Return the largest singular value of the blocks of Delta (q, p)."""
    return max(
        (block.norm(delta[w, z]) for block, (w, z) in zip(blocks, block_slices(blocks), strict=True)), default=0.0
    )


def project(blocks: Sequence[Block], delta: ComplexArray) -> ComplexArray:
    """Return the nearest Delta of exactly this structure."""
    result = np.zeros(delta.shape, dtype=complex)
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        result[w, z] = block.project(delta[w, z])
    return result
