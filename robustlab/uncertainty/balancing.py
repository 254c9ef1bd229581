"""Balancing of square matrices by powers of two, so that the units of channels do not decide what counts as small."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["balanced", "balancing_scale"]

PASSES = 20
# Without a cycle there is no bound on how small a matrix may be scaled: this far, not further.
LARGEST_EXPONENT = 200.0


def balancing_scale(matrix: ArrayLike) -> NDArray[np.float64]:
    r"""Diagonal t of powers of two for which :math:`T^{-1} M T` has rows and columns of like size; shape (n,).

    Examples
    --------
    >>> balancing_scale([[1.0, 1024.0], [1.0 / 1024.0, 1.0]]).tolist()
    [1024.0, 1.0]
    """
    with np.errstate(divide="ignore"):
        level = np.log2(np.abs(np.asarray(matrix)))
    np.fill_diagonal(level, -np.inf)
    exponent = np.zeros(len(level))
    for _ in range(PASSES):
        for k in range(len(exponent)):
            row = (level[k] - exponent[k] + exponent).max(initial=-np.inf)
            col = (level[:, k] - exponent + exponent[k]).max(initial=-np.inf)
            if np.isfinite([row, col]).all():
                exponent[k] += 0.5 * (row - col)
        exponent = np.clip(exponent, -LARGEST_EXPONENT, LARGEST_EXPONENT)
    return np.exp2(np.rint(exponent))


def balanced(matrix: ArrayLike) -> NDArray[Any]:
    """``T^-1 M T`` with the scale of `balancing_scale`."""
    scale = balancing_scale(matrix)
    return np.asarray(matrix) / scale[:, None] * scale
