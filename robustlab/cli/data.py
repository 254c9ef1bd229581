"""``robustlab data``: check and convert measured records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import JsonOption, emit, table
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.record import Record

app = typer.Typer(help="Check, convert and compare measured records.", no_args_is_help=True)

FileArgument = Annotated[str, typer.Argument(help="HDF5, MATLAB, CSV or TXT file.", metavar="FILE")]
GroupOption = Annotated[
    str | None, typer.Option("--group", help="HDF5 group or MATLAB struct with the signals.", show_default=False)
]
InputsOption = Annotated[
    str | None, typer.Option("--inputs", help="Names of the inputs: u or u,w.", show_default=False)
]
OutputsOption = Annotated[
    str | None, typer.Option("--outputs", help="Names of the outputs: q or q,v.", show_default=False)
]
DtOption = Annotated[float | None, typer.Option("--dt", help="Sample time in s.", show_default=False)]
ClockOption = Annotated[
    str | None, typer.Option("--clock", help="Signal with the times; t or time if left out.", show_default=False)
]
UnitOption = Annotated[
    list[str] | None, typer.Option("--unit", help="Unit of a signal: NAME=UNIT.", show_default=False)
]
DelimiterOption = Annotated[
    str | None, typer.Option("--delimiter", help="Of a text file: , ; \\t or a blank.", show_default=False)
]
DecimalOption = Annotated[str, typer.Option("--decimal", help="Decimal sign of a text file.")]
GapsOption = Annotated[bool, typer.Option("--allow-gaps", help="Accept a clock with missing samples.")]


@app.command()
def check(
    file: FileArgument,
    *,
    group: GroupOption = None,
    inputs: InputsOption = None,
    outputs: OutputsOption = None,
    dt: DtOption = None,
    clock: ClockOption = None,
    unit: UnitOption = None,
    delimiter: DelimiterOption = None,
    decimal: DecimalOption = ".",
    allow_gaps: GapsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Read a record and say what is in it and what is odd about it.

    Example: robustlab data check run3.csv --inputs u --outputs q
    """
    from robustlab.storage.record_check import check_record

    record = _record(
        file,
        group=group,
        dt=dt,
        inputs=inputs,
        outputs=outputs,
        clock=clock,
        unit=unit,
        delimiter=delimiter,
        decimal=decimal,
        allow_gaps=allow_gaps,
    )
    found = check_record(record)
    clock_line = f"{record.n} samples, {record.duration:.6g} s, dt {record.dt:.6g} s, " + (
        "uniform" if record.is_uniform else "not uniform"
    )
    rows = [
        (c.name, c.side, c.unit or "?", f"{c.least:.6g}", f"{c.greatest:.6g}", f"{c.rms:.6g}") for c in found.channels
    ]
    lines = [f"{record.name}: {clock_line}", table(rows, ("signal", "side", "unit", "least", "greatest", "rms"))]
    emit("data check", found.to_json(), "\n".join([*lines, *(f"remark: {text}" for text in found.remarks)]), as_json)


@app.command()
def convert(
    source: Annotated[str, typer.Argument(help="HDF5, MATLAB, CSV or TXT file.", metavar="IN")],
    target: Annotated[str, typer.Argument(help="HDF5 file to write.", metavar="OUT")],
    *,
    group: GroupOption = None,
    inputs: InputsOption = None,
    outputs: OutputsOption = None,
    dt: DtOption = None,
    clock: ClockOption = None,
    unit: UnitOption = None,
    delimiter: DelimiterOption = None,
    decimal: DecimalOption = ".",
    allow_gaps: GapsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a record as HDF5, format 1.

    Example: robustlab data convert run3.csv run3.h5 --inputs u --outputs q --unit q=rad
    """
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage import save

    record = _record(
        source,
        group=group,
        dt=dt,
        inputs=inputs,
        outputs=outputs,
        clock=clock,
        unit=unit,
        delimiter=delimiter,
        decimal=decimal,
        allow_gaps=allow_gaps,
    )
    save(target, record, Provenance.now("data convert", inputs={source: file_sha256(source)}))
    emit("data convert", {"from": source, "to": target, "samples": record.n}, f"{target}: {record!r}", as_json)


def _record(file: str, *, group: str | None, dt: float | None, **texts: Any) -> Record:
    """The record that the options of a command describe; ``texts`` are those options as they were typed."""
    from robustlab.record import Record

    inputs, outputs = _names(texts.pop("inputs")), _names(texts.pop("outputs"))
    return Record.read(file, group, inputs, outputs, dt, units=_units(texts.pop("unit") or []), **texts)


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _units(settings: list[str]) -> dict[str, str]:
    units = {}
    for text in settings:
        name, equals, unit = text.partition("=")
        if not (name and equals):
            raise UsageError(f"--unit {text}", "no name and unit", "NAME=UNIT")
        units[name] = unit
    return units
