"""How commands read the file of a record: option groups, alone, beside a model, and beside an uncertain model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from robustlab.cli.console import note
from robustlab.cli.options import names
from robustlab.errors import UsageError
from robustlab.units import same_unit

if TYPE_CHECKING:
    from robustlab.record import Record

__all__ = ["ModelRecordOptions", "RecordOptions", "TableOptions", "UncertainRecordOptions"]


@dataclass(frozen=True)
class TableOptions:
    """How a text file is to be read, and in which units its numbers are."""

    unit: Annotated[
        list[str] | None,
        typer.Option(
            "--unit", help="Unit that a signal or column is in, phi=deg: converted to SI.", show_default=False
        ),
    ] = None
    delimiter: Annotated[
        str | None, typer.Option("--delimiter", help="Of a text file: , ; \\t or a blank.", show_default=False)
    ] = None
    decimal: Annotated[str, typer.Option("--decimal", help="Decimal sign of a text file.")] = "."

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


@dataclass(frozen=True)
class RecordOptions(TableOptions):
    """How the file of a record is to be read."""

    group: Annotated[
        str | None, typer.Option("--group", help="HDF5 group, MATLAB struct or topic of a bag.", show_default=False)
    ] = None
    inputs: Annotated[
        str | None,
        typer.Option("--inputs", help="Inputs: u or u,w; u=SIGNAL renames.", show_default=False),
    ] = None
    outputs: Annotated[
        str | None, typer.Option("--outputs", help="Names of the outputs: q or q,v.", show_default=False)
    ] = None
    dt: Annotated[float | None, typer.Option("--dt", help="Sample time in s.", show_default=False)] = None
    clock: Annotated[
        str | None,
        typer.Option("--clock", help="Signal with the times; of a bag: stamp or log.", show_default=False),
    ] = None
    allow_gaps: Annotated[bool, typer.Option("--allow-gaps", help="Accept a clock with missing samples.")] = False

    def read(self, file: str, inputs: str | None, group: str | None = None, *, tell: bool = True) -> Record:
        """The record in a file, with these inputs; of this group, where one is given. What was done to it is told."""
        from robustlab.record import Record

        units = self.units
        wanted, told = (None if text is None else names(text) for text in (inputs, self.outputs))
        record = Record.read(
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


@dataclass(frozen=True)
class ModelRecordOptions(RecordOptions):
    """The same beside a model, which knows its inputs."""

    inputs: Annotated[
        str | None,
        typer.Option("--inputs", "--input", help="Names of the inputs; the model's if left out.", show_default=False),
    ] = None
    outputs: Annotated[
        str | None,
        typer.Option("--outputs", "--output", help="Names of the outputs; all others if left out.", show_default=False),
    ] = None


@dataclass(frozen=True)
class UncertainRecordOptions(RecordOptions):
    """The same beside an uncertain model, whose inputs the record must have; gaps are refused."""

    inputs: None = None
    outputs: Annotated[
        str | None, typer.Option("--outputs", "--output", help="Names of the outputs.", show_default=False)
    ] = None
    clock: Annotated[str | None, typer.Option("--clock", help="Signal with the times.", show_default=False)] = None
    allow_gaps: bool = False
