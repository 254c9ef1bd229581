"""``robustlab campaign``: many samples or searches in worker processes, stored one by one, resumed after anything."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, require_trust
from robustlab.cli.members import MetricOptions, UncertainArgument, load_uncertain
from robustlab.cli.offers import one_of
from robustlab.cli.options import JsonOption, SeedOption, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.doors.members import METRICS
from robustlab.errors import EXIT_INTERRUPTED, UsageError

if TYPE_CHECKING:
    from robustlab.campaign import Crew

app = typer.Typer(
    help="Run samples and searches of any size, stored one by one.", no_args_is_help=True, add_completion=False
)

StoreArgument = Annotated[str, typer.Argument(help="Store of a campaign (SQLite).", metavar="STORE")]
BoundOption = Annotated[float | None, typer.Option("--limit", help="Count how often the metric is worse than this.")]


@dataclass(frozen=True)
class PlanOptions:
    """What is computed, and for how many."""

    metric: Annotated[
        str, typer.Option(help="A metric of robustlab worst-case --help.", autocompletion=one_of(*METRICS))
    ] = "peak-deviation"
    n: Annotated[int, typer.Option("-n", "--samples", help="How many samples, vertices or searches.")] = 1000
    kind: Annotated[
        str, typer.Option(help="samples, vertices or search.", autocompletion=one_of("samples", "vertices", "search"))
    ] = "samples"
    seed: SeedOption = 0


@dataclass(frozen=True)
class WorkerOptions:
    """Who computes."""

    workers: Annotated[
        int | None, typer.Option("--workers", "-w", help="Processes on this machine.  [default: one per processor]")
    ] = None
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler whose workers are used, such as tcp://host:8786.")
    ] = None

    def crew(self) -> Crew:
        """Who computes."""
        from robustlab.campaign import Crew

        return Crew(self.workers, self.cluster)


@dataclass(frozen=True)
class ExistingOptions:
    """What becomes of a store that is there already."""

    restart: Annotated[bool, typer.Option("--restart", help="Delete what the store holds and begin anew.")] = False
    fork: Annotated[bool, typer.Option("--fork", help="Keep the store, begin another one beside it.")] = False


@app.command()
@grouped
def run(
    *,
    file: UncertainArgument,
    store: Annotated[str, typer.Option(help="SQLite file to write; an unfinished one is gone on with.")],
    plan: PlanOptions,
    of: MetricOptions,
    starts: Annotated[int, typer.Option(help="For searches: points each one starts from.")] = 64,
    workers: WorkerOptions,
    existing: ExistingOptions,
    bound: BoundOption = None,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Compute a metric for n members of an uncertain model; the same result however often the run is interrupted.

    A sample that raises is lost alone. Exit code 4: more than 1 % are lost, or the worst sample could not be
    confirmed.

    Example: robustlab campaign run motor.h5 --outputs omega --input-value u=42 --t-end 0.1 -n 100000 --store m.sqlite
    """
    from robustlab.campaign import CampaignSettings, run_campaign

    if existing.restart and existing.fork:
        raise UsageError("campaign run", "--restart and --fork", "one of them")
    model = load_uncertain(file)
    settings = CampaignSettings(
        plan.metric,
        plan.n,
        plan.kind,  # pyright: ignore[reportArgumentType]  the settings say which kinds there are
        plan.seed,
        of.output,
        of.from_input,
        of.response.driven(model),
        of.t_end,
        of.points,
        starts=starts,
        band=of.band,
    )
    store_mode = "restart" if existing.restart else "fork" if existing.fork else "resume"
    with _guarded("campaign run", store, plan.n, progress) as advance:
        result = run_campaign(
            model, settings, store, existing=store_mode, crew=workers.crew(),
            limit=bound, progress=advance,
        )  # fmt: skip
    _print("campaign run", result, as_json, {"file": file})


@app.command()
@grouped
def resume(
    *,
    store: StoreArgument,
    workers: WorkerOptions,
    bound: BoundOption = None,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Go on with a campaign where it was interrupted; model and settings are in the store.

    Example: robustlab campaign resume motor.sqlite --workers 2
    """
    from robustlab.campaign import resume_campaign, saved_samples

    with _guarded("campaign resume", store, saved_samples(store)[1], progress) as advance:
        result = resume_campaign(store, crew=workers.crew(), limit=bound, progress=advance)
    _print("campaign resume", result, as_json, {})


@app.command()
def show(store: StoreArgument, bound: BoundOption = None, as_json: JsonOption = False) -> None:
    """Print what a store holds: counts, worst sample, quantiles, lost samples; also while a run writes it.

    Exit code 4 as long as samples are missing.

    Example: robustlab campaign show motor.sqlite --limit 34
    """
    from robustlab.campaign import read_campaign

    _print("campaign show", read_campaign(store, bound), as_json, {})


@app.command()
@grouped
def replay(
    *,
    store: StoreArgument,
    index: Annotated[int, typer.Argument(help="Number of the sample.", min=0)],
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Compute one sample again in this process.

    Example: robustlab campaign replay motor.sqlite 4711
    """
    from robustlab.campaign import replay_sample

    with progress.shown("campaign replay"):
        found = replay_sample(store, index)
    _print("campaign replay", found, as_json, {"store": store})


# --- running ---------------------------------------------------------------------------------------------------------


@contextmanager
def _guarded(command: str, store: str, n: int, progress: ProgressOptions) -> Iterator[Callable[[int], None]]:
    """Takes how many samples were just stored, first those of earlier runs; for Ctrl-C the word of how to go on."""
    saved: list[int] = []
    try:
        with progress.shown(command, n, budgets=False) as display:

            def advance(stored: int) -> None:
                saved.append(stored)
                (display.step if len(saved) > 1 else display.resumed)(sum(saved))

            yield advance
    except KeyboardInterrupt:
        _say_interrupted(store)
        # The parser would turn the interrupt into a bare "interrupted".
        sys.exit(EXIT_INTERRUPTED)


def _say_interrupted(store: str) -> None:
    from robustlab.campaign import saved_samples

    try:
        saved, n = saved_samples(store)
    except rl.RobustlabError:
        note("interrupted before anything was saved")
        return
    note(f"interrupted: {saved} of {n} samples saved; resume with robustlab campaign resume {store}")


def _print(command: str, result: Any, as_json: bool, more: Mapping[str, Any]) -> None:
    emit(command, {**more, **result.to_json()}, result.report(), as_json)
    require_trust(result.status)
