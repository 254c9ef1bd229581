"""Starts of the lower bound: power iteration for all kinds of blocks, and gain ascent for real ones."""

# Power iteration (Packard, Fan, Doyle 1988; Young, Doyle 1990): at a fixed point beta a = M b, beta w = M^* z with b =
# Q a, z = Q^* w and Q of the structure and norm one, I - M Q / beta is singular, a is its right null direction and z
# its left one. It converges nearly always for complex blocks; with real ones its vectors are good starts all the same.
# Gain ascent (Seiler, Packard, Balas, Automatica 46, 2010): the gain of M (I - Delta M)^-1 as a function of one real
# delta_i peaks at the real number next to the pole delta_i + 1 / g_i with g_i = (M (I - Delta M)^-1)_ii; going round
# all i climbs to a box point next to singularity. (A search over the vertices of real M raised no median on 2 to 24
# blocks.)

from __future__ import annotations

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.mu_analysis.matrix.delta_layout import DeltaLayout, positive
from robustlab.mu_analysis.matrix.minimum_norm import unit_rows

SWEEPS = 2  # of coordinate ascent over the real blocks


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
