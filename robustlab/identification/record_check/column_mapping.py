"""Which column of a record is which signal of a model: a proposal, with the reason for each, for a person to accept.

Evidence in this order: the same name, the unit, what the name says (``voltage``, ``Winkel``, ``i_a``), how the column
behaves (held between samples, as a drive is; the integral of another column), and last the order. A column is given to
a signal only where each is the other's clearly best match. Where names and units leave something open, a linear
model is tried (`robustlab.identification.record_check.column_trials`), which counts before behaviour and order. What
rests on the order alone, or is one of several, is said to be undecided, and no record is read by a mapping that nobody
has accepted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import InputError, RobustlabError
from robustlab.identification.record_check.column_trials import FOLLOWS, best_assignment
from robustlab.record import Record
from robustlab.signals import Signal
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.units import factor_between, same_unit, unit_family

# Words of names -> the units (the first of their family) of what they are called so; English, German, French.
WORDS = {
    "V": "voltage volt volts u v uin vin spannung tension dac pwm",
    "A": "current amp amps ampere strom courant i ia iq im",
    "rad": "angle phi theta ang winkel angular position pos enc encoder rotation",
    "rad/s": "speed omega w velocity vel rpm drehzahl geschwindigkeit vitesse tacho",
    "m": "position pos x y q weg lage displacement travel deplacement",
    "m/s": "speed velocity vel v geschwindigkeit vitesse",
    "N": "force f kraft",
    "N m": "torque moment drehmoment couple tau",
}
DRIVES = {"input", "in", "command", "cmd", "drive", "control", "excitation", "stellgroesse", "eingang", "commande"}
# Points of evidence; a match is clear where it is ahead by LEAD.
SAME_NAME, SAME_LETTERS, UNIT, WORD, DRIVE, HELD, INTEGRAL, LEAD = 100.0, 90.0, 40.0, 30.0, 20.0, 15.0, 20.0, 10.0
HELD_SHARE = 0.5  # of the steps of a column that is held between samples
INTEGRAL_FIT = 0.995  # correlation of a column with the integral of another one
LONGEST = 20_000  # samples that are looked at


@dataclass(frozen=True)
class ColumnMapping:
    """A proposal: which columns the signals of a model are."""

    # inputs, outputs: signal -> column
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    reasons: Mapping[str, str]  # signal -> why it is that column
    units: Mapping[str, str]  # signal -> unit that the file states and the model does not use
    undecided: tuple[str, ...]  # what somebody has to decide, a line each
    missing: tuple[str, ...]  # inputs without a column
    left: tuple[str, ...]  # columns that are no signal's

    def texts(self, side: str) -> tuple[str, ...]:
        """One side as a record is asked for it: ``u=voltage``, or ``q`` where the names are the same."""
        mapping: Mapping[str, str] = getattr(self, side)
        return tuple(name if name == column else f"{name}={column}" for name, column in mapping.items())

    def lines(self) -> list[str]:
        """The proposal in words; of a column with the signal's own name there is nothing to say."""
        both = {**self.inputs, **self.outputs}
        told = [f"{name} = {column}: {self.reasons[name]}" for name, column in both.items() if name != column]
        told += [f"undecided: {line}" for line in self.undecided]
        return [*told, f"left over: {', '.join(self.left)}"] if self.left else told


@dataclass
class _Evidence:
    """What speaks for a column as a signal."""

    points: float = 0.0
    reasons: list[str] = field(default_factory=list)

    def add(self, points: float, reason: str) -> None:
        self.points += points
        self.reasons.append(reason)


