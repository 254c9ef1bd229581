"""The gain of a perturbed matrix and how it changes with each real parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.box import centre_matrix
from robustlab.uncertainty.blocks import Block, RealScalar, block_slices

__all__ = ["gain_and_slope"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]


def gain_and_slope(M: ComplexArray, blocks: Sequence[Block], values: Array) -> tuple[float, Array]:
    r"""Gain ``sigma_max`` of the last block's channels with the others closed by real values, and its derivatives.

    .. math:: F = M_{22} + M_{21} \Delta (I - M_{11} \Delta)^{-1} M_{12}, \qquad
              \partial \sigma = \Re\, u^* M_{21} (I - \Delta M_{11})^{-1} \, \partial\Delta \,
              (I - M_{11}\Delta)^{-1} M_{12} v

    Parameters
    ----------
    M
        Matrix (p, q) with the channels of all blocks, those of the performance last.
    values
        Entries of Delta for each block, real ones; the last is not used.
    """
    delta = centre_matrix(blocks, values)
    w, z = block_slices(blocks)[-1]
    q, p = w.start, z.start
    d = delta[:q, :p]
    try:
        inside = np.linalg.solve(np.eye(p) - M[:p, :q] @ d, M[:p, q:])
        outside = np.linalg.solve((np.eye(q) - d @ M[:p, :q]).T, M[p:, :q].T).T
    except np.linalg.LinAlgError:
        return float("inf"), np.zeros(len(blocks))
    u, sigma, vh = np.linalg.svd(M[p:, q:] + outside @ d @ M[:p, q:])
    left, right = np.conj(u[:, 0]) @ outside, inside @ np.conj(vh[0])
    slope = [(left[sw] * right[sz]).sum().real for sw, sz in block_slices(blocks)[:-1]]
    real = [isinstance(b, RealScalar) for b in blocks[:-1]]
    return float(sigma[0]), np.append(np.where(real, slope, 0.0), 0.0)
