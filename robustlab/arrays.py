"""Types of arrays in signatures; entries that are not finite, and singular matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]  # real, double precision
ComplexArray = NDArray[np.complexfloating[Any, Any]]
AnyArray = NDArray[Any]  # real or complex
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def not_finite(array: Array, entries: str = "entries") -> tuple[str, str] | None:
    """Return the index of the first entry that is NaN or infinite, and a text; None if all are finite."""
    finite = np.isfinite(array)
    if finite.all():
        return None
    bad = np.argwhere(~finite)
    word = "NaN" if np.isnan(array[tuple(bad[0])]) else "infinite"
    return ",".join(map(str, bad[0])), f"is {word} ({len(bad)} of {array.size} {entries})"


def is_rank_deficient(matrix: Array) -> bool:
    """Return whether a square matrix is singular after scaling rows and columns to one size."""
    scaled = matrix.copy()
    for axis in (1, 0, 1):
        size = np.abs(scaled).max(axis=axis, keepdims=True)
        if not size.all():
            return True
        scaled = scaled / size
    return not np.linalg.cond(scaled) <= 1e12
