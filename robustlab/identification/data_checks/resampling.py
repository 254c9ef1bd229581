"""Resampling of records with missing samples, jitter or two time bases; datum of positions.

Positions far from zero are measured from a point within the strokes: otherwise no fit finds the phase of an effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.errors import InputError
from robustlab.record import Record
from robustlab.time_base import (
    NEAR,
    SAME_TIME,
    checked_step,
    clock_step,
    common_clock,
    held,
    interpolated,
    summarise_clock,
)


class Gap(NamedTuple):
    """No sample between ``start`` and ``stop`` (the stamps on both sides, in s); ``missing`` samples are lost."""

    start: float
    stop: float
    missing: int


class UniformRecord(NamedTuple):
    """A record on a uniform time base, and its measured samples."""

    record: Record
    valid: Mapping[str, Mask]  # output name -> True where samples on both sides are near, shape (n,)
    gaps: tuple[Gap, ...]  # missing samples, in order; the inputs are assumed constant over them


def uniform(record: Record, dt: float | None = None) -> UniformRecord:
    """Resample a record on a uniform time base from its first sample, unless it is uniform and ``dt`` is None.

    ``dt``: sample time in s; default that of the record (`clock_step`).

    Examples
    --------
    >>> r = Record([0.0, 0.1, 0.2, 0.5, 0.6], {"u": [1, 1, 2, 2, 3]}, {"q": [0.0, 0.1, 0.2, 0.5, 0.6]})
    >>> found = uniform(r)
    >>> found.record["q"].round(9).tolist(), found.valid["q"].tolist(), found.gaps[0].missing
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [True, True, True, False, False, True, True], 2)
    """
    own = clock_step(record.t)
    if dt is None and record.is_uniform:
        valid = {name: np.ones(record.n, dtype=bool) for name in record.outputs}
        return UniformRecord(record, valid, ())
    step = own if dt is None else checked_step(record.name, dt, record.t)
    count = int(np.floor(record.duration / step + SAME_TIME)) + 1
    clock = record.t[0] + step * np.arange(count)
    near = NEAR * own
    outputs, valid = dict[str, Array](), dict[str, Mask]()
    for name, samples in record.outputs.items():
        outputs[name], own_sample, apart = interpolated(clock, record.t, samples, step)
        valid[name] = own_sample | (apart <= near)
    inputs = {name: held(clock, record.t, samples, step) for name, samples in record.inputs.items()}
    return UniformRecord(replace(record, t=clock, inputs=inputs, outputs=outputs), valid, _gaps(record.t, own))


def join_clocks(first: Record, second: Record, dt: float | None = None) -> Record:
    """Join the signals of two loggers with synchronous clocks and different sample times in one record.

    Without ``dt`` the joint time base is the coarser of the two, over their common span; of equal ones that of the
    record with more outputs. Inputs are held, outputs interpolated; a shift between the clocks is a delay, which effect
    identification finds. The meaning of ``t`` documents the resampling.

    Examples
    --------
    >>> drive = Record([0.0, 0.2, 0.4, 0.6], outputs={"v": [0.0, 1.0, 2.0, 3.0]})
    >>> force = Record(0.05 + 0.1 * np.arange(7), inputs={"f": [1, 2, 3, 4, 5, 6, 7]})
    >>> joint = join_clocks(drive, force)
    >>> joint.t.tolist(), joint["f"].tolist(), joint["v"].tolist()
    ([0.2, 0.4, 0.6], [2.0, 4.0, 6.0], [1.0, 2.0, 3.0])
    """
    where = f"{first.name} and {second.name}"
    twice = sorted({*first.inputs, *first.outputs} & {*second.inputs, *second.outputs})
    if twice:
        raise InputError(where, f"signal {twice[0]!r} is in both", "each signal once")
    steps = [clock_step(r.t) for r in (first, second)]
    for r, step in zip((first, second), steps, strict=True):
        refuse_gaps(r.name, _gaps(r.t, step), "join")
    equal = abs(steps[0] - steps[1]) <= SAME_TIME * steps[0]
    ordered = (second, first) if equal and len(second.outputs) > len(first.outputs) else (first, second)
    clock, _ = common_clock(where, {f"{k}": r.t for k, r in enumerate(ordered)}, dt)
    step = float(np.median(np.diff(clock)))
    inputs = {n: held(clock, r.t, x, step) for r in (first, second) for n, x in r.inputs.items()}
    outputs = {n: interpolated(clock, r.t, x, step)[0] for r in (first, second) for n, x in r.outputs.items()}
    units, meaning = {**first.units, **second.units}, {**first.meaning, **second.meaning}
    done = f"2 clocks brought on one of {1 / step:.6g} Hz, inputs held, outputs interpolated"
    clocks = [f"{r.name}: {summarise_clock(r.t).text()}" for r in (first, second)]
    meaning["t"] = "\n".join([*(r.meaning["t"] for r in (first, second) if "t" in r.meaning), done, *clocks])
    return Record(clock, inputs, outputs, units, f"{first.name} + {second.name}", meaning)


def refuse_gaps(where: str, gaps: Sequence[Gap], action: str) -> None:
    if gaps:
        gap = gaps[0]
        found = f"{gap.missing} samples missing from {gap.start:.9g} s to {gap.stop:.9g} s"
        hint = f"{action} the stretches between the gaps: record.between(start, stop)"
        raise InputError(where, found, "a clock without gaps", hint)


def _gaps(t: Array, step: float) -> tuple[Gap, ...]:
    steps = np.diff(t)
    holes = np.flatnonzero(steps > NEAR * step)
    return tuple(Gap(float(t[k]), float(t[k + 1]), max(1, round(float(steps[k]) / step) - 1)) for k in holes)


FAR = 3.0  # strokes from zero
RANK = 1e-9


def position_datum(plant: LinearPlant, records: Sequence[Record]) -> dict[str, float]:
    """Return output -> datum to subtract in all of the records; empty if no position is far from zero."""
    # A datum is free along a single null vector of A that moves outputs: the equations are the same at every position.
    model = plant.state_space()
    _, sigma, right = np.linalg.svd(model.A)
    null = right[sigma <= RANK * sigma.max(initial=0.0)]
    if len(null) != 1:
        return {}
    moves = model.C @ null[0]
    names = [s.name for s in plant.outputs if any(s.name in r.outputs for r in records)]
    moved = {s.name: float(c) for s, c in zip(plant.outputs, moves, strict=True) if s.name in names and abs(c) > RANK}
    if not moved:
        return {}
    first = max(moved, key=lambda name: abs(moved[name]))
    seen = [r.outputs[first] for r in records if first in r.outputs]
    centre = 0.5 * (min(float(y.min()) for y in seen) + max(float(y.max()) for y in seen))
    if abs(centre) <= FAR * max(float(np.ptp(y)) for y in seen):
        return {}
    if next(s.unit for s in plant.outputs if s.name == first) == "rad":
        centre = 2 * np.pi * round(centre / (2 * np.pi))
    return {name: centre * share / moved[first] for name, share in moved.items()}


def counted_from(record: Record, datum: dict[str, float]) -> Record:
    """Subtract the datum from the positions of a record."""
    return replace(record, outputs={name: y - datum.get(name, 0.0) for name, y in record.outputs.items()})
