"""Options that commands share, groups of options that a command takes as one object, and how their texts are read.

An option group is a frozen dataclass whose fields are annotated as a command's own parameters are. A command that is
marked with `grouped` takes the group as one parameter, and the parser sees the fields in its place.

Among them is how the file of a record is read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, get_type_hints

import typer

import robustlab as rl
from robustlab.cli.console import note
from robustlab.cli.offers import recipe_or_file
from robustlab.errors import UsageError
from robustlab.units import same_unit

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of the random numbers; same seed, same answer.")]
RecipeArgument = Annotated[
    str,
    typer.Argument(help="A recipe file, or the name of one that comes with robustlab.", autocompletion=recipe_or_file),
]
ChangesOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change a value: a top-level key or STEP.KEY; repeatable."),
]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """The command as the parser sees it: in the place of each option group stand the group's fields.

    A field without an option of its own keeps its default; so a group can leave out what its base class asks for.
    """
    parsed: list[Parameter] = []
    groups: dict[str, tuple[Any, list[str]]] = {}
    hints = get_type_hints(command, include_extras=True)
    for parameter in signature(command).parameters.values():
        kind: Any = hints[parameter.name]
        if not is_dataclass(kind):
            parsed.append(parameter.replace(annotation=kind, kind=Parameter.KEYWORD_ONLY))
            continue
        asked = get_type_hints(kind, include_extras=True)
        members = [field for field in fields(kind) if hasattr(asked[field.name], "__metadata__")]
        groups[parameter.name] = kind, [field.name for field in members]
        for field in members:
            default = Parameter.empty if field.default is MISSING else field.default
            parsed.append(Parameter(field.name, Parameter.KEYWORD_ONLY, default=default, annotation=asked[field.name]))

    @wraps(command)
    def called(**given: Any) -> None:
        made = {
            name: kind(**{field: given.pop(field) for field in members}) for name, (kind, members) in groups.items()
        }
        command(**given, **made)

    called.__signature__ = Signature(parsed)  # pyright: ignore[reportAttributeAccessIssue]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parsed}
    return called


# --- texts of options ------------------------------------------------------------------------------------------------


def names(text: str) -> list[str]:
    """``"a, b"`` as ``["a", "b"]``."""
    return [part.strip() for part in text.split(",") if part.strip()]


@dataclass(frozen=True)
class TableOptions:
    """How a text file is to be read, and in which units its numbers are."""

    unit: Annotated[
        list[str] | None, typer.Option(help="Unit that a signal or column is in, phi=deg: converted to SI.")
    ] = None
    delimiter: Annotated[str | None, typer.Option(help="Of a text file: , ; \\t or a blank.")] = None
    decimal: Annotated[str, typer.Option(help="Decimal sign of a text file.")] = "."

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit."""
        units = {}
        for text in self.unit or []:
            name, equals, unit = text.partition("=")
            if not (name and equals):
                raise UsageError(f"--unit {text}", "no name and unit", "NAME=UNIT")
            units[name] = unit
        return units


COLUMN = "u=voltage takes the column voltage as u."


@dataclass(frozen=True)
class RecordOptions(TableOptions):
    """How the file of a record is to be read."""

    group: Annotated[str | None, typer.Option(help="HDF5 group or MATLAB struct.")] = None
    inputs: Annotated[
        str | None, typer.Option(help=f"Inputs: u or u,w; beside a model its own if left out. {COLUMN}")
    ] = None
    outputs: Annotated[str | None, typer.Option(help="Outputs likewise, q,i=current; all others if left out.")] = None
    dt: Annotated[float | None, typer.Option(help="Sample time in s.")] = None
    clock: Annotated[str | None, typer.Option(help="Signal with the times.")] = None
    allow_gaps: Annotated[bool, typer.Option("--allow-gaps", help="Accept a clock with missing samples.")] = False

    def read(self, file: str, inputs: str | None, group: str | None = None, *, tell: bool = True) -> rl.Record:
        """The record in a file, with these inputs; of this group, where one is given. What was done to it is told."""
        units = self.units
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