def columns_of(
    read: Callable[[str | None, float | None], Record], dt: float | None = None
) -> tuple[Record, str | None]:
    """All columns of a file as outputs, and the column that can only be the time where the file has no usual one.

    ``read``: reads the file with a clock and a sample time, or with None for them.
    Raises InputError: what the reader refuses; no clock, and not one column that rises and may be one.
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
    record: Record,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    taken: Collection[str | None] = (),
    system: Any = None,
) -> ColumnMapping:
    """The columns that a model's signals most likely are.

    ``record``: all columns, as outputs or inputs.
    ``inputs``, ``outputs``: signals of the model.
    ``taken``: columns that are no signal's: the times, and what somebody has given a name already.
    ``system``: the plant or model; where it is linear, what names and units leave open is tried with it.
    """
    columns = {name: values for name, values in {**record.inputs, **record.outputs}.items() if name not in taken}
    held = {name for name, values in columns.items() if _is_held(values)}
    speeds = _integrals(record.t, columns, held)
    signals = [*((s, True) for s in inputs), *((s, False) for s in outputs)]
    table = {
        (s.name, column): found
        for s, is_input in signals
        for column in columns
        if (found := _evidence(s, is_input, column, record.unit(column), column in held, speeds)) is not None
    }
    found, reasons = _clear_matches(table)
    undecided: list[str] = []
    if (model := _linear_model(system)) is not None:
        undecided += _tried(model, record, columns, table, found, reasons)
    for s, is_input in signals:
        free = [c for c in columns if (s.name, c) in table and c not in found.values()]
        likely = [c for c in free if table[s.name, c].points >= LEAD]
        needed = is_input or not any(o.name in found for o in outputs)
        if s.name in found or not (likely or (needed and free)):
            continue
        best = max(free, key=lambda c: table[s.name, c].points)  # the first of equals
        why = table[s.name, best].reasons
        others = [c for c in likely or free if c != best]
        found[s.name] = best
        reasons[s.name] = ", ".join(why) or ("the first column left" if others else "the only column left")
        undecided.append(f"{s.name} is {best}" + (f", or {' or '.join(others)}" if others else ": by the order alone"))
    ins, outs = ({s.name: found[s.name] for s in side if s.name in found} for side in (inputs, outputs))
    wanted = {s.name: s.unit for s, _ in signals}
    stated = {name: record.unit(column) for name, column in found.items()}
    units = {n: u for n, u in stated.items() if u and wanted[n] and not same_unit(u, wanted[n])}
    left = tuple(c for c in columns if c not in found.values())
    missing = tuple(s.name for s in inputs if s.name not in found)
    return ColumnMapping(ins, outs, reasons, units, tuple(undecided), missing, left)


def _clear_matches(table: Mapping[tuple[str, str], _Evidence]) -> tuple[dict[str, str], dict[str, str]]:
    """Signal -> column, and why, as long as a pair is left of which each is the other's clearly best match."""
    taken: dict[str, str] = {}
    reasons: dict[str, str] = {}
    while True:
        open_pairs = {
            pair: found.points
            for pair, found in table.items()
            if pair[0] not in taken and pair[1] not in taken.values() and found.points >= LEAD
        }
        clear = {
            (signal, column): points
            for (signal, column), points in open_pairs.items()
            if all(
                points >= other + LEAD
                for (s, c), other in open_pairs.items()
                if (s, c) != (signal, column) and (s == signal or c == column)
            )
        }
        if not clear:
            return taken, reasons
        signal, column = max(clear, key=lambda pair: clear[pair])
        taken[signal] = column
        reasons[signal] = ", ".join(table[signal, column].reasons)


def _tried(
    model: StateSpaceModel,
    record: Record,
    columns: Collection[str],
    table: Mapping[tuple[str, str], _Evidence],
    found: dict[str, str],
    reasons: dict[str, str],
) -> list[str]:
    """Put what a trial of the model says in the place of what no name and no unit does; what it leaves undecided."""
    known = {signal: column for signal, column in found.items() if table[signal, column].points >= WORD}
    given = {
        signal: [known[signal]] if signal in known else [c for c in columns if (signal, c) in table]
        for signal in (*model.input_names, *model.output_names)
    }
    choices = {s: [c for c in cs if s in known or c not in known.values()] for s, cs in given.items()}
    if set(choices) == set(known):
        return []
    trial = best_assignment(model, record, choices)
    if trial is None or not trial.follows:
        return []
    found |= trial.columns
    for signal in [s for s in found if s not in trial.columns]:
        del found[signal]
    undecided: list[str] = []
    left = _percent(trial.left)
    for signal, column in trial.columns.items():
        if signal in known:
            continue
        other, more = trial.others.get(signal, ("", np.inf))
        otherwise = f"{other or 'no column'} {_percent(more)}" if np.isfinite(more) else "nothing else comes near"
        told = f"by simulation: the model leaves {left} of what moves, with {otherwise}"
        reasons[signal] = ", ".join([told, *table[signal, column].reasons])
        if not trial.is_sure(signal):
            both = f"{signal} is {column}, or {other or 'no column'}: the model follows both ways"
            lost = trial.shares.get(signal, 0.0) > FOLLOWS
            undecided.append(f"{signal} is {column}: the model does not follow it" if lost else both)
    return undecided


