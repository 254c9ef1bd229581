"""``robustlab data validate``: the smallest Delta with which an uncertain model explains a record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from robustlab.cli.console import EffortOption, JsonOption, OutOption, TimeLimitOption, assignments, emit, note
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, InputError, NoTrustworthyNumber

if TYPE_CHECKING:
    from robustlab.identification.validation import Validation

__all__ = ["validate"]


def validate(
    uncertain: Annotated[str, typer.Argument(help="HDF5 file with an uncertain model.", metavar="UNCERTAIN")],
    data: Annotated[str, typer.Argument(help="Record: HDF5, MATLAB, CSV or TXT file.", metavar="DATA")],
    *,
    noise: Annotated[
        list[str] | None,
        typer.Option("--noise", help="Noise bound of an output, in its unit: NAME=VALUE.", show_default=False),
    ] = None,
    domain: Annotated[
        str,
        typer.Option("--domain", help="time, or frequency: whole periods in steady state, line by line."),
    ] = "time",
    period: Annotated[
        float | None, typer.Option("--period", help="Frequency domain: period in s where no signal tells it.")
    ] = None,
    noise_norm: Annotated[
        str | None,
        typer.Option("--noise-norm", help="What the bound is of: peak or rms (frequency domain: rms).", metavar="NORM"),
    ] = None,
    delta: Annotated[
        str,
        typer.Option("--delta", help="Complex and full blocks are: time-invariant or time-varying.", metavar="KIND"),
    ] = "time-invariant",
    at_rest: Annotated[bool, typer.Option("--at-rest", help="The record starts at rest.")] = False,
    window: Annotated[
        float | None, typer.Option("--window", help="Length of windows with a free start in s.", show_default=False)
    ] = None,
    per_block: Annotated[
        bool, typer.Option("--per-block", help="Also the smallest scaling of each block alone.")
    ] = False,
    cover: Annotated[
        int | None,
        typer.Option(
            "--cover",
            help="Beside it the cheap test: the envelope of so many members; 20 for sets of constants.",
            min=0,
        ),
    ] = None,
    at_most: Annotated[
        float | None, typer.Option("--at-most", help="Exit code 1 where gamma is not shown to be at most this.")
    ] = None,
    precision: Annotated[float, typer.Option("--precision", help="Relative width of the bounds.")] = 0.01,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    group: Annotated[
        str | None, typer.Option("--group", help="HDF5 group or MATLAB struct with the signals.", show_default=False)
    ] = None,
    outputs: Annotated[
        str | None, typer.Option("--outputs", "--output", help="Names of the outputs.", show_default=False)
    ] = None,
    dt: Annotated[float | None, typer.Option("--dt", help="Sample time in s.", show_default=False)] = None,
    clock: Annotated[str | None, typer.Option("--clock", help="Signal with the times.", show_default=False)] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option("--unit", help="Unit of a signal's numbers, phi=deg: converted to SI.", show_default=False),
    ] = None,
    delimiter: Annotated[
        str | None, typer.Option("--delimiter", help="Of a text file: , ; \\t or a blank.", show_default=False)
    ] = None,
    decimal: Annotated[str, typer.Option("--decimal", help="Decimal sign of a text file.")] = ".",
    figures: Annotated[
        str | None, typer.Option("--figures", help="Folder for figures (SVG and PNG).", show_default=False)
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the smallest scaling of Delta with which an uncertain model could have produced a record.

    Exit code 0: the bounds of gamma are within the precision, or decide whether the set explains the record; 4: they
    decide nothing, or no Delta of any size explains the record; 1: gamma is not shown to be within --at-most.

    Example: robustlab data validate axis.h5 run3.csv --noise q=2e-5
    """
    from robustlab.cli.data import record_of
    from robustlab.identification.validation import validate as validate_with
    from robustlab.storage import load
    from robustlab.uncertainty.lft import UncertainModel

    model = load(uncertain)
    if not isinstance(model, UncertainModel):
        raise InputError(uncertain, f"a {type(model).__name__}", "an uncertain model", "robustlab uncertain build")
    record = record_of(
        data,
        group=group,
        dt=dt,
        inputs=",".join(s.name for s in model.inputs),
        outputs=outputs,
        clock=clock,
        unit=unit,
        delimiter=delimiter,
        decimal=decimal,
        allow_gaps=False,
    )
    norms: dict[str, Literal["peak", "rms"]] = {"peak": "peak", "rms": "rms"}
    domains: dict[str, Literal["time", "frequency"]] = {"time": "time", "frequency": "frequency"}
    kinds: dict[str, Literal["time-invariant", "time-varying"]] = {
        "time-invariant": "time-invariant",
        "time-varying": "time-varying",
    }
    found = validate_with(
        model,
        record,
        assignments("--noise", noise, {s.name: s.unit for s in model.outputs}) if noise else None,
        domain=domains.get(domain, domain),  # pyright: ignore[reportArgumentType] refused there by name
        period=period,
        noise_norm=norms.get(noise_norm, noise_norm) if noise_norm else None,  # pyright: ignore[reportArgumentType]
        delta=kinds.get(delta, delta),  # pyright: ignore[reportArgumentType]
        at_rest=at_rest,
        window=window,
        per_block=per_block,
        precision=precision,
        time_limit=time_limit,
        effort=effort,
        progress=note,
    )
    members = (20 if all(b.kind == "constant" for b in found.blocks.values()) else 0) if cover is None else cover
    envelope = _envelope(model, record, members, found) if members else None
    files = [*(_draw(found, figures) if figures else []), *([_keep(found, out, (uncertain, data))] if out else [])]
    for file in files:
        note(f"wrote {file}")
    result: dict[str, Any] = {**found.to_json(series=False), "files": files}
    text = found.summary()
    if envelope is not None:
        result["cover"] = envelope.to_json(series=False)
        text = f"{text}\n{envelope.summary()}"
    emit("data validate", result, text, as_json)
    if not found.status.trustworthy:
        raise typer.Exit(NoTrustworthyNumber.exit_code)
    if at_most is not None and not found.upper <= at_most:
        note(f"gamma is not shown to be at most {at_most:g} (exit code 1)")
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


def _envelope(model: Any, record: Any, n: int, found: Validation) -> Any:
    """The cheap test, for sets of constants."""
    from robustlab.identification.comparison.envelope import cover

    peak = found.noise_bound if found.noise_norm == "peak" else {}
    return cover(model, record, n=n, vertices="all" if len(model.blocks) <= 6 else 64, allowance=peak)


def _draw(found: Validation, folder: str) -> list[str]:
    from robustlab.report.figures import save_figure
    from robustlab.report.validation_figures import validation_figures

    return [
        str(path)
        for name, figure in validation_figures(found).items()
        for path in save_figure(figure, folder, f"validation-{name}")
    ]


def _keep(found: Validation, out: str, sources: tuple[str, ...]) -> str:
    from pathlib import Path

    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage import save

    used = {source: file_sha256(source) for source in sources if Path(source).is_file()}
    return str(save(out, found, Provenance.now("data validate", inputs=used)))
