r"""Power iteration for the lower bound of mu, all block kinds, for many matrices and starts at once.

At a fixed point ``beta a = M b``, ``beta w = M^* z`` with ``b = Q a``, ``z = Q^* w`` and Q of the structure and norm
one: then ``I - M Q / beta`` is singular, a is its right null direction and z the left one. It converges nearly always
for complex blocks. With real blocks it may not, and its vectors are good starts for minimum-norm steps all the same.

References
----------
Packard, Fan, Doyle, "A power method for the structured singular value" (1988). Young, Doyle, "Computation of mu with
real and complex uncertainties" (1990).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.delta_layout import DeltaLayout
from robustlab.mu_analysis.minimum_norm import unit_rows

__all__ = ["power_directions"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]


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
        return size_w / _positive(size_a) + 0j, size_a / _positive(size_w) + 0j, q_real
    inner = layout.gains(w, np.conj(a))
    phase = inner / _positive(np.abs(inner))
    q = np.where(layout.full, 1.0, phase)
    if layout.real.any():
        ratio = layout.vector_sizes(b, layout.of_w) / _positive(size_a)
        q_real = np.clip(np.sign(q_real) * ratio + inner.real, -1.0, 1.0)
        q_real = np.where(q_real == 0, 1e-3, q_real)
        q = np.where(layout.real, q_real, q)
    to_z = np.where(layout.full, size_w / _positive(size_a), np.conj(q))
    to_b = np.where(layout.full, size_a / _positive(size_w), q)
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


def _positive(size: Array) -> Array:
    return np.where(size > 0, size, 1.0)
