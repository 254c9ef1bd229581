"""Types of arrays in signatures, one set for the whole house; entries that are not finite, and singular matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]  # real, double precision throughout
ComplexArray = NDArray[np.complexfloating[Any, Any]]
AnyArray = NDArray[Any]  # real or complex, as the model or the matrix is
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def not_finite(array: Array, entries: str = "entries") -> tuple[str, str] | None:
    """Index of the first entry that is NaN or infinite, and the words for it; None where all are finite."""
    finite = np.isfinite(array)
    if finite.all():
        return None
    bad = np.argwhere(~finite)
    word = "NaN" if np.isnan(array[tuple(bad[0])]) else "infinite"
    return ",".join(map(str, bad[0])), f"is {word} ({len(bad)} of {array.size} {entries})"


def is_rank_deficient(matrix: Array) -> bool:
    """Whether a square matrix is singular, its rows and columns brought to one size first."""
    scaled = matrix.copy()
    for axis in (1, 0, 1):
        size = np.abs(scaled).max(axis=axis, keepdims=True)
        if not size.all():
            return True
        scaled = scaled / size
    return not np.linalg.cond(scaled) <= 1e12
