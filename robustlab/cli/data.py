"""``robustlab data``: check, convert and compare measured records; name what a model lacks.

What ``robustlab data discover`` writes: report, result, figures, updated plant.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import SCHEMA, JsonOption, OutOption, emit, note, plant_settings, shares, table
from robustlab.cli.data_validation import validate
from robustlab.errors import EnvironmentFault, NoTrustworthyNumber, UsageError, did_you_mean
from robustlab.units import same_unit

if TYPE_CHECKING:
    from robustlab.identification.comparison.comparison_result import Comparison
    from robustlab.identification.naming.discovery_result import Discovery
    from robustlab.provenance import Provenance
    from robustlab.record import Record

__all__ = [
    "checked_effects",
    "write_discovery",
]


app = typer.Typer(help="Check, convert and compare measured records; name what a model lacks.", no_args_is_help=True)

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
    list[str] | None,
    typer.Option("--unit", help="Unit of a signal's numbers, phi=deg: converted to SI.", show_default=False),
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
    model: Annotated[
        str | None,
        typer.Option("--model", help="Model file or plant: is the record fit for naming?", show_default=False),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Parameter of the plant: NAME=VALUE.", show_default=False)
    ] = None,
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
    Example: robustlab data check run3.csv --model servo-axis
    """
    from robustlab.identification.record_check.suitability import check_record, suitability

    if settings and not model:
        raise UsageError(f"--set {settings[0]}", "no --model", "--model PLANT with it")
    system = _plant_or_model(model, settings or []) if model else None
    record = record_of(
        file,
        group=group,
        dt=dt,
        inputs=inputs or (",".join(_input_names(system)) if system is not None else None),
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
    lines += [f"remark: {text}" for text in found.remarks]
    fit = suitability(system, record) if system is not None else None
    if fit is None:
        emit("data check", found.to_json(), "\n".join(lines), as_json)
        return
    result = {**found.to_json(), "suitability": fit.to_json()}
    emit("data check", result, "\n".join([*lines, fit.summary()]), as_json)
    fit.require()


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

    record = record_of(
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


@app.command()
def compare(
    model: Annotated[str, typer.Argument(help="Model file, or name of a plant (servo-axis).", metavar="MODEL")],
    data: Annotated[str, typer.Argument(help="Record: HDF5, MATLAB, CSV or TXT file.", metavar="DATA")],
    *,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Parameter of the plant: NAME=VALUE.", show_default=False)
    ] = None,
    group: GroupOption = None,
    inputs: Annotated[
        str | None,
        typer.Option("--inputs", "--input", help="Names of the inputs; the model's if left out.", show_default=False),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option("--outputs", "--output", help="Names of the outputs; all others if left out.", show_default=False),
    ] = None,
    dt: DtOption = None,
    clock: ClockOption = None,
    unit: UnitOption = None,
    delimiter: DelimiterOption = None,
    decimal: DecimalOption = ".",
    allow_gaps: GapsOption = False,
    window: Annotated[
        float | None, typer.Option("--window", help="Length of the windows in s.", show_default=False)
    ] = None,
    period: Annotated[
        float | None,
        typer.Option("--period", help="Period of the record in s; found if a signal repeats.", show_default=False),
    ] = None,
    repeat: Annotated[
        list[str] | None,
        typer.Option("--repeat", help="Further record with the same input, for the noise floor.", show_default=False),
    ] = None,
    figures: Annotated[
        str | None, typer.Option("--figures", help="Folder for figures (SVG and PNG).", show_default=False)
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate a model with a recorded input and say where it disagrees with the recorded outputs.

    Example: robustlab data compare servo-axis emps.h5 --group train --outputs q --window 0.48
    """
    from robustlab.identification.comparison.comparison import compare as compare_with
    from robustlab.statespace import as_model

    system = _plant_or_model(model, settings or [])
    first, *others = (
        record_of(
            file,
            group=group,
            dt=dt,
            inputs=inputs or ",".join(as_model(system, model).input_names),
            outputs=outputs,
            clock=clock,
            unit=unit,
            delimiter=delimiter,
            decimal=decimal,
            allow_gaps=allow_gaps,
        )
        for file in (data, *(repeat or []))
    )
    found = compare_with(system, first, window=window, period=period, repeats=others)
    files = [
        *(_draw(found, figures) if figures else []),
        *([_keep(found, out, (model, data, *(repeat or [])))] if out else []),
    ]
    for file in files:
        note(f"wrote {file}")
    emit("data compare", {**found.to_json(series=False), "files": files}, found.summary(), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(NoTrustworthyNumber.exit_code)


@app.command()
def discover(
    model: Annotated[str, typer.Argument(help="Model file, or name of a plant (servo-axis).", metavar="MODEL")],
    data: Annotated[
        list[str], typer.Argument(help="Records of one machine; FILE#GROUP takes that group.", metavar="DATA...")
    ],
    *,
    held_out: Annotated[
        list[str] | None,
        typer.Option("--held-out", help="Record that no fit sees; the gap is judged on it.", show_default=False),
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option("--tolerance", help="Relative tolerance of a parameter: Km=0.05 or Km=5%.", show_default=False),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude", help="Id of an effect not to be tried.", show_default=False)
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Parameter of the plant: NAME=VALUE.", show_default=False)
    ] = None,
    group: GroupOption = None,
    inputs: Annotated[
        str | None,
        typer.Option("--inputs", "--input", help="Names of the inputs; the model's if left out.", show_default=False),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option("--outputs", "--output", help="Names of the outputs; all others if left out.", show_default=False),
    ] = None,
    dt: DtOption = None,
    clock: ClockOption = None,
    unit: UnitOption = None,
    delimiter: DelimiterOption = None,
    decimal: DecimalOption = ".",
    allow_gaps: GapsOption = False,
    window: Annotated[
        float | None, typer.Option("--window", help="Length of the windows in s.", show_default=False)
    ] = None,
    period: Annotated[
        float | None, typer.Option("--period", help="Period of the excitation in s.", show_default=False)
    ] = None,
    repeat: Annotated[
        list[str] | None,
        typer.Option("--repeat", help="Further record with the same input, for the noise floor.", show_default=False),
    ] = None,
    figures: Annotated[
        str | None, typer.Option("--figures", help="Folder for figures (SVG and PNG).", show_default=False)
    ] = None,
    model_out: Annotated[
        str | None, typer.Option("--model-out", help="HDF5 file for the updated plant.", show_default=False)
    ] = None,
    out: Annotated[
        str | None,
        typer.Option("--out", "-o", help="Folder for report, result, figures and updated plant.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Name the effect that a model lacks, from measured records, and update the model with it.

    Exit code 0: the verdict is "named" or "no missing effect"; 4: it is "ambiguous" or "unknown", which the result says
    in full all the same, or the records are too poor for any verdict; 3: a record is wrong.

    Example: robustlab data discover servo-axis emps.h5#train --held-out emps.h5#test --outputs q --out out/emps
    """
    from robustlab.identification.naming.discovery import discover as discover_in

    system = _plant_or_model(model, settings or [])
    names = inputs or ",".join(_input_names(system))

    def records(files: list[str] | None) -> list[Record]:
        return [
            record_of(
                file,
                group=part or group,
                dt=dt,
                inputs=names,
                outputs=outputs,
                clock=clock,
                unit=unit,
                delimiter=delimiter,
                decimal=decimal,
                allow_gaps=allow_gaps,
            )
            for file, part in map(_file_and_group, files or [])
        ]

    found = discover_in(
        system,
        records(data),
        records(held_out) or None,
        tolerances=shares("--tolerance", tolerance),
        window=window,
        period=period,
        repeats=records(repeat),
        exclude=checked_effects(exclude or []),
        progress=note,
    )
    sources = [model, *(_file_and_group(text)[0] for text in (*data, *(held_out or []), *(repeat or [])))]
    result = {"model": model, **found.to_json()}
    files = write_discovery(found, result, sources, out=out, figures=figures, model_out=model_out)
    emit("data discover", {**result, "files": files}, found.summary(), as_json)
    if not found.status.trustworthy:
        note(f"the verdict is {found.verdict!r}: no single name can be vouched for (exit code 4)")
        raise typer.Exit(NoTrustworthyNumber.exit_code)


app.command()(validate)


def _file_and_group(text: str) -> tuple[str, str | None]:
    """``FILE#GROUP``; a file whose own name has a # is taken as it is."""
    from pathlib import Path

    file, mark, group = text.rpartition("#")
    return (file, group) if mark and not Path(text).exists() else (text, None)


def _plant_or_model(name: str, settings: list[str]) -> Any:
    """The plant of that name, or the model in that file."""
    from robustlab.dynamics import plant, plant_names
    from robustlab.storage import load

    if name in plant_names():
        return plant(name, **plant_settings(settings))
    if settings:
        known = ", ".join(plant_names())
        raise UsageError(
            f"--set {settings[0]}", f"{name} is no plant", f"one of {known}", did_you_mean(name, plant_names())
        )
    return load(name)


def _input_names(system: Any) -> list[str]:
    from robustlab.dynamics import Plant
    from robustlab.statespace import as_model

    return [s.name for s in (system if isinstance(system, Plant) else as_model(system)).inputs]


def _draw(found: Comparison, folder: str) -> list[str]:
    from robustlab.report.comparison_figures import comparison_figures
    from robustlab.report.figures import save_figure

    return [
        str(path) for name, figure in comparison_figures(found).items() for path in save_figure(figure, folder, name)
    ]


def _keep(found: Comparison, out: str, sources: tuple[str, ...]) -> str:
    from pathlib import Path

    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage import save

    used = {source: file_sha256(source) for source in sources if Path(source).is_file()}
    return str(save(out, found, Provenance.now("data compare", inputs=used)))


def record_of(file: str, *, group: str | None, dt: float | None, **texts: Any) -> Record:
    """The record that the options of a command describe; ``texts`` are those options as they were typed."""
    from robustlab.record import Record

    inputs, outputs = _names(texts.pop("inputs")), _names(texts.pop("outputs"))
    units = _units(texts.pop("unit") or [])
    record = Record.read(file, group, inputs, outputs, dt, units=units, **texts)
    for name in record.units:
        if name in units and not same_unit(units[name], record.unit(name)):
            note(f"{file}: {name}: converted from {units[name]} to {record.unit(name)}")
    return record


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


PLANT_FILE, EXPERIMENT_FILE = "updated-plant.h5", "next-experiment.csv"


def checked_effects(names: Sequence[str]) -> tuple[str, ...]:
    """The ids; an unknown one is refused with the nearest known one."""
    from robustlab.dynamics.effects.catalogue import effect

    return tuple(effect(name).id for name in names)


def write_discovery(
    found: Discovery,
    result: Mapping[str, Any],
    sources: Sequence[str],
    *,
    out: str | None,
    figures: str | None,
    model_out: str | None,
) -> list[str]:
    """Write what was asked for, with a note for each file; the paths.

    Parameters
    ----------
    result
        What ``--json`` prints, for ``result.json``.
    sources
        Files that were read (names that are no files, such as a plant's, are left out of the provenance).
    out
        Folder for ``report.html``, ``result.json``, ``figures/``, ``updated-plant.h5``, and ``next-experiment.csv``
        where one is proposed.
    """
    from robustlab.provenance import Provenance, file_sha256

    used = {source: file_sha256(source) for source in sources if Path(source).is_file()}
    provenance = Provenance.now("data discover", inputs=used)
    files: list[str] = []
    if figures:
        files += _figures(found, figures)
    if model_out:
        files.append(_plant(found, Path(model_out), provenance))
    if out:
        files += _folder(found, result, Path(out), provenance)
    for file in files:
        note(f"wrote {file}")
    return files


def _figures(found: Discovery, folder: str) -> list[str]:
    from robustlab.report.discovery_figures import discovery_figures
    from robustlab.report.figures import save_figure

    drawn = discovery_figures(found).items()
    return [str(path) for name, figure in drawn for path in save_figure(figure, folder, name)]


def _plant(found: Discovery, path: Path, provenance: Provenance) -> str:
    from robustlab.storage import save

    if found.model is None:
        raise NoTrustworthyNumber(str(path), "there is no updated plant to write")
    return str(save(path, found.model, provenance))


def _folder(found: Discovery, result: Mapping[str, Any], folder: Path, provenance: Provenance) -> list[str]:
    from robustlab.files.atomic import atomic_write
    from robustlab.report.discovery_figures import write_page
    from robustlab.result import plain

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(folder), f"cannot be made ({reason})", "a folder to write results into") from error
    files = [*map(str, write_page(found, folder, provenance))]
    if found.model is not None:
        files.append(_plant(found, folder / PLANT_FILE, provenance))
    if found.next_experiment is not None:
        files.append(str(found.next_experiment.save(folder / EXPERIMENT_FILE)))
    data = {"schema": SCHEMA, "command": "data discover", **plain(result), "provenance": plain(provenance.to_json())}
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False)
    target = folder / "result.json"
    atomic_write(target, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return [*files, str(target)]
