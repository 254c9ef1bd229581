"""What the outputs of the tape of local models are, in words, for messages."""

from __future__ import annotations

from collections.abc import Sequence

from robustlab.dynamics.plant_contract import PortPlace
from robustlab.statespace import Signal

__all__ = ["labels"]


def labels(
    states: Sequence[Signal], inputs: Sequence[Signal], outputs: Sequence[Signal], places: Sequence[PortPlace]
) -> list[str]:
    """One text for each output of the tape of f, h, A, B, C, D and push, row by row.

    Examples
    --------
    >>> labels([Signal("x")], [], [Signal("y")], [])
    ['the rate of x', 'output y', 'the slope of the rate of x by x', 'the slope of output y by x']
    """
    rates = [f"the rate of {s.name}" for s in states]
    outs = [f"output {s.name}" for s in outputs]

    def slopes(rows: list[str], columns: Sequence[Signal] | Sequence[PortPlace], kind: str = "") -> list[str]:
        return [f"the slope of {row} by {kind}{column.name}" for row in rows for column in columns]

    by_force = slopes(rates, places, "the force at ")
    return [
        *rates,
        *outs,
        *slopes(rates, states),
        *slopes(rates, inputs),
        *slopes(outs, states),
        *slopes(outs, inputs),
        *by_force,
    ]
