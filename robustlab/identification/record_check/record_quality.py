"""What a record's samples say about how it was taken: clock, constant and clipped channels, units not stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.record import Record

__all__ = ["ChannelSummary", "RecordCheck", "channel_warnings", "check_record", "clipped_runs"]


SHORTEST_CLIP = 5  # samples that must stand still at the end of the range
FEWEST_LEVELS = 20  # a signal with fewer levels (a switch, a coarse sensor) cannot be judged
CLIPPED_SHARE = 1e-3


@dataclass(frozen=True)
class ChannelSummary:
    """One channel: least and greatest value, root mean square, in ``unit``."""

    name: str
    side: str
    unit: str
    least: float
    greatest: float
    rms: float


@dataclass(frozen=True)
class RecordCheck:
    """Summary of a record and remarks, each with the channel it concerns."""

    record: Record
    channels: tuple[ChannelSummary, ...]
    remarks: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """All but the samples."""
        r = self.record
        clock = {"n": r.n, "duration": r.duration, "dt": r.dt, "is_uniform": r.is_uniform}
        return {"name": r.name, **clock, "channels": [vars(c) for c in self.channels], "remarks": self.remarks}


def check_record(record: Record) -> RecordCheck:
    """Summarise ``record``; what makes a record unusable (NaN, a clock that runs backwards) never gets here."""
    channels, remarks = [], []
    if not record.is_uniform:
        steps = np.diff(record.t)
        k = int(np.argmax(np.abs(steps - record.dt)))
        remarks.append(f"t: steps of {steps.min():.6g} to {steps.max():.6g} s, the oddest after sample {k}")
    for side, group in (("input", record.inputs), ("output", record.outputs)):
        for name, x in group.items():
            rms = float(np.sqrt(np.mean(x**2)))
            channels.append(ChannelSummary(name, side, record.units[name], float(x.min()), float(x.max()), rms))
            if not record.units[name]:
                remarks.append(f"{name}: no unit stated")
    remarks.extend(channel_warnings(record, tuple(record.inputs), tuple(record.outputs)))
    return RecordCheck(record, tuple(channels), tuple(remarks))


def channel_warnings(record: Record, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> list[str]:
    """One line for each constant or clipped channel among the named ones.

    Inputs are not judged for clipping: a step or a square wave stands at its extremes rightly.
    """
    standing = [name for name in (*inputs, *outputs) if not np.ptp(record[name])]
    warnings = [f"{name} is constant: {record[name][0]:.6g} {record.unit(name)}".rstrip() for name in standing]
    for name in outputs:
        runs = clipped_runs(record[name])
        count = sum(last - first for first, last in runs)
        if count > CLIPPED_SHARE * record.n:
            warnings.append(
                f"{name} looks clipped: {count} of {record.n} samples stand at the end of its range, reached at full "
                f"slope (first: samples {runs[0][0]} to {runs[0][1] - 1})"
            )
    return warnings


def clipped_runs(y: Array) -> list[tuple[int, int]]:
    """Runs ``(first, last + 1)`` of samples that stand still at the largest or smallest value, reached with a jump.

    A sensor at its limit stops from full slope; a machine that comes to rest slows down first, and one that has not
    been started yet stands at the beginning of the record. A stand counts from 5 samples on, where one of the two steps
    before it (the last is cut short by the limit) is at least half the signal's median step.
    """
    if len(y) < SHORTEST_CLIP + 2 or len(np.unique(y)) < FEWEST_LEVELS:
        return []
    step = np.abs(np.diff(y))
    usual = float(np.median(step[step > 0]))
    runs = []
    for extreme in (y.min(), y.max()):
        held = np.concatenate([[0], (y == extreme).astype(int), [0]])
        change = np.flatnonzero(np.diff(held))
        for first, last in zip(change[::2], change[1::2], strict=True):
            before = step[max(0, first - 2) : first]
            if last - first >= SHORTEST_CLIP and before.max(initial=0.0) >= 0.5 * usual:
                runs.append((int(first), int(last)))
    return sorted(runs)
