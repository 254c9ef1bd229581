"""``robustlab data``: check, convert and compare measured records; name what a model lacks, or explain it by a set."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.columns import read_beside
from robustlab.cli.console import FIGURE, SCHEMA, emit, note, require_trust, save_figures, table
from robustlab.cli.offers import one_of, plant_or_file
from robustlab.cli.options import (
    EffortOptions,
    JsonOption,
    ModelRecordOptions,
    OutputOptions,
    RecordOptions,
    UncertainRecordOptions,
    assignments,
    grouped,
    shares,
)
from robustlab.cli.plant import plant_or_model, uncertain_or_plant
from robustlab.cli.plots import plot_record
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import (
    EXIT_INTERRUPTED,
    EXIT_REQUIREMENT_NOT_MET,
    EnvironmentFault,
    NoTrustworthyNumber,
    UsageError,
)

if TYPE_CHECKING:
    from robustlab.identification.naming.discovery_result import Discovery
    from robustlab.identification.validation import Validation
    from robustlab.provenance import Provenance

PLANT_FILE, EXPERIMENT_FILE = "updated-plant.h5", "next-experiment.csv"

app = typer.Typer(
    help="Check, convert and compare measured records; name what a model lacks.",
    no_args_is_help=True,
    add_completion=False,
)
app.command("plot")(plot_record)

FileArgument = Annotated[str, typer.Argument(help="HDF5, MATLAB, Parquet, MCAP, CSV or TXT file.", metavar="FILE")]
ModelArgument = Annotated[
    str,
    typer.Argument(help="Model file, name of a plant, or file.py:name.", metavar="MODEL", autocompletion=plant_or_file),
]
DataArgument = Annotated[
    str, typer.Argument(help="Record: HDF5, MATLAB, Parquet, MCAP, CSV or TXT file.", metavar="DATA")
]
SettingsOption = Annotated[list[str] | None, typer.Option("--set", help="Parameter of the plant: NAME=VALUE.")]
FigureOption = Annotated[str | None, typer.Option("--figure", help=FIGURE)]


# --- option groups ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class WindowOptions:
    """How a record is cut, and the records that tell its noise."""

    window: Annotated[float | None, typer.Option(help="Length of the windows in s.")] = None
    period: Annotated[float | None, typer.Option(help="Period of the record in s; found if a signal repeats.")] = None
    repeat: Annotated[
        list[str] | None, typer.Option(help="Further record with the same input, for the noise floor.")
    ] = None


@dataclass(frozen=True)
class ExcitationOptions(WindowOptions):
    """The same where the period is that of an excitation."""

    period: Annotated[float | None, typer.Option(help="Period of the excitation in s.")] = None


@dataclass(frozen=True)
class NamingOptions:
    """What a search for the missing effect may use."""

    held_out: Annotated[list[str] | None, typer.Option(help="Record that no fit sees; the gap is judged on it.")] = None
    tolerance: Annotated[
        list[str] | None, typer.Option(help="Relative tolerance of a parameter: Km=0.05 or Km=5%.")
    ] = None
    exclude: Annotated[list[str] | None, typer.Option(help="Id of an effect not to be tried.")] = None


@dataclass(frozen=True)
class DiscoveryFiles:
    """What a discovery is to write.

    The folder ``out`` gets ``report.html``, ``result.json``, ``figures/``, ``updated-plant.h5``, and
    ``next-experiment.csv`` where one is proposed.
    """

    figure: FigureOption = None
    model_out: Annotated[str | None, typer.Option(help="HDF5 file for the updated plant.")] = None
    out: Annotated[
        str | None, typer.Option("--out", "-o", help="Folder for report, result, figures and updated plant.")
    ] = None

    @property
    def is_asked(self) -> bool:
        """Whether anything is to be written."""
        return bool(self.figure or self.model_out or self.out)

    def write(
        self, found: Discovery, result: Mapping[str, Any], sources: Sequence[str], code: Mapping[str, str]
    ) -> list[str]:
        """Write what was asked for, with a note for each file; the paths.

        ``result``: what ``--json`` prints, for ``result.json``.
        ``sources``: what was read; names that are no files, such as a plant's, are left out of the provenance.
        ``code``: files of code that made the plant, with their hashes.
        """
        provenance = _provenance("data discover", sources, code)
        files: list[str] = []
        if self.figure:
            from robustlab.report.discovery import discovery_figures

            files += save_figures(discovery_figures(found), self.figure)
        if self.model_out:
            files.append(_save_plant(found, Path(self.model_out), provenance))
        if self.out:
            files += _fill_folder(found, result, Path(self.out), provenance)
        _tell(files)
        return files


@dataclass(frozen=True)
class ExplanationOptions:
    """What may explain a record, and what is asked about it."""

    noise: Annotated[list[str] | None, typer.Option(help="Noise bound of an output, in its unit: NAME=VALUE.")] = None
    domain: Annotated[
        str,
        typer.Option(
            help="time, or frequency: whole periods in steady state, line by line.",
            autocompletion=one_of("time", "frequency"),
        ),
    ] = "time"
    period: Annotated[float | None, typer.Option(help="Frequency domain: period in s where no signal tells it.")] = None
    noise_norm: Annotated[
        str | None,
        typer.Option(
            help="What the bound is of: peak or rms (frequency domain: rms).",
            autocompletion=one_of("peak", "rms"),
        ),
    ] = None
    delta: Annotated[
        str,
        typer.Option(
            help="Complex and full blocks are: time-invariant or time-varying.",
            autocompletion=one_of("time-invariant", "time-varying"),
        ),
    ] = "time-invariant"
    at_rest: Annotated[bool, typer.Option("--at-rest", help="The record starts at rest.")] = False
    window: Annotated[float | None, typer.Option(help="Length of windows with a free start in s.")] = None
    per_block: Annotated[bool, typer.Option("--per-block", help="Also the smallest scaling of each block alone.")] = (
        False
    )
    envelope: Annotated[
        int | None,
        typer.Option(
            help="Beside it the cheap test: the envelope of so many members; 20 for sets of constants.", min=0
        ),
    ] = None
    at_most: Annotated[float | None, typer.Option(help="Exit code 1 where gamma is not shown to be at most this.")] = (
        None
    )
    precision: Annotated[float, typer.Option(help="Relative width of the bounds.")] = 0.01


# --- commands --------------------------------------------------------------------------------------------------------


@app.command()
@grouped
def check(
    *,
    file: FileArgument,
    model: Annotated[
        str | None,
        typer.Option(
            help="Model file, plant, file.py:name: is the record fit for naming?", autocompletion=plant_or_file
        ),
    ] = None,
    settings: SettingsOption = None,
    options: RecordOptions,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Read a record and say what is in it and what is odd about it.

    Example: robustlab data check run3.csv --inputs u --outputs q
    Example: robustlab data check run3.csv --model servo-axis
    Example: robustlab data check bag.mcap --inputs u=/command.data --outputs q=/joint_states.position[0]
    """
    from robustlab.identification.record_check.suitability import check_record, suitability

    if settings and not model:
        raise UsageError(f"--set {settings[0]}", "no --model", "--model PLANT with it")
    system = plant_or_model(model, settings or []) if model else None
    with progress.shown("data check"):
        if system is None:
            record = options.read(file, options.inputs, tell=False)
        else:
            record = read_beside(system, options, file, tell=False)
        found = check_record(record)
        fit = suitability(system, record) if system is not None else None
    clock_line = f"{record.n} samples, {record.duration:.6g} s, dt {record.dt:.6g} s, " + (
        "uniform" if record.is_uniform else "not uniform"
    )
    rows = [
        (c.name, c.side, c.unit or "?", f"{c.least:.6g}", f"{c.greatest:.6g}", f"{c.rms:.6g}") for c in found.channels
    ]
    lines = [f"{record.name}: {clock_line}", table(rows, ("signal", "side", "unit", "least", "greatest", "rms"))]
    lines += [f"remark: {text}" for text in found.remarks]
    if fit is None:
        emit("data check", found.to_json(), "\n".join(lines), as_json)
        return
    result = {**found.to_json(), "suitability": fit.to_json()}
    emit("data check", result, "\n".join([*lines, fit.summary()]), as_json)
    fit.require()


