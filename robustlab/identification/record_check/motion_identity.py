"""Channels with the other sign in a record of a nonlinear plant, found along its motion.

With another sign of one channel the plant follows the record far worse, or not at all: what is missing is then as large
as the channel itself. A channel is said to be turned only where turning it takes nearly all of the error away, which no
missing effect could do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import Course
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.hypotheses.motion_smoother import smooth_motion
from robustlab.identification.response.motion_response import MotionResponse, fit_windows
from robustlab.identification.response.response import Stretch, stretch_of
from robustlab.record import Record

__all__ = ["turned_channels"]

LONGEST = 600  # samples that are looked at
WINDOW = 100  # samples
SUSPECT = 10.0  # times the sensors' scatter: a smaller error is no channel's
LEFT = 0.1  # share of the squared error that a turned channel may leave


def turned_channels(plant: NonlinearPlant, record: Record) -> dict[str, float]:
    """The channel whose sign is wrong, with the share of the squared error that it leaves when turned; empty for none.

    Parameters
    ----------
    record
        On a uniform clock, with all inputs of the plant and the positions of its joints.

    Raises
    ------
    InputError
        A joint whose position is not recorded.
    NoTrustworthyNumber
        A motion that the plant cannot have, whichever channel is turned.
    """
    names = [s.name for s in plant.outputs if s.name in record.outputs]
    first = max(0, (record.n - LONGEST) // 2)
    whole = stretch_of(record, [s.name for s in plant.inputs], names).cut(first, first + LONGEST)
    columns = tuple(k for k, s in enumerate(plant.outputs) if s.name in names)
    u = np.column_stack(list(whole.u.values()))
    reason: NoTrustworthyNumber | None = None
    try:
        error = _error(plant, whole, u, whole.y, columns)
    except NoTrustworthyNumber as none:
        error, reason = np.inf, none
    if error < SUSPECT**2:
        return {}
    left = {}
    for kind, signals, labels in (("u", u, list(whole.u)), ("y", whole.y, names)):
        for j, name in enumerate(labels):
            turned = signals.copy()
            turned[:, j] *= -1.0
            try:
                left[name] = _error(plant, whole, *((turned, whole.y) if kind == "u" else (u, turned)), columns)
            except NoTrustworthyNumber:
                left[name] = np.inf
    best = min(left, key=lambda name: left[name])
    if reason is not None and not left[best] < SUSPECT**2:
        raise reason
    share = left[best] / error
    return {best: share} if share < LEFT else {}


def _error(plant: NonlinearPlant, whole: Stretch, u: Array, y: Array, columns: Sequence[int]) -> float:
    """Mean square of the windowed error in units of the sensors' scatter."""
    smoothed = smooth_motion(plant, whole.t, u, y, columns).smoothed
    noise = np.maximum(smoothed.noise_std, 1e-6 / whole.weight)
    judged = Stretch(whole.t, whole.u, y, 1.0 / noise)
    response = MotionResponse(Course(plant, smoothed.x, u, float(whole.t[1] - whole.t[0])), tuple(columns), judged)
    length = min(WINDOW, len(whole.t))
    starts = np.arange(0, len(whole.t) - length + 1, length)
    left = [fit_windows(w, response.errors(w), judged.weight).left for w in response.responses(starts, length)]
    return float(np.mean(np.concatenate(left) ** 2))
