"""``robustlab worst-case``: search the worst member of an uncertain model."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from robustlab.cli.console import JsonOption, OutOption, SeedOption, assignments, emit, table
from robustlab.cli.uncertain import (
    EndOption,
    InputOption,
    PointsOption,
    UncertainArgument,
    load_uncertain,
    times,
)

app = typer.Typer(help="Search the worst member of an uncertain model.")

SHOWN_BLOCKS = 40


@app.command()
def worst_case(
    file: UncertainArgument,
    metric: Annotated[
        str, typer.Option("--metric", help="peak-deviation, hinf or spectral-abscissa.")
    ] = "peak-deviation",
    output: Annotated[str | None, typer.Option("--output", help="Output to look at.", show_default=False)] = None,
    from_input: Annotated[
        str | None, typer.Option("--from", help="For hinf: input to look from; all where left out.")
    ] = None,
    inputs: InputOption = None,
    t_end: EndOption = None,
    points: PointsOption = 401,
    n: Annotated[int, typer.Option("-n", "--samples", help="Points of a Latin hypercube to start from.")] = 256,
    seed: SeedOption = 0,
    time_limit: Annotated[float, typer.Option("--time-limit", help="Time limit in s.")] = 60.0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The worst member that a search over all normalised Delta finds, with its Delta; a lower bound, not a guarantee.

    Example: robustlab worst-case uncertain.h5 --metric peak-deviation --output omega --input u=42 --t-end 0.1
    """
    from robustlab import worst_case_analysis

    model = load_uncertain(file)
    found = worst_case_analysis.worst_case(
        model,
        metric,  # pyright: ignore[reportArgumentType]  the function says which names there are
        output=output,
        input=from_input,
        t=None if t_end is None else times(model.dt, t_end, points),
        u=assignments("--input", inputs) or None,
        n=n,
        seed=seed,
        time_limit=time_limit,
    )
    if out is not None:
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage import save

        save(out, found, Provenance.now("worst-case", {file: file_sha256(file)}, seed))
    emit("worst-case", {"file": file, **found.to_json()}, _text(found), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)


def _text(found: Any) -> str:
    unit = f" {found.unit}" if found.unit else ""
    what, _, at_unit = found.location.partition(" ")
    at = f" at {what} = {found.at:.6g} {at_unit.strip('[]')}" if found.at == found.at else ""  # not NaN
    names = list(found.delta)[:SHOWN_BLOCKS]
    rows = [(name, _number(found.delta[name]), _physical(found, name)) for name in names]
    lines = [
        f"{found.metric}: {found.value:.9g}{unit}{at} ({found.label})",
        f"nominal: {found.nominal_value:.9g}{unit}",
        f"status: {found.status}, {found.evaluations} members evaluated",
    ]
    if rows:
        lines.append(table(rows, ("block", "delta", "stands for")))
    if len(found.delta) > len(names):
        lines.append(f"... and {len(found.delta) - len(names)} more blocks (all with --json)")
    return "\n".join(lines)


def _number(value: Any) -> str:
    if getattr(value, "ndim", 0):
        return f"{value.shape[0]} x {value.shape[1]} matrix"
    return f"{value:.6g}"


def _physical(found: Any, name: str) -> str:
    if name not in found.physical:
        return "-"
    value, unit = found.physical[name]
    return f"{value:.6g} {unit}".rstrip()
