"""What a record's samples say about how it was taken: clock, constant channels, clipping, units that are not stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.record import Record

__all__ = ["ChannelSummary", "RecordCheck", "check_record"]

# Samples in a row at exactly the same extreme value; fewer occur by chance with a coarse encoder.
CLIPPED_RUN = 5


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
    """Summary of a record and remarks, each with the channel and the samples it concerns."""

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
            remarks.extend(_remarks(name, record.units[name], x))
    return RecordCheck(record, tuple(channels), tuple(remarks))


def _remarks(name: str, unit: str, x: NDArray[np.float64]) -> list[str]:
    found = [] if unit else [f"{name}: no unit stated"]
    if x.min() == x.max():
        return [*found, f"{name}: constant ({x[0]:.6g}) over all {len(x)} samples"]
    for word, extreme in (("greatest", x.max()), ("least", x.min())):
        start, length = _longest_run(x == extreme)
        # A signal that takes few levels (a reference, a square wave) rests at its extremes without being clipped.
        if length >= CLIPPED_RUN and len(np.unique(x)) > 0.05 * len(x):
            found.append(
                f"{name}: at its {word} value {extreme:.6g} for samples {start} to {start + length - 1}: clipped?"
            )
    return found


def _longest_run(mask: NDArray[np.bool_]) -> tuple[int, int]:
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    k = int(np.argmax(stops - starts))
    return int(starts[k]), int(stops[k] - starts[k])