def _linear_model(system: Any) -> StateSpaceModel | None:
    if system is None or isinstance(system, NonlinearPlant):
        return None
    try:
        return as_model(system)
    except RobustlabError:
        return None


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else "all"


# --- evidence --------------------------------------------------------------------------------------------------------


def _evidence(
    signal: Signal, is_input: bool, column: str, unit: str, held: bool, speeds: Mapping[str, str]
) -> _Evidence | None:
    """What speaks for a column as a signal; None where its unit or its name says that it is something else."""
    found = _Evidence()
    if "," in column or "=" in column:  # no way to write it behind --inputs
        return None
    if column == signal.name:
        found.add(SAME_NAME, "the same name")
    elif column.casefold() == signal.name.casefold():
        found.add(SAME_LETTERS, "the same name")
    family = unit_family(signal.unit)
    quantity = next(iter(family[0])) if family else signal.unit
    if unit and signal.unit:
        if factor_between(unit, signal.unit) is None:
            return None
        found.add(UNIT, f"in {unit}")
    words = _words(column)
    called = {quantity for quantity, names in WORDS.items() if words & set(names.split())}
    if quantity in called:
        found.add(WORD, "named so")
    elif called and quantity in WORDS and not found.points:
        return None
    if is_input and words & DRIVES:
        found.add(DRIVE, "named as a drive")
    if held and is_input:
        found.add(HELD, "held between samples")
    if quantity in ("rad", "m") and column in speeds:
        found.add(INTEGRAL, f"the integral of {speeds[column]}")
    if quantity in ("rad/s", "m/s") and column in speeds.values():
        found.add(INTEGRAL, f"the rate of {next(a for a, b in speeds.items() if b == column)}")
    return found


def _words(name: str) -> set[str]:
    """The words of a name, in small letters: ``motorSpeed_rpm`` as motor, speed, rpm."""
    parted = re.sub(r"([a-zäöüéè])([A-Z])", r"\1 \2", name)
    return {word.rstrip("0123456789") for word in re.split(r"[^0-9A-Za-zäöüÄÖÜéèß]+", parted.lower()) if word}


def _is_held(values: Array) -> bool:
    """Whether a column stands still from sample to sample more often than not, and moves at all."""
    steps = np.diff(values[:LONGEST])
    return bool(steps.any() and np.mean(steps == 0) > HELD_SHARE)


def _integrals(t: Array, columns: Mapping[str, Array], held: Collection[str]) -> dict[str, str]:
    """Column -> the column, not a held one, of which it is the integral; constants and slopes do not count."""
    clock = t[:LONGEST]
    straight = np.column_stack([np.ones(len(clock)), clock - clock[0]])
    basis = np.linalg.qr(straight)[0]

    def bent(values: Array) -> Array:
        """Without what is straight, of length one; zero where nothing is left."""
        rest = values - basis @ (basis.T @ values)
        size = float(np.linalg.norm(rest))
        return rest / size if size > 1e-9 * float(np.linalg.norm(values) or 1.0) else np.zeros_like(rest)

    whole = {name: values[:LONGEST] for name, values in columns.items()}
    sums = {
        name: bent(np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(clock))]))
        for name, y in whole.items()
        if name not in held
    }
    found: dict[str, str] = {}
    for name, values in whole.items():
        shape = bent(values)
        fits = {other: float(shape @ area) for other, area in sums.items() if other != name}
        best = max(fits, key=lambda other: fits[other], default=None)
        if best is not None and fits[best] >= INTEGRAL_FIT:
            found[name] = best
    return found
