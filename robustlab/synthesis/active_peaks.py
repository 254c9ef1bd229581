r"""Sequential linear programming on all peaks that are active at once: what ends a nonsmooth descent.

At the optimum of a norm several peaks have the same height and a quasi-Newton method creeps. Here every peak near the
top is a function of its own, all of them are made small together,

.. math:: \min_{d, t}\ t \quad\text{such that}\quad f_i + g_i^T d \le t, \quad |d_j| \le r s_j,

and the step is judged by the true value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Piece", "sequential_linear"]

Array = NDArray[Any]

RADIUS, SMALLEST_RADIUS, LARGEST_RADIUS = 3e-2, 1e-8, 0.5
# Predicted decreases below this share of the value end the search.
WORTHWHILE = 1e-8


@dataclass(frozen=True)
class Piece:
    """A function that is active: its value and its gradient with respect to the parameters.

    A ``limit`` must stay below zero instead of being made small.
    """

    value: float
    gradient: Array
    limit: bool = False


def sequential_linear(
    value_of: Callable[[Array], float],
    pieces_of: Callable[[Array, float, float], list[Piece]],
    x: Array,
    low: Array,
    high: Array,
    *,
    max_steps: int = 60,
    late: Callable[[], bool] = lambda: False,
) -> tuple[Array, float]:
    """The best point found from x within the bounds, and its value.

    Parameters
    ----------
    value_of
        The function; infinite where it has no value.
    pieces_of
        ``(x, value, radius)`` to all pieces that may be active within a step of that radius.
    low, high
        Bounds of the parameters.

    References
    ----------
    Apkarian, Noll, "Nonsmooth H-infinity synthesis" (2006): every active frequency in one tangent program.
    """
    value, radius = value_of(x), RADIUS
    for _ in range(max_steps):
        if late() or radius < SMALLEST_RADIUS or not np.isfinite(value):
            break
        size = np.maximum(np.abs(x), 1e-2 * max(float(np.median(np.abs(x))), 1e-12))
        pieces = pieces_of(x, value, radius)
        step = _step(pieces, size, radius, x, low, high)
        if step is None:
            radius *= 0.5
            continue
        d, predicted = step
        if value - predicted < WORTHWHILE * value:
            break
        new_value = value_of(x + d)
        if new_value < value - 0.02 * (value - predicted):
            if value - new_value > 0.5 * (value - predicted):
                radius = min(2 * radius, LARGEST_RADIUS)
            x, value = x + d, new_value
        else:
            radius *= 0.4
    return x, value


def _step(
    pieces: list[Piece], size: Array, radius: float, x: Array, low: Array, high: Array
) -> tuple[Array, float] | None:
    from scipy.optimize import linprog

    top = max((p.value for p in pieces if not p.limit), default=0.0)
    if not top > 0:
        return None
    n = len(x)
    scales = np.array([1.0 if p.limit else top for p in pieces])
    slopes = np.array([p.gradient * size for p in pieces]) / scales[:, None]
    rows = np.hstack([slopes, np.array([[0.0 if p.limit else -1.0] for p in pieces])])
    heights = np.array([p.value for p in pieces]) / scales
    if not np.isfinite(rows).all():
        return None
    lower, upper = np.maximum(-radius, (low - x) / size), np.minimum(radius, (high - x) / size)
    bounds = [*zip(np.minimum(lower, 0.0), np.maximum(upper, 0.0), strict=True), (None, None)]
    found = linprog(np.append(np.zeros(n), 1.0), A_ub=rows, b_ub=-heights, bounds=bounds, method="highs")
    if found.status != 0:
        return None
    return found.x[:n] * size, float(found.x[n] * top)
