r"""How much each block's size decides the stability margin.

At the critical Delta a pole lies on the axis. With ``row_i``, ``x_i`` the parts of its left and right directions in
the channels of block i, scaling block i by ``1 + e`` moves the pole by ``e row_i Delta_i x_i``; along the axis it may
move freely. To first order the margin k then changes as

.. math:: \frac{d \ln k}{d \ln s_i} = -\frac{\Re(row_i \Delta_i x_i)}{\sum_j \Re(row_j \Delta_j x_j)}

References
----------
Packard, Pandey, "Continuity properties of the real/complex structured singular value", IEEE TAC 38 (1993), for where
such derivatives exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.pole_migration import perturbed_state_matrix
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

__all__ = ["margin_shares"]

ComplexArray = NDArray[np.complexfloating[Any, Any]]


def margin_shares(
    model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray, pole: complex
) -> dict[str, float]:
    """Share of each block in the margin, summing to one: with 1 % less range of block i it grows by share_i percent.

    Parameters
    ----------
    model
        Delta channels (p, q) of a continuous model.
    delta
        The critical Delta (q, p).
    pole
        The pole that it brings to the axis.

    Returns
    -------
    dict
        One number a block; empty where the pole is not simple, or at infinity (an ill-posed loop).
    """
    matrix = perturbed_state_matrix(model, delta)
    if not np.isfinite(pole) or not model.n_states or not np.isfinite(matrix).all():
        return {}
    poles, right = np.linalg.eig(matrix)
    k = int(np.argmin(np.abs(poles - pole)))
    try:
        left = np.linalg.solve(right.T, np.eye(len(poles))[k])
        x = np.linalg.solve(np.eye(model.n_outputs) - model.D @ delta, model.C @ right[:, k])
        row = np.linalg.solve((np.eye(model.n_inputs) - delta @ model.D).T, model.B.T @ left)
    except np.linalg.LinAlgError:
        return {}
    moves = np.array([(row[w] @ delta[w, z] @ x[z]).real for w, z in block_slices(blocks)])
    total = float(moves.sum())
    if not np.isfinite(moves).all() or abs(total) <= 1e-9 * np.abs(moves).sum():
        return {}
    return {b.name: float(move / total) for b, move in zip(blocks, moves, strict=True)}
