"""Two descent methods for functions that are smooth almost everywhere, such as norms of loops.

BFGS with a weak Wolfe line search is slow where several peaks have the same height; sequential linear programs with
one function for every peak near the maximum end the descent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray

DECREASE, CURVATURE = 1e-4, 0.5  # weak Wolfe conditions: shares of the predicted decrease and of the slope
LINE_STEPS = 25  # most trials of a line search
STALL_STEPS = 8  # consecutive steps of almost no decrease that end a descent. More: slower, rarely lower
RADIUS, SMALLEST_RADIUS, LARGEST_RADIUS = 3e-2, 1e-8, 0.5  # first, last, largest trust region, relative to parameters
WORTHWHILE = 1e-8  # predicted decrease, as a share of the value, that ends the search. Smaller: more programs for less

# ``function(x, give_up_above)``: value and gradient, which need not be exact where the value is above that level.
Function = Callable[[AnyArray, float], tuple[float, AnyArray | None]]


def bfgs(
    function: Function,
    x: AnyArray,
    *,
    max_steps: int = 500,
    rtol: float = 1e-9,
    stop_below: float = -np.inf,
    late: Callable[[], bool] = lambda: False,
) -> tuple[AnyArray, float] | None:
    """Return the end of a descent from x and its value; None where the function has no finite value at x."""
    value, gradient = function(x, np.inf)
    if gradient is None or not np.isfinite(value) or not np.isfinite(gradient).all():
        return None
    inverse, fresh, stalled, steps = _steepest(gradient, 1.0), True, 0, 0
    while steps < max_steps and value >= stop_below and stalled < STALL_STEPS and not late():
        direction = -inverse @ gradient
        slope = float(gradient @ direction)
        found = _line_search(function, x, value, direction, slope, stop_below, late) if slope < 0 else None
        if found is None:
            if fresh:
                break
            inverse, fresh = _steepest(gradient, 1e-2 * float(np.linalg.norm(direction))), True
            continue
        new, new_value, new_gradient = found
        s, y = new - x, new_gradient - gradient
        inverse, fresh = _updated(inverse, s, y, fresh)
        stalled = stalled + 1 if value - new_value < rtol * abs(value) else 0
        x, value, gradient, steps = new, new_value, new_gradient, steps + 1
    return x, value


def _steepest(gradient: AnyArray, length: float) -> AnyArray:
    return np.eye(len(gradient)) * (length / max(float(np.linalg.norm(gradient)), 1e-300))


def _updated(inverse: AnyArray, s: AnyArray, y: AnyArray, fresh: bool) -> tuple[AnyArray, bool]:
    sy = float(s @ y)
    # y^T y can underflow to zero.
    if not sy > 1e-14 * float(np.linalg.norm(s) * np.linalg.norm(y)) or not y @ y > 0:
        return inverse, fresh
    if fresh:
        inverse = np.eye(len(s)) * (sy / float(y @ y))
    hy = inverse @ y
    scale = (1 + float(y @ hy) / sy) / sy
    cross = np.outer(hy, s) / sy
    return inverse + scale * np.outer(s, s) - cross - cross.T, False


def _line_search(
    function: Function,
    x: AnyArray,
    value: float,
    direction: AnyArray,
    slope: float,
    stop_below: float,
    late: Callable[[], bool],
) -> tuple[AnyArray, float, AnyArray] | None:
    """Return a point that meets the weak Wolfe conditions, or sufficient decrease alone (Lewis, Overton, alg. 2.6)."""
    step, low, high = 1.0, 0.0, np.inf
    best: tuple[AnyArray, float, AnyArray] | None = None
    for _ in range(LINE_STEPS):
        new = x + step * direction
        level = value + DECREASE * step * slope
        new_value, gradient = function(new, level)
        if gradient is None or not new_value <= level or not np.isfinite(gradient).all():
            high = step
        else:
            best = new, new_value, gradient
            if float(gradient @ direction) >= CURVATURE * slope or new_value < stop_below:
                break
            low = step
        step = 0.5 * (low + high) if np.isfinite(high) else 2 * step
        if late() or (np.isfinite(high) and high - low < 1e-14):
            break
    return best


@dataclass(frozen=True)
class Piece:
    """An active function: its value and its gradient with respect to the parameters."""

    value: float
    gradient: AnyArray
    limit: bool = False


def sequential_linear(
    value_of: Callable[[AnyArray], float],
    pieces_of: Callable[[AnyArray, float, float], list[Piece]],
    x: AnyArray,
    low: AnyArray,
    high: AnyArray,
    *,
    max_steps: int = 60,
    late: Callable[[], bool] = lambda: False,
) -> tuple[AnyArray, float]:
    """Return the best point found from x within the bounds, and its value, by linear programs over active pieces."""
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
    pieces: list[Piece], size: AnyArray, radius: float, x: AnyArray, low: AnyArray, high: AnyArray
) -> tuple[AnyArray, float] | None:
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
