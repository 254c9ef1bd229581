"""Doors of the questions asked of one model."""

from __future__ import annotations

from typing import Annotated, Any

import robustlab as rl
from robustlab.doors.declaration import Named, door
from robustlab.doors.words import Model


@door("model gap", "gap", result="uncertainty.distances.gap_metric.GapMetric")
def gap(first: Annotated[Model, Named(key="of")], second: Annotated[Model, Named(key="beside")]) -> Any:
    """Distance of two models as feedback sees it, gap and nu-gap metric: 0 equal, 1 nothing in common.

    Example: robustlab model gap before.h5 after.h5
    """
    return rl.gap(first, second)


@door("model zeros", "zeros", result="linear_analysis.invariant_zeros.Zeros")
def zeros(system: Annotated[Model, Named(key="of")]) -> Any:
    """Finite invariant zeros of a model with their kinds: transmission zeros, and modes that are hidden.

    Exit code 4: rounding of the entries decides where a zero is, or there are more than 200 states.

    Example: robustlab model zeros motor.h5
    """
    return rl.zeros(system)
