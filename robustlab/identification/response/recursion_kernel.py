# pyright: reportMissingParameterType=false
"""Compiled recursive least squares by Givens rotations: each row is predicted from those before it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

_1, _2 = (types.Array(types.float64, k, "C") for k in (1, 2))


@njit(types.void(_2, _2, _1), cache=True)
def predict(rows, values, floor):
    """Turn the values (n, m) of rows (n, n_x) into their recursive residuals, in place; rows are overwritten."""
    # Entries of a row below ``floor`` (n_x,) are ignored. A row that fixes a free direction gives NaN.
    n, n_x = rows.shape
    m = values.shape[1]
    root, right = np.zeros((n_x, n_x)), np.zeros((n_x, m))
    for k in range(n):
        row, value = rows[k], values[k]
        for i in range(n_x):
            if abs(row[i]) <= floor[i]:
                continue
            if root[i, i] == 0.0:
                root[i, i:], right[i] = row[i:], value
                value[:] = np.nan
                break
            norm = math.hypot(root[i, i], row[i])
            c, s = abs(root[i, i]) / norm, math.copysign(row[i] / norm, root[i, i] * row[i])
            for j in range(i, n_x):
                root[i, j], row[j] = c * root[i, j] + s * row[j], c * row[j] - s * root[i, j]
            for j in range(m):
                right[i, j], value[j] = c * right[i, j] + s * value[j], c * value[j] - s * right[i, j]
