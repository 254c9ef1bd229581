"""A record beside a model: its inputs are the model's where none are named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robustlab.cli.options import RecordOptions
from robustlab.errors import InputError

if TYPE_CHECKING:
    from robustlab.record import Record
    from robustlab.signals import Signal

HINT = "name the columns: --inputs u=COLUMN,... --outputs q=COLUMN,..."


def read_named(options: RecordOptions, system: Any, named: str, files: list[str], remarks: bool) -> Record:
    """The record that a command names, ``FILE`` or ``FILE#GROUP``; beside a model where there is one.

    ``files`` gets the file. A file whose own name has a # is taken as it is.
    """
    from robustlab.statespace import as_model

    file, mark, group = named.rpartition("#")
    if not mark or Path(named).exists():
        file, group = named, None
    files.append(file)
    if system is None:
        return options.read(file, options.inputs, group, tell=remarks)
    model = system if hasattr(system, "inputs") else as_model(system)
    asked = options.inputs or ",".join(s.name for s in model.inputs)
    try:
        record = options.read(file, asked, group, tell=remarks)
    except InputError as error:
        if options.inputs is None and error.found.startswith("missing "):
            error.hint = HINT
        raise
    wanted = [s.name for s in model.outputs]
    if options.outputs is None and wanted and not set(wanted) & set(record.outputs):
        found = f"no output of the model among {', '.join(record.outputs) or 'none'}"
        raise InputError(file, found, ", ".join(wanted), HINT)
    return record


def signals_of(system: Any) -> Sequence[Signal]:
    """All signals of a plant or model; none of anything else."""
    return [s for side in ("inputs", "outputs", "states") for s in getattr(system, side, ()) if hasattr(s, "unit")]
