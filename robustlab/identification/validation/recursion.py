"""Linear recursions over many samples in chunks: as many steps in Python as twice the root of their number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["powers", "states"]

Array = NDArray[np.float64]


def powers(A: Array, start: Array, n: int) -> Array:
    """``A^k start`` for k = 0 .. n - 1, shape (n, n_x, columns)."""
    size = max(1, int(np.sqrt(n)))
    inner = [np.eye(len(A))]
    for _ in range(size):
        inner.append(A @ inner[-1])
    leap = inner.pop()
    heads = [start]
    for _ in range(-(-n // size) - 1):
        heads.append(leap @ heads[-1])
    found = np.einsum("kij,hjc->hkic", np.array(inner), np.array(heads))
    return found.reshape(len(heads) * len(inner), *start.shape)[:n]


def states(A: Array, drive: Array, first: Array) -> Array:
    """``x_{t+1} = A x_t + drive_t`` from ``x_0 = first``, shape (n, n_x); the last drive is not used."""
    n, n_x = drive.shape
    if not n_x:
        return np.zeros((n, 0))
    size = max(1, int(np.sqrt(n)))
    count = -(-n // size)
    padded = np.zeros((count * size, n_x))
    padded[:n] = drive
    chunks = padded.reshape(count, size, n_x)
    local = np.zeros((count, size + 1, n_x))
    for k in range(size):
        local[:, k + 1] = local[:, k] @ A.T + chunks[:, k]
    step = [np.eye(n_x)]
    for _ in range(size):
        step.append(A @ step[-1])
    heads = np.empty((count, n_x))
    now = first
    for j in range(count):
        heads[j] = now
        now = step[size] @ now + local[j, size]
    free = np.einsum("kij,hj->hki", np.array(step[:size]), heads)
    return (local[:, :size] + free).reshape(-1, n_x)[:n]
