"""Options that hand-written commands share, and how the file of a record is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

import robustlab as rl
from robustlab.cli.console import note
from robustlab.cli.offers import one_of, recipe_or_file
from robustlab.errors import UsageError
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
