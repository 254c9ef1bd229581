"""``robustlab worst-case``: search the worst member of an uncertain model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, emit, note, require_trust, save_figures, table
from robustlab.cli.members import MetricOptions, UncertainArgument, delta_lines, load_uncertain, place
from robustlab.cli.offers import METRICS, one_of
from robustlab.cli.options import EffortOption, OutputOptions, SeedOption, TimeLimitOption, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, UsageError

app = typer.Typer(help="Search the worst member of an uncertain model.", add_completion=False)

SHOWN_INFLUENCES = 12


@dataclass(frozen=True)
class SearchOptions:
    """How much is tried."""

    n: Annotated[
        int | None,
        typer.Option("-n", "--samples", help="Points that the search starts from (256); with --limit: samples."),
    ] = None
    seed: SeedOption = 0
    effort: EffortOption = 1.0
    time_limit: TimeLimitOption = None


@dataclass(frozen=True)
class LimitOptions:
    """The limit whose violation is judged in the place of a search."""

    limit: Annotated[
        str | None, typer.Option(help="Do not search: how probable is it that samples violate this? '0.5 rad'.")
    ] = None
    probability: Annotated[
        float | None, typer.Option(help="With --limit: show P(violation) at most so large; else exit code 1.")
    ] = None
    confidence: Annotated[float, typer.Option(help="With --limit: confidence of all bounds.")] = 0.95


@app.command()
@grouped
def worst_case(
    *,
    file: UncertainArgument,
    metric: Annotated[
        str,
        typer.Option(
            help="peak-deviation, peak, rms, overshoot, settling-time, hinf, h2, spectral-abscissa, damping, "
            "controllability or hankel.",
            autocompletion=one_of(*METRICS),
        ),
    ] = "peak-deviation",
    of: MetricOptions,
    search: SearchOptions,
    judged: LimitOptions,
    workers: Annotated[int, typer.Option(help="Threads; the answer does not depend on them.")] = 1,
    figure: Annotated[str | None, typer.Option(help=f"With --limit: {FIGURE}")] = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """The worst member that a search over all normalised Delta finds, with its Delta; a lower bound, not a guarantee.

    With --limit the probability that random members violate it, with Clopper-Pearson bounds and what matters for it.

    Example: robustlab worst-case uncertain.h5 --metric peak-deviation --outputs omega --input-value u=42 --t-end 0.1
    """
    from robustlab import worst_case_analysis

    if judged.limit is None and (judged.probability is not None or figure is not None):
        raise UsageError("worst-case", "--probability or --figure without --limit", "--limit with its value and unit")
    model = load_uncertain(file)
    options: dict[str, Any] = {
        "output": of.output,
        "input": of.from_input,
        "t": of.response.times(model),
        "u": of.response.driven(model),
        "band": of.band,
        "seed": search.seed,
        "workers": workers,
    }
    if judged.limit is not None:
        options |= {"n": search.n, "probability": judged.probability, "confidence": judged.confidence}
        with progress.shown("worst-case"):
            found = worst_case_analysis.violation_probability(model, metric, judged.limit, **options)
        _keep(output.out, found, file, search.seed)
        _report_violation(file, found, figure, output.as_json)
        return
    options |= {"n": 256 if search.n is None else search.n, "effort": search.effort, "time_limit": search.time_limit}
    with progress.shown("worst-case"):
        found = worst_case_analysis.worst_case(model, metric, **options)
    _keep(output.out, found, file, search.seed)
    emit("worst-case", {"file": file, **found.to_json()}, _text(found), output.as_json)
    require_trust(found.status)


def _keep(out: str | None, found: Any, file: str, seed: int) -> None:
    if out is not None:
        from robustlab.provenance import Provenance, file_sha256

        rl.save(out, found, Provenance.now("worst-case", {file: file_sha256(file)}, seed))


def _report_violation(file: str, found: Any, figure: str | None, as_json: bool) -> None:
    """Print the probability, draw it, and end with the exit code that says whether it was shown."""
    result: dict[str, Any] = {"file": file, **found.to_json()}
    if figure is not None:
        from robustlab.report.robustness_figures import distribution_figure, influence_figure

        figures = {"distribution": distribution_figure(found)}
        if found.influence is not None:
            figures["influence"] = influence_figure(found.influence, found.metric)
        result["figures"] = save_figures(figures, figure)
    for remark in found.notes:
        note(remark)
    emit("worst-case", result, _violation_text(found), as_json)
    require_trust(found.status)
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
    return "\n".join(
        [
            f"{found.metric}: {found.value:.9g}{unit}{place(found.at, found.location)} ({found.label})",
            f"nominal: {found.nominal_value:.9g}{unit}",
            f"status: {found.status}, {found.evaluations} members evaluated",
            *delta_lines(found.delta, found.physical),
        ]
    )
