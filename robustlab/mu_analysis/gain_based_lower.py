r"""Starts for real blocks: coordinate ascent of the gain of the loop over a box, and a vertex search for real M.

For fixed real delta of size r the gain of :math:`M (I - \Delta M)^{-1}` is the larger the closer the loop is to
singularity. As a function of one delta_i it peaks at the real number next to the pole ``delta_i + 1 / g_i`` with
:math:`g_i = (M (I - \Delta M)^{-1})_{ii}`; going round all i, with the complex part held by a small share of its bound,
climbs to a box point from which minimum-norm steps are started.

Where M and Delta are real and no block is repeated, ``det(I - M Delta)`` is affine in each delta_i: the smallest
singular Delta lies at a vertex of a cube, and is sought by flipping one or two signs at a time.

References
----------
Seiler, Packard, Balas, "A gain-based lower bound algorithm for real and mixed mu problems", Automatica 46 (2010).
Dailey, "A new algorithm for the real structured singular value", ACC (1990).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.delta_layout import DeltaLayout

__all__ = ["gain_ascent", "vertex_rays", "vertex_search"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

SWEEPS = 2
# Vertices of so many real parameters are all tried.
EXHAUSTIVE = 7


def gain_ascent(
    M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, radius: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Directions x and y (k, p) of the smallest singular value of ``I - M Delta`` after ascent from Delta (k, q, p).

    Only real blocks move, inside [-radius, radius] (k,).
    """
    for _ in range(SWEEPS):
        for i in np.flatnonzero(layout.real):
            w, z = np.flatnonzero(layout.of_w == i), np.flatnonzero(layout.of_z == i)
            now = delta[:, w[0], z[0]].real
            loop = np.eye(M.shape[1]) - M @ delta
            try:
                part = np.linalg.solve(loop, M[:, :, w])[:, z]
            except np.linalg.LinAlgError:
                continue
            move = _towards_pole(part)
            value = np.clip(now + move, -radius, radius)
            delta[:, w, z] = value[:, None]
    u, _, vh = np.linalg.svd(np.eye(M.shape[1]) - M @ delta)
    return np.conj(vh[:, -1]), u[:, :, -1]


def _towards_pole(g: ComplexArray) -> Array:
    """Real step to the pole nearest to the real axis, of ``(I - step g)^-1`` for g (k, m, m)."""
    poles = g[:, :, 0] if g.shape[1] == 1 else np.linalg.eigvals(g)
    poles = 1 / np.where(np.abs(poles) > 1e-12, poles, 1e-12)
    # The one whose imaginary part is the smallest share of it.
    best = (np.abs(poles.imag) / np.abs(poles)).argmin(axis=1)
    return poles.real[np.arange(len(poles)), best]


def vertex_search(M: Array, signs: Array, rounds: int = 40) -> list[tuple[float, Array]]:
    """``(size, signs)`` of vertices with ``det(I - size M diag(signs)) = 0`` for real M (n, n); signs (k, n) start.

    The determinant at one size is driven down by the flip of one or two signs that lowers it most; where a flip makes
    it negative, a smaller singular vertex has been passed, and the size shrinks to it.
    """
    n = len(M)
    if n <= EXHAUSTIVE:
        bits = (np.arange(2 ** (n - 1))[:, None] >> np.arange(n)) & 1
        return vertex_rays(M, 1.0 - 2.0 * bits)
    found = vertex_rays(M, signs)
    pairs = np.triu_indices(n, 1)
    for _ in range(rounds):
        if not found:
            return found
        size = found[0][0] * (1 - 1e-9)
        passed = _descent(M, signs, size, pairs)
        if passed is None:
            break
        signs = np.concatenate([passed[None], signs[1:]])
        better = vertex_rays(M, passed[None])
        if not better or better[0][0] >= found[0][0] * (1 - 1e-12):
            break
        found = better + found
    return found


def _descent(M: Array, signs: Array, size: float, pairs: tuple[Any, Any]) -> Array | None:
    """Signs at which ``det(I - size M diag(signs))`` is not positive, from the starts (k, n); None where none came."""
    n, k = len(M), len(signs)
    signs = signs.copy()
    going = np.arange(k)
    for _ in range(3 * n):
        loops = np.eye(n) - size * M * signs[going, None, :]
        try:
            g = np.linalg.solve(loops, np.broadcast_to(M, loops.shape))
        except np.linalg.LinAlgError:
            return None
        # A flip of sign i adds -2 size s_i to delta_i: the determinant is multiplied by 1 + 2 size s_i g_ii.
        factor = 2 * size * signs[going]
        diagonal = np.diagonal(g, axis1=1, axis2=2)
        one = 1 + factor * diagonal
        i, j = pairs
        cross = factor[:, i] * factor[:, j] * g[:, i, j] * g[:, j, i]
        ratios = np.concatenate([one, one[:, i] * one[:, j] - cross], axis=1)
        best = ratios.argmin(axis=1)
        least = ratios[np.arange(len(going)), best]
        for row, (path, flip) in enumerate(zip(going, best, strict=True)):
            if least[row] < 1 - 1e-9:
                flipped = [flip] if flip < n else [i[flip - n], j[flip - n]]
                signs[path, flipped] *= -1
        crossed = np.flatnonzero(least <= 0)
        if len(crossed):
            return signs[going[crossed[0]]]
        going = going[least < 1 - 1e-9]
        if not len(going):
            return None
    return None


def vertex_rays(M: Array, signs: Array) -> list[tuple[float, Array]]:
    """The vertex ray among ``signs`` (k, n), either way along it, with the largest real eigenvalue of M diag(signs)."""
    values = np.linalg.eigvals(M * signs[:, None, :])
    real = np.where(np.abs(values.imag) <= 1e-9 * np.abs(values), values.real, 0.0)
    k, j = np.unravel_index(np.abs(real).argmax(), real.shape)
    if real[k, j] == 0:
        return []
    return [(float(1 / np.abs(real[k, j])), signs[k] * np.sign(real[k, j]))]
