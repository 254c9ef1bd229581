"""Doors of what drives the members of an uncertain model: worst case, probability of a violation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.doors.declaration import Named, door
from robustlab.doors.kinds import Choice, Kind, Names, Number, Quantity, Table, Whole, in_units
from robustlab.doors.words import Search, Seed, Uncertain
from robustlab.errors import InputError, UnitMismatch, UsageError

METRICS = (
    "peak-deviation", "peak", "rms", "overshoot", "settling-time", "hinf", "h2", "spectral-abscissa", "damping",
)  # fmt: skip
OF_A_RESPONSE = METRICS[:5]

Of = Annotated[Uncertain, Named(key="of")]
Metric = Annotated[str, Choice(METRICS), "What is judged."]
Output = Annotated[
    str | None, Names("outputs", one=True), "The one output to look at.", Named(option="--outputs", key="output")
]
FromInput = Annotated[
    str | None,
    Names("inputs", one=True),
    "For norms: the one input to look from; all if left out.",
    Named(option="--inputs", key="from_input"),
]
Drive = Annotated[
    dict[str, Any] | None,
    Table(Quantity(), "inputs"),
    "Constant input, u=42 or u=42V; repeatable. A unit step on the only input where left out.",
    Named(argument="u", option="--input-value"),
]
Sine = Annotated[dict[str, Any] | None, Table(Quantity(), "inputs"), "Amplitude of a sine on an input, likewise."]
Frequency = Annotated[float | None, Number("Hz", above=0), "Of the sine, in Hz.", Named(option="--sine-frequency")]
End = Annotated[float | None, Number("s", above=0), "End time in s; from the nominal poles if left out."]
Points = Annotated[int, Whole(2, 100_000), "Number of times, where an end is given."]
SettlingBand = Annotated[
    float, Number(above=0, below=1), "Share of the final value that counts as settled.", Named(option="--settling-band")
]
Workers = Annotated[int, Whole(1, 1024), "Threads; the answer does not depend on them.", Named(only="command")]


@dataclass(frozen=True)
class Judged:
    """What is judged of each member."""

    metric: Metric = "peak-deviation"
    output: Output = None
    from_input: FromInput = None
    band: SettlingBand = 0.02

    @property
    def options(self) -> dict[str, Any]:
        return {"output": self.output, "input": self.from_input, "band": self.band}


@dataclass(frozen=True)
class Excitation:
    """What drives the members: steps, plus sines, on the named inputs, until an end."""

    input: Drive = None
    sine: Sine = None
    frequency: Frequency = None
    t_end: End = None
    points: Points = 401

    def of(self, uncertain: Any) -> dict[str, Any]:
        """Times and inputs of a response as the functions take them."""
        import numpy as np

        if not isinstance(uncertain, rl.UncertainModel):
            raise InputError("members", f"a {type(uncertain).__name__}", "an uncertain model")
        _check_sine(self.sine, self.frequency)
        units = {s.name: s.unit for s in uncertain.inputs}
        steps, sines = in_units("input", self.input, units), in_units("sine", self.sine, units)
        dt, t_end = uncertain.dt, self.t_end
        if t_end is None:
            if sines:
                raise UsageError("sine", "no end time", "t_end")
            return {"t": None, "u": steps or None}
        t = np.arange(round(t_end / dt) + 1) * dt if dt else np.linspace(0.0, t_end, self.points)
        if self.frequency is None:
            return {"t": t, "u": steps or None}
        wave = np.sin(2 * np.pi * self.frequency * t)
        u = {name: steps.get(name, 0.0) + sines.get(name, 0.0) * wave for name in {**steps, **sines}}
        return {"t": t, "u": u, "hold": "foh"}


@dataclass(frozen=True)
class Certainty:
    """How sure a probability is to be."""

    probability: Annotated[
        float | None, Number(above=0, below=1), "With a limit: show P(violation) at most so large; else exit code 1."
    ] = None
    confidence: Annotated[float, Number(above=0, below=1), "With a limit: confidence of all bounds."] = 0.95


USUAL, UNDRIVEN, AS_USUAL, USUALLY_SURE = Judged(), Excitation(), Search(), Certainty()


def unit_of_metric(step: Any, ahead: Any) -> Any:
    """Unit of a metric's values before the run; ``float`` where it is not known yet."""
    _check_sine(step.sine, step.frequency)
    if step.metric in ("overshoot", "settling-time"):
        return "%" if step.metric == "overshoot" else "s"
    outputs = ahead[step.of].outputs
    if step.metric not in OF_A_RESPONSE or not outputs or (step.output is None and len(outputs) > 1):
        return float
    return outputs.get(step.output or next(iter(outputs)), float)


