r"""How much the margin changes with the size of each block, from the critical Delta alone.

Let block i be ``s_i`` times as large. At the smallest singular Delta, the parts
:math:`c_i = y^* M_i \Delta_i x / y^* x` of the linearised loop add up to one, and a multiplier phi makes every
:math:`\mathrm{Re}(\varphi c_i)` of a block at its bound positive and that of a block inside it zero. By the envelope
theorem

.. math:: \frac{\partial \log m}{\partial \log s_i}
    = - \frac{\mathrm{Re}(\varphi c_i)}{\sum_j \mathrm{Re}(\varphi c_j)} .

On the frequency axis the critical frequency moves along; there :math:`c_i` is the part of the pole's derivative, and
``phi = 1``: only the real part of the pole counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.mu_analysis.certificate import delta_norm
from robustlab.mu_analysis.delta_layout import delta_layout
from robustlab.mu_analysis.minimum_norm import dual_minimum
from robustlab.mu_analysis.pole_migration import perturbed_state_matrix
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

__all__ = ["block_sensitivities", "pole_block_sensitivities"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]


def block_sensitivities(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> Array:
    """Derivative of ``1 / mu(M)`` by the relative size of each block, shape (n_blocks,); none is positive.

    Their sum is minus the margin. Assumes that Delta is a strict local minimum with a simple null direction.

    Parameters
    ----------
    M
        Matrix (p, q).
    delta
        The critical Delta (q, p): ``I - M Delta`` is singular, and no Delta next to it that is smaller makes it so.

    Raises
    ------
    NoTrustworthyNumber
        The null direction is not simple: the margin has no derivative.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = np.array([[1.0, 3.0], [1.0, 3.0]], dtype=complex)
    >>> block_sensitivities(M, [RealScalar("a"), RealScalar("b")], np.eye(2) / 4 + 0j).round(9).tolist()
    [-0.0625, -0.1875]
    """
    layout = delta_layout(blocks)
    M, delta = np.asarray(M, dtype=complex), np.asarray(delta, dtype=complex)
    u, _, vh = np.linalg.svd(np.eye(len(M)) - M @ delta)
    x, y = np.conj(vh[-1:]), u[None, :, -1]
    row = (np.conj(y) @ M) / _simple(complex((np.conj(y) * x).sum()), "block_sensitivities")
    gains = layout.gains(row, x)
    re, im = gains.real[:, layout.real], gains.imag[:, layout.real]
    total = np.abs(gains[:, ~layout.real]).sum(axis=1)
    alpha = dual_minimum(re, im, total)[0] if layout.real.any() else np.zeros(1)
    parts = layout.contributions(delta[None], row, x)[0]
    if not layout.real.any():
        return _shared(np.abs(parts), delta_norm(blocks, delta))
    return _shared((parts * (1 - 1j * alpha)).real, delta_norm(blocks, delta))


def pole_block_sensitivities(
    model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray, pole: complex
) -> Array:
    """Derivative of a model's stability margin by the relative size of each block, shape (n_blocks,).

    Parameters
    ----------
    model
        Continuous model with the Delta channels (p outputs, q inputs).
    delta
        The critical Delta (q, p).
    pole
        The pole that it brings to the axis.

    Raises
    ------
    NoTrustworthyNumber
        The pole is not simple: the margin has no derivative.
    """
    layout = delta_layout(blocks)
    delta = np.asarray(delta, dtype=complex)
    a = perturbed_state_matrix(model, delta)
    values, right = np.linalg.eig(a)
    v = right[:, np.abs(values - pole).argmin()]
    values, left = np.linalg.eig(a.T)
    u = left[:, np.abs(values - pole).argmin()]
    inner = _simple(complex(u @ v), "pole_block_sensitivities")
    loop = np.eye(model.n_outputs) - model.D @ delta
    back = np.eye(model.n_inputs) - delta @ model.D
    x = np.linalg.solve(loop, model.C @ v)
    row = np.linalg.solve(back.T, u @ model.B) / inner
    return _shared(layout.contributions(delta[None], row[None], x[None])[0].real, delta_norm(blocks, delta))


def _simple(inner: complex, where: str) -> complex:
    if abs(inner) < 1e-10:
        raise NoTrustworthyNumber(
            where, "left and right null directions are orthogonal", "a simple pole or null direction"
        )
    return inner


def _shared(parts: Array, margin: float) -> Array:
    """The margin's derivatives from the parts that count."""
    return -margin * parts / parts.sum()
