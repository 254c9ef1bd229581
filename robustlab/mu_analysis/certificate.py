r"""Proofs of mu bounds, evaluated from the returned evidence alone.

Upper: any D > 0 and G of the structure prove ``mu(M) <= beta`` where

.. math:: N(\beta) = \beta^2 D_w - M^* D_z M - j (G M - M^* G^*) \succeq 0 .

Lower: any Delta of the structure with ``det(I - M Delta) = 0`` proves ``mu(M) >= 1 / ||Delta||``.

References
----------
Fan, Tits, Doyle (1991); Rump, "Verification of positive definiteness", BIT 46 (2006).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.scalings import hermitian
from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, block_slices

__all__ = ["EPS", "certified_level", "delta_norm", "level", "positive_definite", "project", "proves", "singularity"]

ComplexArray = NDArray[np.complexfloating[Any, Any]]
EPS = float(np.finfo(float).eps)

# Relative steps by which a bound is raised until it proves itself.
INFLATIONS = (1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)


def level(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> float:
    """Smallest beta of D and G by floating point, no proof; 0 where N(0) > 0, inf where D is not positive definite."""
    M, Dw, Dz, G = _power_of_two_scaled(M, Dw, Dz, G)
    try:
        factor = np.linalg.cholesky(Dw)
    except np.linalg.LinAlgError:
        return float("inf")
    half = np.linalg.solve(factor, _supply(M, Dz, G))
    scaled = np.linalg.solve(factor, hermitian(half))
    if not np.isfinite(scaled).all():
        return float("inf")
    return float(np.sqrt(max(np.linalg.eigvalsh((scaled + hermitian(scaled)) / 2)[-1], 0.0)))


def proves(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray, beta: float) -> bool:
    """Whether D > 0 and N(beta) >= 0 hold with all rounding errors of this evaluation allowed for.

    The matrices are scaled by powers of two (exact); the rounding error of N is bounded entry by entry, and a Cholesky
    factorisation of N minus that bound has to succeed.
    """
    M, Dw, Dz, G = _power_of_two_scaled(M, Dw, Dz, G)
    if not (np.isfinite(M).all() and np.isfinite(Dz).all() and np.isfinite(G).all() and np.isfinite(beta)):
        return False
    n = beta**2 * Dw - _supply(M, Dz, G)
    size = np.abs(M)
    cross = np.abs(G) @ size
    bound = size.T @ np.abs(Dz) @ size + cross + cross.T + beta**2 * np.abs(Dw)
    gamma = 4 * (sum(M.shape) + 4) * EPS  # complex products of two factors, summed over p and q terms
    error = gamma * float(bound.sum(axis=1).max(initial=0.0))
    return positive_definite(Dw, 0.0) and positive_definite((n + hermitian(n)) / 2, error)


def positive_definite(X: ComplexArray, error: float) -> bool:
    """Whether every Hermitian matrix within ``error`` (2-norm) of X is positive definite, by Rump's criterion."""
    n = len(X)
    if n == 0:
        return True
    diagonal = np.diagonal(X).real
    if not np.isfinite(X).all() or diagonal.min() <= 0:
        return False
    shift = error + 4 * (n + 2) * EPS * float(diagonal.sum())
    try:
        np.linalg.cholesky(X - shift * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


def certified_level(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> float:
    """The level of D and G, raised until `proves` says yes; inf where it never does."""
    if not M.size or not np.any(M):
        return 0.0
    beta = level(M, Dw, Dz, G)
    if not np.isfinite(beta):
        return beta
    if proves(M, Dw, Dz, G, beta):
        return beta
    # The size of M comes in where beta is next to nothing beside it.
    size = float(np.abs(M).max())
    steps = sorted(i * reference for i in INFLATIONS for reference in (beta, EPS * size, size))
    return next((beta + s for s in steps if proves(M, Dw, Dz, G, beta + s)), float("inf"))


def singularity(M: ComplexArray, delta: ComplexArray) -> float:
    """Smallest singular value of ``I - M Delta`` over ``1 + ||M Delta||``; 0 where Delta makes it singular."""
    loop = M @ delta
    if not np.isfinite(loop).all():
        return float("inf")
    values = np.linalg.svd(np.eye(len(loop)) - loop, compute_uv=False)
    return float(values[-1] / (1 + np.linalg.norm(loop, 2)))


def delta_norm(blocks: Sequence[Block], delta: ComplexArray) -> float:
    """Largest singular value of the blocks of Delta (q, p)."""
    largest = 0.0
    for block, (w, z) in _with_slices(blocks):
        full = isinstance(block, FullBlock) and block.rows * block.cols > 1
        size = np.linalg.norm(delta[w, z], 2) if full else abs(delta[w.start, z.start])
        largest = max(largest, float(size))
    return largest


def project(blocks: Sequence[Block], delta: ComplexArray) -> ComplexArray:
    """The Delta of exactly this structure that lies next to the given one."""
    result = np.zeros(delta.shape, dtype=complex)
    for block, (w, z) in _with_slices(blocks):
        part = delta[w, z]
        if not isinstance(block, FullBlock):
            value = np.trace(part) / len(part)
            part = (value.real if isinstance(block, RealScalar) else value) * np.eye(len(part))
        result[w, z] = part
    return result


def _with_slices(blocks: Sequence[Block]) -> list[tuple[Block, tuple[slice, slice]]]:
    return list(zip(blocks, block_slices(blocks), strict=True))


def _supply(M: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> ComplexArray:
    """``M^* D_z M + j (G M - M^* G^*)``."""
    product = G @ M
    value = hermitian(M) @ Dz @ M + 1j * (product - hermitian(product))
    return (value + hermitian(value)) / 2


def _power_of_two_scaled(
    M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """The same inequality with diagonals of D between 1/2 and 2: congruence by powers of two, free of rounding."""
    w, z = (np.exp2(np.round(-0.5 * np.log2(np.maximum(np.diagonal(d).real, 1e-300)))) for d in (Dw, Dz))
    return (
        M * w[None, :] / z[:, None],
        Dw * w[:, None] * w[None, :],
        Dz * z[:, None] * z[None, :],
        G * w[:, None] * z[None, :],
    )
