"""A record beside a model: its columns by the model's names, and where they have others, the command that maps them."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robustlab.cli import TYPED
from robustlab.cli.console import note
from robustlab.cli.options import RecordOptions, names
from robustlab.errors import InputError, RobustlabError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robustlab.identification.record_check.column_mapping import ColumnMapping
    from robustlab.record import Record
    from robustlab.signals import Signal


def read_named(options: RecordOptions, system: Any, named: str, files: list[str], remarks: bool) -> Record:
    """The record that a command names, ``FILE`` or ``FILE#GROUP``; beside a model where there is one.

    ``files`` gets the file. A file whose own name has a # is taken as it is.
    """
    file, mark, group = named.rpartition("#")
    if not mark or Path(named).exists():
        file, group = named, None
    files.append(file)
    if system is None:
        return options.read(file, options.inputs, group, tell=remarks)
    return read_beside(system, options, file, group, tell=remarks)


def read_beside(
    system: Any, options: RecordOptions, file: str, group: str | None = None, *, tell: bool = True
) -> Record:
    """The record in a file, with the inputs that were asked for, or the model's."""
    inputs, outputs = _sides(system)
    asked = options.inputs or ",".join(s.name for s in inputs)
    try:
        record = options.read(file, asked, group, tell=tell)
    except InputError as error:
        if options.inputs is not None or not error.found.startswith("missing "):
            raise
        raise _proposed(error, system, options, file, group) from None
    if options.outputs is None and outputs and not {s.name for s in outputs} & set(record.outputs):
        names = ", ".join(record.outputs) or "none"
        missing = InputError(file, f"no output of the model among {names}", ", ".join(s.name for s in outputs))
        raise _proposed(missing, system, options, file, group)
    if tell and options.outputs is None:
        _tell_strangers(record, outputs, file)
    return record


def _tell_strangers(record: Record, outputs: Sequence[Signal], file: str) -> None:
    """A note on columns that are no output of the model, but by their names and units seem to be one."""
    from robustlab.identification.record_check.column_mapping import propose_columns

    known = {s.name for s in outputs}
    lacking = [s for s in outputs if s.name not in record.outputs]
    if not lacking or known >= set(record.outputs):
        return
    found = propose_columns(record, (), lacking, {*record.inputs, *known})
    if found.outputs:
        every = ",".join([*(name for name in record.outputs if name in known), *found.texts("outputs")])
        strangers = ", ".join(found.outputs.values())
        note(f"{file}: {strangers}: no output of the model, and left out; --outputs {shlex.quote(every)} takes it")


def signals_of(system: Any) -> Sequence[Signal]:
    """All signals of a plant or model; none of anything else."""
    return [s for side in ("inputs", "outputs", "states") for s in getattr(system, side, ()) if hasattr(s, "unit")]


def _sides(system: Any) -> tuple[Sequence[Signal], Sequence[Signal]]:
    """Inputs and outputs of a plant or of a model of any kind."""
    from robustlab.statespace import as_model

    if not hasattr(system, "inputs"):
        system = as_model(system)
    return system.inputs, system.outputs


def _proposed(error: InputError, system: Any, options: RecordOptions, file: str, group: str | None) -> InputError:
    """The error with a proposal; as it is where all columns cannot be read, or none is an input."""
    from robustlab.identification.record_check.column_mapping import columns_of, propose_columns

    def read(clock: str | None, dt: float | None) -> Record:
        bare = replace(options, unit=None, inputs=None, outputs=None, clock=clock or options.clock, dt=dt or options.dt)
        return bare.read(file, None, group, tell=False)

    try:
        record, clock = columns_of(read)
    except RobustlabError:
        return error
    inputs, outputs = _sides(system)
    taken = {text.partition("=")[2] or text for text in names(options.inputs or "")}
    found = propose_columns(record, () if taken else inputs, outputs, {*taken, clock or options.clock})
    if found.missing or not found.outputs:
        none = ", ".join(found.missing) or "an output"
        hint = "name the columns: --inputs u=COLUMN,... --outputs q=COLUMN,..."
        left = f"  no name and no unit matches {none}; columns left: {', '.join(found.left) or 'none'}"
        return InputError(error.where, error.found, error.expected, hint, (left,))
    lines = [f"  {line}" for line in found.lines()]
    if clock is not None:
        lines.insert(0, f"  the time is {clock}: it rises from sample to sample")
    typed = shlex.join(_command(found, options, clock))
    return InputError(error.where, error.found, error.expected, typed, tuple(lines))


def _command(found: ColumnMapping, options: RecordOptions, clock: str | None) -> list[str]:
    """The command as it was typed, with what the proposal adds."""
    words = ["robustlab", *TYPED]
    if options.inputs is None:
        words += ["--inputs", ",".join(found.texts("inputs"))]
    if options.outputs is None:
        words += ["--outputs", ",".join(found.texts("outputs"))]
    if clock is not None:
        words += ["--clock", clock]
    for name, unit in found.units.items():
        words += ["--unit", f"{name}={unit}"]
    return words
