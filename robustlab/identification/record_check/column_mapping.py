"""Match the columns of a file with a model's signals by name and unit; a person accepts the proposal."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robustlab.errors import InputError
from robustlab.record import Record
from robustlab.signals import Signal
from robustlab.units import factor_between, same_unit


@dataclass(frozen=True)
class ColumnMapping:
    """A proposal: which columns the signals of a model are."""

    # inputs, outputs: signal -> column
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    reasons: Mapping[str, str]  # signal -> why it is that column
    units: Mapping[str, str]  # signal -> unit that the file states and the model does not use
    missing: tuple[str, ...]  # inputs without a column
    left: tuple[str, ...]  # columns that are no signal's

    def texts(self, side: str) -> tuple[str, ...]:
        """One side in the form of ``--inputs``: ``u=voltage``, or ``q`` where the names are the same."""
        mapping: Mapping[str, str] = getattr(self, side)
        return tuple(name if name == column else f"{name}={column}" for name, column in mapping.items())

    def lines(self) -> list[str]:
        """The proposal in words, without the columns that have the signal's own name."""
        both = {**self.inputs, **self.outputs}
        told = [f"{name} = {column}: {self.reasons[name]}" for name, column in both.items() if name != column]
        return [*told, f"left over: {', '.join(self.left)}"] if self.left else told


def columns_of(
    read: Callable[[str | None, float | None], Record], dt: float | None = None
) -> tuple[Record, str | None]:
    """All columns of a file as outputs, and the column that can only be the time where the file has no usual one.

    ``read``: reads the file with a clock and a sample time, or with None for them.
    """
    try:
        return read(None, dt), None
    except InputError as error:
        if "no clock" not in error.found:
            raise
        refused = error
    numbers = read(None, 1.0)
    rising = [name for name, y in numbers.outputs.items() if len(y) > 1 and (y[1:] > y[:-1]).all()]
    named = [name for name in rising if re.match(r"t(ime|imestamp)?([ _.\-\[(].*)?$|.*(time|zeit|temps)", name, re.I)]
    if len(named or rising) != 1:
        raise refused
    clock = (named or rising)[0]
    return read(clock, None), clock


def propose_columns(
    record: Record, inputs: Sequence[Signal], outputs: Sequence[Signal], taken: Collection[str | None] = ()
) -> ColumnMapping:
    """Match signals with columns of the same name, then of the same letters, then of the only fitting stated unit.

    ``record``: all columns, as outputs or inputs.
    ``taken``: columns that are no signal's: the times, and those that somebody has named already.
    """
    names = [n for n in (*record.inputs, *record.outputs) if n not in taken and not {",", "="} & set(n)]
    signals = [*inputs, *outputs]
    found: dict[str, str] = {}
    reasons: dict[str, str] = {}

    def match(fits: Callable[[Signal, str], bool], reason: str) -> None:
        """Pair each open signal with a column where each is the other's only fit."""
        pairs = [
            (s.name, c) for s in signals for c in names
            if s.name not in found and c not in found.values() and fits(s, c)
        ]  # fmt: skip
        for name, column in pairs:
            if sum(n == name or c == column for n, c in pairs) == 1:
                found[name], reasons[name] = column, reason.format(record.unit(column))

    def in_unit(signal: Signal, column: str) -> bool:
        unit = record.unit(column)
        return bool(unit and signal.unit) and factor_between(unit, signal.unit) is not None

    match(lambda s, c: c == s.name, "the same name")
    match(lambda s, c: c.casefold() == s.name.casefold(), "the same name")
    match(in_unit, "in {}")
    ins, outs = ({s.name: found[s.name] for s in side if s.name in found} for side in (inputs, outputs))
    wanted: dict[str, Any] = {s.name: s.unit for s in signals}
    stated = {name: record.unit(column) for name, column in found.items()}
    units = {n: u for n, u in stated.items() if u and wanted[n] and not same_unit(u, wanted[n])}
    left = tuple(c for c in names if c not in found.values())
    return ColumnMapping(ins, outs, reasons, units, tuple(s.name for s in inputs if s.name not in found), left)
