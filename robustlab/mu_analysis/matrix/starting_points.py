r"""Starts of the lower bound: power iteration, gain ascent for real blocks, and a vertex search for real M.

Power iteration, for all kinds of blocks: at a fixed point ``beta a = M b``, ``beta w = M^* z`` with ``b = Q a``, ``z =
Q^* w`` and Q of the structure and norm one, ``I - M Q / beta`` is singular, a is its right null direction and z its
left one. It converges nearly always for complex blocks. With real blocks it may not, and its vectors are good starts
for minimum-norm steps all the same.

Gain ascent: for fixed real delta of size r the gain of :math:`M (I - \Delta M)^{-1}` is the larger the closer the loop
is to singularity. As a function of one delta_i it peaks at the real number next to the pole ``delta_i + 1 / g_i`` with
:math:`g_i = (M (I - \Delta M)^{-1})_{ii}`; going round all i, with the complex part held by a small share of its bound,
climbs to a box point from which minimum-norm steps are started.

Vertex search: where M and Delta are real and no block is repeated, ``det(I - M Delta)`` is affine in each delta_i: the
smallest singular Delta lies at a vertex of a cube, and is sought by flipping one or two signs at a time.

References
----------
Seiler, Packard, Balas, "A gain-based lower bound algorithm for real and mixed mu problems", Automatica 46 (2010).
Dailey, "A new algorithm for the real structured singular value", ACC (1990).
Packard, Fan, Doyle, "A power method for the structured singular value" (1988). Young, Doyle, "Computation of mu with
real and complex uncertainties" (1990).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.mu_analysis.matrix.delta_layout import DeltaLayout, positive
from robustlab.mu_analysis.matrix.minimum_norm import unit_rows

SWEEPS = 2  # of coordinate ascent over the real blocks
EXHAUSTIVE = 7  # vertices of so many real parameters are all tried; one more doubles them


def power_directions(
    M: ComplexArray, layout: DeltaLayout, b: ComplexArray, w: ComplexArray, steps: int
) -> tuple[ComplexArray, ComplexArray]:
    """Null directions x = a and y = z, each (k, p), after some steps from b and w, each (k, q); M is (k, p, q)."""
    back = np.conj(np.swapaxes(M, 1, 2))
    b, w = unit_rows(b), unit_rows(w)
    q_real = np.ones((len(M), layout.n))
    a = unit_rows((M @ b[..., None])[..., 0])
    z = np.zeros_like(a)
    for _ in range(steps):
        q_w, q_z, q_real = _alignment(layout, a, w, b, q_real)
        z = _onto_z(layout, q_w, w, a)
        w = unit_rows((back @ z[..., None])[..., 0], w)
        q_w, q_z, q_real = _alignment(layout, a, w, b, q_real)
        b = unit_rows(_onto_w(layout, q_z, a, w), b)
        a = unit_rows((M @ b[..., None])[..., 0], a)
    return a, z


def _alignment(
    layout: DeltaLayout, a: ComplexArray, w: ComplexArray, b: ComplexArray, q_real: Array
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Factors of ``z_i`` from ``w_i`` and of ``b_i`` from ``a_i``, per block (k, n_blocks), and the real q_i."""
    size_a, size_w = layout.vector_sizes(a, layout.of_z), layout.vector_sizes(w, layout.of_w)
    if layout.full.all():
        return size_w / positive(size_a) + 0j, size_a / positive(size_w) + 0j, q_real
    inner = layout.gains(w, np.conj(a))
    phase = inner / positive(np.abs(inner))
    q = np.where(layout.full, 1.0, phase)
    if layout.real.any():
        ratio = layout.vector_sizes(b, layout.of_w) / positive(size_a)
        q_real = np.clip(np.sign(q_real) * ratio + inner.real, -1.0, 1.0)
        q_real = np.where(q_real == 0, 1e-3, q_real)
        q = np.where(layout.real, q_real, q)
    to_z = np.where(layout.full, size_w / positive(size_a), np.conj(q))
    to_b = np.where(layout.full, size_a / positive(size_w), q)
    return to_z, to_b, q_real


def _onto_z(layout: DeltaLayout, factors: ComplexArray, w: ComplexArray, a: ComplexArray) -> ComplexArray:
    """``z_i = q_i^* w_i`` for scalar blocks, along ``a_i`` with the size of ``w_i`` for full ones."""
    if layout.diagonal:
        return factors[:, layout.of_w] * w
    z = factors[:, layout.of_z] * a
    scalar_w, scalar_z = ~layout.full[layout.of_w], ~layout.full[layout.of_z]
    z[:, scalar_z] = factors[:, layout.of_w[scalar_w]] * w[:, scalar_w]
    return z


def _onto_w(layout: DeltaLayout, factors: ComplexArray, a: ComplexArray, w: ComplexArray) -> ComplexArray:
    """``b_i = q_i a_i`` for scalar blocks, along ``w_i`` with the size of ``a_i`` for full ones."""
    if layout.diagonal:
        return factors[:, layout.of_w] * a
    b = factors[:, layout.of_w] * w
    scalar_w, scalar_z = ~layout.full[layout.of_w], ~layout.full[layout.of_z]
    b[:, scalar_w] = factors[:, layout.of_z[scalar_z]] * a[:, scalar_z]
    return b


def gain_ascent(
    M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, radius: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Directions x and y (k, p) of the smallest singular value of ``I - M Delta`` after ascent from Delta (k, q, p)."""
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
    """``(size, signs)`` of vertices with ``det(I - size M diag(signs)) = 0`` for real M (n, n); signs (k, n) start."""
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
