r"""From where positions are counted, where nothing in a plant depends on it.

A multi-turn encoder may begin anywhere, thousands of turns from zero. An effect over the position, such as
:math:`A_c \cos kq + A_s \sin kq`, then has a phase that no record tells: an error of k turns it by q times as much, and
no fit finds its way. So positions far from zero are counted from a point within the strokes; of an angle by whole
turns, which leaves all that repeats with the turn as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.record import Record

__all__ = ["counted_from", "position_datum"]


FAR = 3.0  # strokes from zero
RANK = 1e-9


def position_datum(plant: LinearPlant, records: Sequence[Record]) -> dict[str, float]:
    """Output -> what is to be taken off it in all of the records; empty where no position is far from zero.

    A datum is free where the equations are the same at every place: along the one null vector of A that moves outputs.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> t = np.arange(200) * 1e-3
    >>> far = Record(t, {"u": np.sin(t)}, {"phi": 3000.0 + np.sin(9 * t)}, {"u": "V", "phi": "rad"})
    >>> round(position_datum(plant("dc-motor"), [far])["phi"] / (2 * np.pi), 9)
    478.0
    """
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
    """The record with its positions counted from there."""
    outputs = {name: y - datum.get(name, 0.0) for name, y in record.outputs.items()}
    return Record(record.t, record.inputs, outputs, record.units, record.name, record.meaning)
