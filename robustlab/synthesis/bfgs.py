"""BFGS with a weak Wolfe line search: a descent method for functions that are smooth almost everywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Descent", "Function", "bfgs"]

Array = NDArray[Any]
# ``function(x, give_up_above)``: value and gradient; where the value is above that level neither need be exact.
Function = Callable[[Array, float], tuple[float, Array | None]]

DECREASE, CURVATURE = 1e-4, 0.5
LINE_STEPS = 25
# Steps with a smaller relative decrease than this count as standing still.
STALL_STEPS = 8


@dataclass(frozen=True)
class Descent:
    """Where a descent ended: point, value, gradient there, steps, values on the way, inverse Hessian to go on with."""

    x: Array
    value: float
    gradient: Array
    steps: int
    values: tuple[float, ...]
    inverse: Array


def bfgs(
    function: Function,
    x: Array,
    *,
    max_steps: int = 500,
    rtol: float = 1e-9,
    stop_below: float = -np.inf,
    inverse: Array | None = None,
    late: Callable[[], bool] = lambda: False,
) -> Descent | None:
    """Descent from x; None where the function has no finite value there.

    The weak Wolfe conditions are met by bisection and expansion, without a gradient at points of too high a value. The
    inverse Hessian starts anew where a direction fails; the descent ends where the steepest one fails too, after
    `STALL_STEPS` steps that gain less than ``rtol``, below ``stop_below``, or when ``late``. An earlier descent goes on
    with its ``inverse``.

    References
    ----------
    Lewis, Overton, "Nonsmooth optimization via quasi-Newton methods" (2013), algorithms 2.1 and 2.6.
    """
    value, gradient = function(x, np.inf)
    if gradient is None or not np.isfinite(value) or not np.isfinite(gradient).all():
        return None
    values = [value]
    fresh, stalled, steps = inverse is None, 0, 0
    inverse = _steepest(gradient, 1.0) if inverse is None else inverse
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
        values.append(value)
    return Descent(x, value, gradient, steps, tuple(values), inverse)


def _steepest(gradient: Array, length: float) -> Array:
    return np.eye(len(gradient)) * (length / max(float(np.linalg.norm(gradient)), 1e-300))


def _updated(inverse: Array, s: Array, y: Array, fresh: bool) -> tuple[Array, bool]:
    sy = float(s @ y)
    # y^T y vanishes where the entries of y are smaller than the root of the smallest number.
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
    x: Array,
    value: float,
    direction: Array,
    slope: float,
    stop_below: float,
    late: Callable[[], bool],
) -> tuple[Array, float, Array] | None:
    """A point of sufficient decrease, and, where one is found, of a slope that has risen; None without decrease."""
    step, low, high = 1.0, 0.0, np.inf
    best: tuple[Array, float, Array] | None = None
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
