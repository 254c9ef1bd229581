"""Options that hand-written commands share, and the reading of a record's file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.completion import one_of, recipe_or_file
from robustlab.cli.console import note
from robustlab.errors import InputError, UsageError
from robustlab.operations.kinds import comma_separated
from robustlab.units import same_unit

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
ProgressOption = Annotated[
    str,
    typer.Option(
        "--progress", metavar="WORD", help="auto: a bar on terminals; none.", autocompletion=one_of("auto", "none"),
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


@dataclass(frozen=True)
class RecordOptions:
    """Options of reading a record's file, of every command that reads one."""

    unit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=UNIT", help="Unit that a signal or column is in, phi=deg: converted to SI."),
    ] = None
    delimiter: Annotated[str | None, typer.Option(metavar="SIGN", help="Of a text file: , ; \\t or a blank.")] = None
    decimal: Annotated[str, typer.Option(metavar="SIGN", help="Decimal sign of a text file.")] = "."
    group: Annotated[str | None, typer.Option(metavar="NAME", help="HDF5 group or MATLAB struct.")] = None
    inputs: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help=f"Inputs: u or u,w; with a model its own if left out. {COLUMN}"),
    ] = None
    outputs: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Outputs likewise, q,i=current; all others if left out.")
    ] = None
    dt: Annotated[float | None, typer.Option(help="Sample time in s.")] = None
    clock: Annotated[str | None, typer.Option(metavar="NAME", help="Signal with the times.")] = None
    allow_gaps: Annotated[bool, typer.Option("--allow-gaps", help="Accept a clock with missing samples.")] = False

    def read(self, file: str, inputs: str | None, group: str | None = None, *, remarks: bool = True) -> rl.Record:
        """Return the record in a file with these inputs and of this group; note conversions of units."""
        units = {}
        for text in self.unit or []:
            name, equals, unit = text.partition("=")
            if not (name and equals):
                raise UsageError(f"--unit {text}", "no name and unit", "NAME=UNIT")
            units[name] = unit
        taken, kept = (None if text is None else comma_separated(text) for text in (inputs, self.outputs))
        record = rl.Record.read(
            file, group or self.group, taken, kept, self.dt, units=units, clock=self.clock,
            delimiter=self.delimiter, decimal=self.decimal, allow_gaps=self.allow_gaps,
        )  # fmt: skip
        for name in record.units:
            if name in units and not same_unit(units[name], record.unit(name)):
                note(f"{file}: {name}: converted from {units[name]} to {record.unit(name)}")
        if remarks:
            for line in record.meaning.get("t", "").splitlines():
                note(f"{file}: {line}")
        return record


HINT = "name the columns: --inputs u=COLUMN,... --outputs q=COLUMN,..."


def read_named(options: RecordOptions, system: Any, named: str, files: list[str], remarks: bool) -> rl.Record:
    """Return the record ``FILE`` or ``FILE#GROUP``, with the columns of a model where there is one.

    The file is added to ``files``. A # may be part of a file's own name.
    """
    from robustlab.statespace import as_model

    file, mark, group = named.rpartition("#")
    if not mark or Path(named).exists():
        file, group = named, None
    files.append(file)
    if system is None:
        return options.read(file, options.inputs, group, remarks=remarks)
    model = system if hasattr(system, "inputs") else as_model(system)
    inputs = options.inputs or ",".join(s.name for s in model.inputs)
    try:
        record = options.read(file, inputs, group, remarks=remarks)
    except InputError as error:
        if options.inputs is None and error.found.startswith("missing "):
            error.hint = HINT
        raise
    wanted = [s.name for s in model.outputs]
    if options.outputs is None and wanted and not set(wanted) & set(record.outputs):
        found = f"no output of the model among {', '.join(record.outputs) or 'none'}"
        raise InputError(file, found, ", ".join(wanted), HINT)
    return record


def units_of(system: Any, side: str) -> dict[str, str]:
    """Return the units of the parameters of a plant, or of all signals of a plant or model; none of anything else."""
    if side == "parameters":
        return {p.name: p.unit for p in getattr(system, "parameters", {}).values()}
    every = (s for side in ("inputs", "outputs", "states") for s in getattr(system, side, ()))
    return {s.name: s.unit for s in every if hasattr(s, "unit")}
