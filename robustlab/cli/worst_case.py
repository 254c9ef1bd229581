"""``robustlab worst-case``: search the worst member of an uncertain model."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from robustlab.cli.console import (
    EffortOption,
    JsonOption,
    OutOption,
    SeedOption,
    TimeLimitOption,
    assignments,
    emit,
    note,
    table,
)
from robustlab.cli.uncertain import (
    EndOption,
    InputOption,
    PointsOption,
    UncertainArgument,
    load_uncertain,
    times,
    unit_of,
)
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, UsageError

app = typer.Typer(help="Search the worst member of an uncertain model.")

SHOWN_BLOCKS = 40
SHOWN_INFLUENCES = 12


@app.command()
def worst_case(
    file: UncertainArgument,
    metric: Annotated[
        str,
        typer.Option(
            "--metric",
            help="peak-deviation, peak, rms, overshoot, settling-time, hinf, h2, spectral-abscissa, damping, "
            "controllability or hankel.",
        ),
    ] = "peak-deviation",
    output: Annotated[str | None, typer.Option("--output", help="Output to look at.", show_default=False)] = None,
    from_input: Annotated[
        str | None, typer.Option("--from", help="For norms and controllability: input to look from; all if left out.")
    ] = None,
    inputs: InputOption = None,
    t_end: EndOption = None,
    points: PointsOption = 401,
    band: Annotated[float, typer.Option("--band", help="Share of the final value that counts as settled.")] = 0.02,
    n: Annotated[
        int | None,
        typer.Option("-n", "--samples", help="Points that the search starts from (256); with --limit: samples."),
    ] = None,
    seed: SeedOption = 0,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    limit: Annotated[
        str | None,
        typer.Option("--limit", help="Do not search: how probable is it that samples violate this? '0.5 rad'."),
    ] = None,
    probability: Annotated[
        float | None,
        typer.Option("--probability", help="With --limit: show P(violation) at most so large; else exit code 1."),
    ] = None,
    confidence: Annotated[float, typer.Option("--confidence", help="With --limit: confidence of all bounds.")] = 0.95,
    workers: Annotated[int, typer.Option("--workers", help="Threads; the answer does not depend on them.")] = 1,
    figure: Annotated[
        str | None,
        typer.Option("--figure", help="With --limit: folder for figures.", show_default=False),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The worst member that a search over all normalised Delta finds, with its Delta; a lower bound, not a guarantee.

    With --limit the probability that random members violate it, with Clopper-Pearson bounds and what matters for it.

    Example: robustlab worst-case uncertain.h5 --metric peak-deviation --output omega --input u=42 --t-end 0.1
    """
    from robustlab import worst_case_analysis

    if limit is None and (probability is not None or figure is not None):
        raise UsageError("worst-case", "--probability or --figure without --limit", "--limit with its value and unit")
    model = load_uncertain(file)
    options: dict[str, Any] = {
        "output": output,
        "input": from_input,
        "t": None if t_end is None else times(model.dt, t_end, points),
        "u": assignments("--input", inputs, unit_of(model.inputs)) or None,
        "band": band,
        "seed": seed,
        "workers": workers,
    }
    if limit is not None:
        options |= {"probability": probability, "confidence": confidence}
        found = worst_case_analysis.violation_probability(model, metric, limit, n=n, **options)
        _keep(out, found, file, seed)
        _report_violation(file, found, figure, as_json)
        return
    options |= {"effort": effort, "time_limit": time_limit}
    found = worst_case_analysis.worst_case(model, metric, n=256 if n is None else n, **options)
    _keep(out, found, file, seed)
    emit("worst-case", {"file": file, **found.to_json()}, _text(found), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)


def _keep(out: str | None, found: Any, file: str, seed: int) -> None:
    if out is not None:
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage import save

        save(out, found, Provenance.now("worst-case", {file: file_sha256(file)}, seed))


def _report_violation(file: str, found: Any, folder: str | None, as_json: bool) -> None:
    """Print the probability, draw it, and end with the exit code that says whether it was shown."""
    result: dict[str, Any] = {"file": file, **found.to_json()}
    if folder is not None:
        from robustlab.report.figures import save_figure
        from robustlab.report.worst_case_figures import distribution_figure, influence_figure

        paths = [*save_figure(distribution_figure(found), folder, "distribution")]
        if found.influence is not None:
            paths += save_figure(influence_figure(found.influence, found.metric), folder, "influence")
        result["figures"] = [str(path) for path in paths]
    for remark in found.notes:
        note(remark)
    emit("worst-case", result, _violation_text(found), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)
    if found.shown is False:
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


def _violation_text(found: Any) -> str:
    unit = f" {found.unit}" if found.unit else ""
    side = "above" if found.sense > 0 else "below"
    sure = f"{100 * found.confidence:g} %"
    lines = [
        f"{found.metric} {side} {found.limit:.6g}{unit}: {found.violations} of {found.n} samples ({found.label})",
        f"P(violation): {found.lower:.4g} .. {found.upper:.4g} at {sure} confidence (Clopper-Pearson)",
        f"P(violation), one-sided: at most {found.at_most:.4g} at {sure} confidence",
    ]
    if found.unbounded:
        lines.append(f"{found.unbounded} of them have no bounded value (unstable, or not settled)")
    if found.shown is not None:
        word = "shown" if found.shown else "not shown"
        need = f"{found.samples_needed} samples without a violation would do"
        lines.append(f"P(violation) at most {found.wanted:g}: {word} at {sure} ({need})")
    rows = [(f"{100 * q.share:g} %", f"{q.value:.6g}", f"{q.lower:.6g} .. {q.upper:.6g}") for q in found.quantiles]
    lines.append(table(rows, ("quantile", f"value{unit and ' [' + found.unit + ']'}", f"bounds at {sure}")))
    lines.append(f"worst sample: number {found.worst_index}, {found.worst_value:.6g}{unit}; status: {found.status}")
    matter = found.influence
    if matter is not None:
        rows = [
            (
                matter.names[k],
                f"{100 * matter.first_order[k]:.1f} %" if matter.first_order[k] > matter.noise else "-",
                {1: "grows with it", -1: "falls with it", 0: "-"}[int(matter.directions[k])],
                f"{matter.restored[k]:.6g}",
            )
            for k in matter.order[:SHOWN_INFLUENCES]
            if matter.matters[k]
        ]
        if rows:
            lines.append(table(rows, ("what matters", "of the spread", "metric", "worst sample with it nominal")))
    return "\n".join(lines)


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