@app.command()
@grouped
def convert(
    *,
    source: Annotated[str, typer.Argument(help="HDF5, MATLAB, Parquet, MCAP, CSV or TXT file.", metavar="IN")],
    target: Annotated[str, typer.Argument(help="HDF5 file to write.", metavar="OUT")],
    options: RecordOptions,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Write a record as HDF5, format 1.

    Example: robustlab data convert run3.csv run3.h5 --inputs u --outputs q --unit q=rad
    """
    with progress.shown("data convert"):
        record = options.read(source, options.inputs)
        rl.save(target, record, _provenance("data convert", [source]))
    emit("data convert", {"from": source, "to": target, "samples": record.n}, f"{target}: {record!r}", as_json)


@app.command()
@grouped
def compare(
    *,
    model: ModelArgument,
    data: DataArgument,
    settings: SettingsOption = None,
    options: ModelRecordOptions,
    windows: WindowOptions,
    figure: FigureOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Simulate a model with a recorded input and say where it disagrees with the recorded outputs.

    Example: robustlab data compare servo-axis emps.h5 --group train --outputs q --window 0.48
    Example: robustlab data compare mymachine.py:axis run3.csv --outputs q
    """
    from robustlab.identification.comparison.comparison import Comparison
    from robustlab.provenance import code_of

    system = plant_or_model(model, settings or [])
    repeat = windows.repeat or []
    files: list[str] = []
    with progress.shown("data compare") as report:
        first, *others = (read_beside(system, options, file) for file in (data, *repeat))
        found = rl.compare(system, first, window=windows.window, period=windows.period, repeats=others)
        if figure:
            from robustlab.report.comparison_figures import comparison_figures

            report("figures")
            if not isinstance(found, Comparison):
                raise UsageError("--figure", f"a free run of {found.simulated.name}", "none: it has no windows to draw")
            files += save_figures(comparison_figures(found), figure)
    files += _keep(found, output.out, "data compare", (model, data, *repeat), code_of(system))
    _tell(files)
    emit("data compare", {**found.to_json(series=False), "files": files}, found.summary(), output.as_json)
    require_trust(found.status)


@app.command()
@grouped
def discover(
    *,
    model: ModelArgument,
    data: Annotated[
        list[str], typer.Argument(help="Records of one machine; FILE#GROUP takes that group.", metavar="DATA...")
    ],
    naming: NamingOptions,
    settings: SettingsOption = None,
    options: ModelRecordOptions,
    windows: ExcitationOptions,
    output: DiscoveryFiles,
    details: Annotated[bool, typer.Option("--details", help="Print all that the answer rests on, too.")] = False,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Name the effect that a model lacks, from measured records, and update the model with it.

    Exit code 0: the verdict is "named" or "no missing effect"; 4: it is "ambiguous" or "unknown", which the result says
    in full all the same, or the records are too poor for any verdict; 3: a record is wrong; 130: Ctrl-C ended the
    search, and the result says what was known by then.

    Example: robustlab data discover servo-axis emps.h5#train --held-out emps.h5#test --outputs q --out out/emps
    """
    from robustlab.dynamics.effects.catalogue import effect
    from robustlab.provenance import code_of

    system = plant_or_model(model, settings or [])

    def records(files: list[str] | None) -> list[rl.Record]:
        return [read_beside(system, options, file, group) for file, group in map(_file_and_group, files or [])]

    with progress.shown("data discover", lines=True, budgets=False) as report:
        found = rl.discover(
            system,
            records(data),
            records(naming.held_out) or None,
            tolerances=shares("--tolerance", naming.tolerance),
            window=windows.window,
            period=windows.period,
            repeats=records(windows.repeat),
            exclude=tuple(effect(name).id for name in naming.exclude or []),
            progress=report.listener,
        )
        read = (*data, *(naming.held_out or []), *(windows.repeat or []))
        result = {"model": model, **found.to_json()}
        if output.is_asked:
            report("figures and files")
        files = output.write(found, result, [model, *(_file_and_group(text)[0] for text in read)], code_of(system))
    emit("data discover", {**result, "files": files}, found.summary(details), as_json)
    if found.interrupted:
        note("interrupted: what was known by then is told")
        raise typer.Exit(EXIT_INTERRUPTED)
    if not found.status.trustworthy:
        note(f"the verdict is {found.verdict!r}: no single name can be vouched for (exit code 4)")
    require_trust(found.status)


@app.command()
@grouped
def validate(
    *,
    uncertain: Annotated[
        str,
        typer.Argument(
            help="Uncertain model: HDF5 file, or a plant with tolerances.",
            metavar="UNCERTAIN",
            autocompletion=plant_or_file,
        ),
    ],
    data: DataArgument,
    asked: ExplanationOptions,
    effort: EffortOptions,
    options: UncertainRecordOptions,
    figure: FigureOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Find the smallest scaling of Delta with which an uncertain model could have produced a record.

    Exit code 0: the bounds of gamma are within the precision, or decide whether the set explains the record; 4: they
    decide nothing, or no Delta of any size explains the record; 1: gamma is not shown to be within --at-most.

    Example: robustlab data validate axis.h5 run3.csv --noise q=2e-5
    """
    model, code = uncertain_or_plant(uncertain)
    record = read_beside(model, options, data)
    units = {s.name: s.unit for s in model.outputs}
    words: Any = {key: getattr(asked, key) for key in ("domain", "delta", "period", "at_rest", "window", "per_block")}
    files: list[str] = []
    with progress.shown("data validate", lines=True) as report:
        found = rl.validate(
            model,
            record,
            assignments("--noise", asked.noise, units) if asked.noise else None,
            noise_norm=asked.noise_norm or None,  # pyright: ignore[reportArgumentType]  other words are refused by name
            precision=asked.precision,
            progress=report,
            **words,
            **vars(effort),
        )
        members = asked.envelope
        if members is None:
            members = 20 if all(b.kind == "constant" for b in found.blocks.values()) else 0
        if members or figure:
            report("envelope and figures")
        envelope = _envelope(model, record, members, found) if members else None
        if figure:
            from robustlab.report.set_figures import validation_figures

            files += save_figures(validation_figures(found), figure, "validation-")
    files += _keep(found, output.out, "data validate", (uncertain, data), code)
    _tell(files)
    result: dict[str, Any] = {**found.to_json(series=False), "files": files}
    text = found.summary()
    if envelope is not None:
        result["cover"] = envelope.to_json(series=False)
        text = f"{text}\n{envelope.summary()}"
    emit("data validate", result, text, output.as_json)
    require_trust(found.status)
    if asked.at_most is not None and not found.upper <= asked.at_most:
        note(f"gamma is not shown to be at most {asked.at_most:g} (exit code 1)")
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


# --- reading ---------------------------------------------------------------------------------------------------------


def _file_and_group(text: str) -> tuple[str, str | None]:
    """``FILE#GROUP``; a file whose own name has a # is taken as it is."""
    file, mark, group = text.rpartition("#")
    return (file, group) if mark and not Path(text).exists() else (text, None)


# --- writing ---------------------------------------------------------------------------------------------------------


def _provenance(command: str, sources: Sequence[str], code: Mapping[str, str] | None = None) -> Provenance:
    from robustlab.provenance import Provenance, file_sha256

    used = {source: file_sha256(source) for source in sources if Path(source).is_file()}
    return Provenance.now(command, inputs={**used, **(code or {})})


def _tell(files: Sequence[str]) -> None:
    for file in files:
        note(f"wrote {file}")


def _keep(found: Any, out: str | None, command: str, sources: Sequence[str], code: Mapping[str, str]) -> list[str]:
    """Write a result where a file was named; its path."""
    return [str(rl.save(out, found, _provenance(command, sources, code)))] if out else []


def _envelope(model: Any, record: Any, n: int, found: Validation) -> Any:
    """The cheap test, for sets of constants."""
    from robustlab.identification.comparison.envelope import cover

    peak = found.noise_bound if found.noise_norm == "peak" else {}
    return cover(model, record, n=n, vertices="all" if len(model.blocks) <= 6 else 64, allowance=peak)


def _save_plant(found: Discovery, path: Path, provenance: Provenance) -> str:
    if found.model is None:
        raise NoTrustworthyNumber(str(path), "there is no updated plant to write")
    return str(rl.save(path, found.model, provenance))


def _fill_folder(found: Discovery, result: Mapping[str, Any], folder: Path, provenance: Provenance) -> list[str]:
    from robustlab.files.atomic import atomic_write
    from robustlab.report.discovery import write_page
    from robustlab.result import plain

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(folder), f"cannot be made ({reason})", "a folder to write results into") from error
    files = [*map(str, write_page(found, folder, provenance))]
    if found.model is not None:
        files.append(_save_plant(found, folder / PLANT_FILE, provenance))
    if found.next_experiment is not None:
        files.append(str(found.next_experiment.save(folder / EXPERIMENT_FILE)))
    data = {"schema": SCHEMA, "command": "data discover", **plain(result), "provenance": plain(provenance.to_json())}
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False)
    target = folder / "result.json"
    atomic_write(target, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return [*files, str(target)]
