"""Operations on the members of an uncertain model: worst case, violation probability, samples, campaigns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.common_parameters import Seed, Uncertain
from robustlab.operations.declaration import InLoop, operation, public
from robustlab.operations.parameter_types import Choice, Keyed, Kind, Names, Number, Table, TextFile, Whole

METRICS = (
    "peak-deviation", "peak", "rms", "overshoot", "settling-time", "hinf", "h2", "spectral-abscissa", "damping",
)  # fmt: skip
Metric = Annotated[str, Choice(METRICS), "What is judged."]
Output = Annotated[str | None, Names("outputs", one=True, option="--outputs"), "The output, where there are several."]
FromInput = Annotated[
    str | None, Names("inputs", one=True, option="--inputs"), "For norms: the input; all if left out."
]
Drive = Annotated[
    dict[str, Any] | None,
    Table(Number(), "inputs", argument="u", option="--input-value"),
    "Constant input, u=42 or u=42V; repeatable. A unit step on the only input where left out.",
]
Sine = Annotated[dict[str, Any] | None, Table(Number(), "inputs"), "Amplitude of a sine on an input, likewise."]
Frequency = Annotated[float | None, Number("Hz", above=0, option="--sine-frequency"), "Of the sine, in Hz."]
End = Annotated[float | None, Number("s", above=0), "End time in s; from the nominal poles if left out."]
Points = Annotated[int, Whole(2, 100_000), "Number of times, where an end is given."]


@dataclass(frozen=True)
class Judged:
    """The metric of a member."""

    metric: Metric = "peak-deviation"
    output: Output = None
    from_input: FromInput = None

    @property
    def options(self) -> dict[str, Any]:
        return {"output": self.output, "input": self.from_input}


@dataclass(frozen=True)
class Excitation:
    """The input of the members: steps plus sines on the named inputs, until an end."""

    input: Drive = None
    sine: Sine = None
    frequency: Frequency = None
    t_end: End = None
    points: Points = 401

    def of(self, uncertain: Any) -> dict[str, Any]:
        import numpy as np

        if not isinstance(uncertain, rl.UncertainModel):
            raise InputError("members", f"a {type(uncertain).__name__}", "an uncertain model")
        if bool(self.sine) != (self.frequency is not None):
            raise UsageError("sine", "one of sine and frequency", "both: sine and frequency belong together")
        steps, sines, dt, t_end = self.input or {}, self.sine or {}, uncertain.dt, self.t_end
        if t_end is None:
            if sines:
                raise UsageError("sine", "no end time", "t_end")
            return {"t": None, "u": steps or None}
        if not 0 < t_end < float("inf") or self.points < 2:
            raise UsageError("t_end", f"{t_end:g} with {self.points} points", "a positive time and at least 2 points")
        t = np.arange(round(t_end / dt) + 1) * dt if dt else np.linspace(0.0, t_end, self.points)
        if self.frequency is None:
            return {"t": t, "u": steps or None}
        wave = np.sin(2 * np.pi * self.frequency * t)
        u = {name: steps.get(name, 0.0) + sines.get(name, 0.0) * wave for name in {**steps, **sines}}
        return {"t": t, "u": u, "hold": "foh"}


@operation(
    "worst-case", "worst-case", result="worst_case_analysis.worst_case_search.WorstCase",
    public="worst_case_analysis.worst_case_search.worst_case", kinds={"n": Whole(1, 100_000, option="-n,--samples")},
)  # fmt: skip
def worst_case(uncertain: Uncertain, *, judged: Judged, drive: Excitation, **options: Any) -> Any:
    """The worst member that a search over all normalised Delta finds, with its Delta; a lower bound, not a guarantee.

    Example: robustlab worst-case uncertain.h5 --metric peak-deviation --outputs omega --input-value u=42 --t-end 0.1
    """
    return rl.worst_case(uncertain, judged.metric, **judged.options, **drive.of(uncertain), **options)


@operation(
    "violation-probability", "violation-probability", result="worst_case_analysis.statistics.ViolationProbability",
    public="worst_case_analysis.statistics.violation_probability",
    kinds={
        "probability": (
            Number(above=0, below=1), "Largest P(violation) allowed; exit code 1 if the samples do not confirm it."
        ),
        "n": Whole(1, 10_000_000, option="-n,--samples"),
    },
)  # fmt: skip
def violation_probability(
    uncertain: Uncertain,
    *,
    limit: Annotated[Any, Keyed(float), "Limit whose violations are counted, such as '0.5 rad'."],
    judged: Judged,
    unit: Annotated[str | None, Kind(only="step"), "Unit of the limit, which must be that of the metric."] = None,
    drive: Excitation,
    **options: Any,
) -> Any:
    """Probability that random members violate a limit of a metric, with Clopper-Pearson bounds and relevant parameters.

    The parameters are assumed independent and uniform in their ranges.

    Example: robustlab violation-probability set.h5 --limit "9 rad/s" --outputs omega --input-value u=42 --t-end 0.1
    """
    given = limit if unit is None else f"{limit!r} {unit}"
    driven = drive.of(uncertain)
    return rl.violation_probability(uncertain, judged.metric, given, **judged.options, **driven, **options)


# --- samples and campaigns --------------------------------------------------------------------------------------------


@operation("uncertain show", result="uncertainty.lft.UncertainModel")
def show(uncertain: Uncertain) -> Any:
    """The blocks, signals and nominal stability of an uncertain model.

    Example: robustlab uncertain show uncertain.h5
    """
    nominal = uncertain.nominal
    return InLoop(uncertain, extras={"nominal": nominal, "nominal_spectral_abscissa": nominal.spectral_abscissa()})


class Vertices(Whole):
    """A number of vertices; in a command also ``all``."""

    taken = str

    def read(self, option: str, given: Any) -> Any:
        if given != "all" and not given.isdecimal():
            raise UsageError(option, given, "a whole number, or all")
        return given if given == "all" else int(given)


@operation("uncertain sample", "sample", result="worst_case_analysis.sampling.Responses")
def sample(
    uncertain: Uncertain,
    *,
    n: Annotated[int, Whole(0, 1_000_000, option="-n,--samples"), "Number of random samples."] = 20,
    seed: Seed = 0,
    vertices: Annotated[Any, Vertices(), "Vertices to add: a number, or all."] = 0,
    drive: Excitation,
    outputs: Annotated[list[str] | None, Names("outputs", only="step"), "All where left out."] = None,
) -> Any:
    """Time responses of random members and vertices: nominal, envelope, and the sample farthest from nominal.

    Example: robustlab uncertain sample uncertain.h5 -n 20 --seed 1 --vertices all --input-value u=42 --t-end 0.1
    """
    from robustlab.dynamics.simulation import default_clock

    driven = drive.of(uncertain)
    if driven["t"] is None:
        driven["t"] = default_clock(uncertain.nominal, "uncertain sample")
    members = rl.sample(uncertain.select(None, outputs) if outputs else uncertain, n, seed, vertices)
    return InLoop(members.respond(**driven), extras={"seed": seed, "vertices": members.vertices})


RESULT, STORE = "campaign.runs.CampaignResult", "Store of a campaign (SQLite)."
Store = Annotated[str, TextFile(), STORE]
Bound = Annotated[float | None, Number(), "Count how often the metric is worse than this."]


Workers = Annotated[
    int | None, Whole(1, 1024, option="--workers,-w"), "Processes on this machine; one per processor where left out."
]
Cluster = Annotated[str | None, "Dask scheduler whose workers are used, such as tcp://host:8786."]


@contextmanager
def _counted(progress: Any, store: str, n: int) -> Iterator[Any]:
    """Yield a counter of stored samples, those of earlier runs first; report how to resume after Ctrl-C."""
    from robustlab.campaign import saved_samples

    saved, progress.total = 0, n

    def advance(stored: int) -> None:
        nonlocal saved
        saved += stored
        progress.step(saved)

    try:
        yield advance
    except KeyboardInterrupt:
        try:
            done, n = saved_samples(store)
        except rl.RobustlabError:
            raise KeyboardInterrupt("interrupted before anything was saved") from None
        words = f"interrupted: {done} of {n} samples saved; resume with robustlab campaign resume {store}"
        raise KeyboardInterrupt(words) from None


@operation("campaign run", result=RESULT, progress="steps")
def campaign(
    uncertain: Uncertain,
    *,
    store: Annotated[str, TextFile(option="--store"), "SQLite file to write; an unfinished one is continued."],
    judged: Judged,
    drive: Excitation,
    n: Annotated[int, Whole(1, 10**9, option="-n,--samples"), "Number of samples, vertices or searches."] = 1000,
    kind: Annotated[Literal["samples", "vertices", "search"], "What is drawn."] = "samples",
    starts: Annotated[int, Whole(1), "For searches: points each one starts from."] = 64,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: Cluster = None,
    restart: Annotated[bool, "Delete the content of the store and start again."] = False,
    limit: Bound = None,
    progress: Any = None,
) -> Any:
    """Compute a metric for n members of an uncertain model; the same result however often the run is interrupted.

    A sample that raises is lost, the others are kept. Exit code 4: more than 1 % are lost, or the worst sample could
    not be confirmed.

    Example: robustlab campaign run motor.h5 --outputs omega --input-value u=42 --t-end 0.1 -n 100000 --store m.sqlite
    """
    from robustlab.campaign import CampaignSettings, WorkerOptions, run_campaign

    u, hold = drive.of(uncertain)["u"], "zoh"
    if drive.sine:  # not a constant: sample by sample
        u, hold = {name: values.tolist() for name, values in u.items()}, "foh"
    settings = CampaignSettings(
        judged.metric, n, kind, seed, judged.output, judged.from_input, u, drive.t_end, drive.points, hold,
        starts=starts,
    )  # fmt: skip
    with _counted(progress, store, n) as advance:
        return run_campaign(
            uncertain, settings, store, existing="restart" if restart else "resume",
            workers=WorkerOptions(workers, cluster), limit=limit, progress=advance,
        )  # fmt: skip


@operation("campaign resume", result=RESULT, progress="steps")
def resume(
    store: Store, *, workers: Workers = None, cluster: Cluster = None, limit: Bound = None, progress: Any = None
) -> Any:
    """Continue an interrupted campaign; model and settings are in the store.

    Example: robustlab campaign resume motor.sqlite --workers 2
    """
    from robustlab.campaign import WorkerOptions, resume_campaign, saved_samples

    with _counted(progress, store, saved_samples(store)[1]) as advance:
        return resume_campaign(store, workers=WorkerOptions(workers, cluster), limit=limit, progress=advance)


public(
    "campaign.runs.read_campaign", "campaign show", result=RESULT, kinds={"store": Store, "limit": Bound},
    text="""Exit code 4 as long as samples are missing.

Example: robustlab campaign show motor.sqlite --limit 34""",
)  # fmt: skip
