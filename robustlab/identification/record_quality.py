"""Channels of a record that look broken: constant, clipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robustlab.record import Record

__all__ = ["channel_warnings", "clipped_samples"]

Array = NDArray[np.float64]

SHORTEST_CLIP = 5  # samples that must stand still at the end of the range
FEWEST_LEVELS = 20  # a signal with fewer levels (a switch, a coarse sensor) cannot be judged
CLIPPED_SHARE = 1e-3


def channel_warnings(record: Record, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> list[str]:
    """One line for each constant or clipped channel among the named ones.

    Inputs are not judged for clipping: a step or a square wave stands at its extremes rightly.
    """
    standing = [name for name in (*inputs, *outputs) if not np.ptp(record[name])]
    warnings = [f"{name} is constant: {record[name][0]:.6g} {record.unit(name)}".rstrip() for name in standing]
    for name in outputs:
        count = clipped_samples(record[name])
        if count > CLIPPED_SHARE * record.n:
            share = f"{count} of {record.n} samples"
            warnings.append(f"{name} looks clipped: {share} stand at the end of its range, reached at full slope")
    return warnings


def clipped_samples(y: Array) -> int:
    """Number of samples that stand still at the largest or smallest value, which was reached or left with a jump.

    A sensor at its limit stops from full slope; a machine that comes to rest slows down first. A stand counts from 5
    samples on, and where one of the two steps before or after it is at least half the signal's median step.
    """
    if len(y) < SHORTEST_CLIP + 2 or len(np.unique(y)) < FEWEST_LEVELS:
        return 0
    step = np.abs(np.diff(y))
    usual = float(np.median(step[step > 0]))
    count = 0
    for extreme in (y.min(), y.max()):
        held = np.concatenate([[0], (y == extreme).astype(int), [0]])
        change = np.flatnonzero(np.diff(held))
        for first, last in zip(
            change[::2], change[1::2], strict=True
        ):  # samples first .. last - 1 stand at the extreme
            # Two steps on either side: the one that meets the limit is cut short by it.
            beside = np.concatenate([step[max(0, first - 2) : first], step[last - 1 : last + 1]])
            if last - first >= SHORTEST_CLIP and beside.max(initial=0.0) >= 0.5 * usual:
                count += int(last - first)
    return count