def _foretold_worst(step: Any, ahead: Any) -> Any:
    unit = unit_of_metric(step, ahead)
    known = type(step).leaves
    return replace(ahead[None], leaves={**known, "value": unit, "nominal_value": unit})


def _foretold_violation(step: Any, ahead: Any) -> Any:
    unit = unit_of_metric(step, ahead)
    if step.unit is not None and unit is not float and step.unit != unit:
        raise UnitMismatch("unit", step.unit, f"{unit or 'none'}: that of the metric")
    return replace(ahead[None], leaves={**type(step).leaves, "worst_value": unit})


@door("worst-case", "worst-case", result="worst_case_analysis.worst_case_search.WorstCase", foretell=_foretold_worst)
def worst_case(
    uncertain: Of,
    judged: Judged = USUAL,
    drive: Excitation = UNDRIVEN,
    n: Annotated[
        int,
        Whole(1, 100_000),
        "Points that the search starts from (256); with a limit: samples.",
        Named(option="-n,--samples"),
    ] = 256,
    seed: Seed = 0,
    search: Search = AS_USUAL,
    workers: Workers = 1,
) -> Any:
    """The worst member that a search over all normalised Delta finds, with its Delta; a lower bound, not a guarantee.

    With a limit the probability that random members violate it, with Clopper-Pearson bounds and what matters for it.

    Example: robustlab worst-case uncertain.h5 --metric peak-deviation --outputs omega --input-value u=42 --t-end 0.1
    """
    options: dict[str, Any] = {**judged.options, **drive.of(uncertain), **search.options}
    return rl.worst_case(uncertain, judged.metric, n=n, seed=seed, workers=workers, **options)


@door(
    "worst-case --limit",
    "violation-probability",
    result="worst_case_analysis.statistics.ViolationProbability",
    foretell=_foretold_violation,
)
def violation_probability(
    uncertain: Of,
    limit: Annotated[Any, Quantity(), "Do not search: how probable is it that samples violate this? '0.5 rad'."],
    judged: Judged = USUAL,
    unit: Annotated[
        str | None, Kind(), "Unit of the limit: that of the metric, else it is refused.", Named(only="step")
    ] = None,
    sure: Certainty = USUALLY_SURE,
    drive: Excitation = UNDRIVEN,
    n: Annotated[
        int | None,
        Whole(1, 10_000_000),
        "Samples; as many as show the probability without a violation, or 1000, where left out.",
        Named(option="-n,--samples"),
    ] = None,
    seed: Seed = 0,
    workers: Workers = 1,
) -> Any:
    """Probability that random members violate a limit of a metric, with Clopper-Pearson bounds; what matters for it.

    The parameters are taken as uniform in their ranges and independent.
    """
    options: dict[str, Any] = {**judged.options, **drive.of(uncertain)}
    return rl.violation_probability(
        uncertain, judged.metric, limit if unit is None else f"{limit!r} {unit}", probability=sure.probability,
        confidence=sure.confidence, n=n, seed=seed, workers=workers, **options,
    )  # fmt: skip


def _check_sine(sines: Any, frequency: float | None) -> None:
    if bool(sines) != (frequency is not None):
        raise UsageError("sine", "one of sine and frequency", "both: sine and frequency belong together")
