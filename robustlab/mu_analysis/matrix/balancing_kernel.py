# pyright: reportMissingParameterType=false
"""Osborne's iteration, compiled. Importing this module imports numba."""

from __future__ import annotations

import numba as nb
import numpy as np


@nb.njit(cache=True, error_model="numpy")
def osborne(log, sweeps, tol):
    """Exponents e such that row i and column i of ``2^(log_ij + e_i - e_j)`` have about the same norm.

    The norms come as logarithms to base 2 (-inf on the diagonal): their squares span more decades than floating point
    does.
    """
    n = len(log)
    e = np.zeros(n)
    for _ in range(sweeps):
        largest = 0.0
        for i in range(n):
            top_row, top_column = -np.inf, -np.inf
            for j in range(n):
                top_row = max(top_row, log[i, j] - e[j])
                top_column = max(top_column, log[j, i] + e[j])
            row, column = 0.0, 0.0
            for j in range(n):
                row += 4.0 ** (log[i, j] - e[j] - top_row)
                column += 4.0 ** (log[j, i] + e[j] - top_column)
            step = 0.5 * (top_column + 0.5 * np.log2(column) - top_row - 0.5 * np.log2(row)) - e[i]
            e[i] += step
            largest = max(largest, abs(step))
        if largest < tol:
            break
    return e
