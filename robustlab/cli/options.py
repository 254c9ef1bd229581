"""Options that hand-written commands share, and how the file of a record is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import note
from robustlab.cli.offers import one_of, recipe_or_file
from robustlab.errors import InputError, UsageError
from robustlab.units import same_unit

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
ProgressOption = Annotated[
    str,
    typer.Option(
        "--progress", metavar="WORD", help="auto: a bar on terminals; json: JSON lines on stderr; none.",
        autocompletion=one_of("auto", "json", "none"),
    ),
]  # fmt: skip
RecipeArgument = Annotated[
    str,
    typer.Argument(help="A recipe file, or the name of one that comes with robustlab.", autocompletion=recipe_or_file),
]
ChangesOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a value: a top-level key or STEP.KEY; repeatable."),
]
COLUMN = "u=voltage takes the column voltage as u."


def names(text: str) -> list[str]:
    """``"a, b"`` as ``["a", "b"]``."""
    return [part.strip() for part in text.split(",") if part.strip()]


@dataclass(frozen=True)
class RecordOptions:
    """How the file of a record is to be read; the fields are options of every command that reads one."""

    unit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=UNIT", help="Unit that a signal or column is in, phi=deg: converted to SI."),
    ] = None
    delimiter: Annotated[str | None, typer.Option(metavar="SIGN", help="Of a text file: , ; \\t or a blank.")] = None
    decimal: Annotated[str, typer.Option(metavar="SIGN", help="Decimal sign of a text file.")] = "."
    group: Annotated[str | None, typer.Option(metavar="NAME", help="HDF5 group or MATLAB struct.")] = None
    inputs: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help=f"Inputs: u or u,w; beside a model its own if left out. {COLUMN}"),
    ] = None
    outputs: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Outputs likewise, q,i=current; all others if left out.")
    ] = None
    dt: Annotated[float | None, typer.Option(help="Sample time in s.")] = None
    clock: Annotated[str | None, typer.Option(metavar="NAME", help="Signal with the times.")] = None
    allow_gaps: Annotated[bool, typer.Option("--allow-gaps", help="Accept a clock with missing samples.")] = False

    def read(self, file: str, inputs: str | None, group: str | None = None, *, tell: bool = True) -> rl.Record:
        """The record in a file with these inputs, of this group where one is given; conversions are noted."""
        units = {}
        for text in self.unit or []:
            name, equals, unit = text.partition("=")
            if not (name and equals):
                raise UsageError(f"--unit {text}", "no name and unit", "NAME=UNIT")
            units[name] = unit
        wanted, told = (None if text is None else names(text) for text in (inputs, self.outputs))
        record = rl.Record.read(
            file, group or self.group, wanted, told, self.dt, units=units, clock=self.clock,
            delimiter=self.delimiter, decimal=self.decimal, allow_gaps=self.allow_gaps,
        )  # fmt: skip
        for name in record.units:
            if name in units and not same_unit(units[name], record.unit(name)):
                note(f"{file}: {name}: converted from {units[name]} to {record.unit(name)}")
        if tell:
            for line in record.meaning.get("t", "").splitlines():
                note(f"{file}: {line}")
        return record


HINT = "name the columns: --inputs u=COLUMN,... --outputs q=COLUMN,..."


def read_named(options: RecordOptions, system: Any, named: str, files: list[str], remarks: bool) -> rl.Record:
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


def signals_of(system: Any) -> Sequence[rl.Signal]:
    """All signals of a plant or model; none of anything else."""
    return [s for side in ("inputs", "outputs", "states") for s in getattr(system, side, ()) if hasattr(s, "unit")]
