"""Steps that drive the members of an uncertain model: samples, worst case, probability of a violation, campaigns."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.doors.vocabulary import (
    Count,
    Names,
    Points,
    Positive,
    ReferenceLine,
    Tolerance,
    ToUncertain,
)
from robustlab.errors import NoTrustworthyNumber, unknown_name
from robustlab.recipe.steps.contract import Ahead, Fact, Foretold, Outcome, Step, Workspace, quantity, step, told


class DrivenStep(Step):
    """What the steps share that drive a model: a step of `input` at t = 0, plus a `sine` of `frequency`."""

    input: Annotated[dict[str, float], Names("inputs")] = Field({}, description="Amplitude of the step on each input.")
    sine: Annotated[dict[str, float], Names("inputs")] = Field({}, description="Amplitude of the sine on each input.")
    frequency: Positive | None = Field(None, description="Frequency of the sine in Hz.")

    @model_validator(mode="after")
    def _sine_has_a_frequency(self) -> Self:
        if bool(self.sine) != (self.frequency is not None):
            raise PydanticCustomError("sine", "sine and frequency belong together")
        return self


class ResponseStep(DrivenStep):
    """What the steps that simulate responses share; they are watched until `t_end`."""

    of: ToUncertain
    t_end: Positive
    points: Points = 401
    seed: Annotated[int, Field(ge=0)] | None = Field(None, description="The recipe's seed where left out.")

    @model_validator(mode="after")
    def _is_driven(self) -> Self:
        if not self.input and not self.sine:
            raise PydanticCustomError("driven", "expected input, or sine with frequency")
        return self


@step
class SampleStep(ResponseStep):
    """Responses of random members of an uncertain model and of vertices of Delta, with their envelope."""

    do: Literal["sample"]
    n: Count = 20
    vertices: Count = 0
    reference: list[ReferenceLine] = Field([])
    outputs: Annotated[list[str], Field(min_length=1), Names("outputs")] | None = Field(
        None, description="All where left out."
    )
    percent: float | None = Field(
        None, gt=0, description="Draw the members' deviation in percent too, beside this published band (+-)."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        outputs = ahead[self.of].select(self.outputs).outputs
        if outputs is None:
            outputs = dict.fromkeys(self.outputs or ["*"], float)
        else:
            for reference in self.reference:
                _known(reference.output, list(outputs), "reference: output")
        left = {
            name: {
                "final": dict.fromkeys(("nominal", "lower", "upper"), unit),
                "peak_deviation": unit, "peak_percent": "%", "covers": list, "worst_member": "1",
            }
            for name, unit in outputs.items()
        }  # fmt: skip
        return Foretold(leaves={"outputs": left, "members": "1", "unstable": "1"})

    def run(self, work: Workspace) -> Outcome:
        model = work.uncertain(self.of)
        known = [s.name for s in model.outputs]
        for name in self.outputs or []:
            _known(name, known, "outputs:")
        for reference in self.reference:
            _known(reference.output, self.outputs or known, "reference: output")
        if self.outputs:
            model = model.select(None, self.outputs)
        t, u = _excitation(model, self, self.t_end, self.points)
        seed = work.seed if self.seed is None else self.seed
        responses = rl.sample(model, self.n, seed, vertices=self.vertices).respond(t, u, hold=_hold(self))
        if not responses.status.trustworthy:
            raise NoTrustworthyNumber(f"sample {self.of}", "responses outgrow every number", hint="a smaller t_end")
        numbers: dict[str, Any] = {}
        facts: list[Fact] = []
        for k, (name, _) in enumerate(responses.outputs):
            numbers[name], found = _sampled_output(self, work, responses, k)
            facts += found
        if self.percent is not None:
            facts.append(_percent_bands(self, work, responses, numbers, self.percent))
        count = len(responses.y)
        summary = f"{count} members of {self.of} simulated ({self.n} random, seed {seed}; the rest vertices of Δ)."
        notes = ["Sampled, not proved: members that were not drawn may lie outside this envelope."]
        if responses.unstable:
            notes.insert(0, f"{len(responses.unstable)} of these {count} members are unstable.")
        numbers = {"outputs": numbers, "members": count, "unstable": len(responses.unstable)}
        return Outcome(None, summary, numbers, tuple(facts), notes=tuple(notes))


class MetricStep(DrivenStep):
    """What the steps share that judge members by a metric."""

    of: ToUncertain
    metric: Literal[
        "peak-deviation",
        "peak",
        "rms",
        "overshoot",
        "settling-time",
        "hinf",
        "h2",
        "spectral-abscissa",
        "damping",
    ] = "peak-deviation"
    output: Annotated[str, Names("outputs")] | None = None
    from_input: Annotated[str, Names("inputs")] | None = Field(None, description="Input of a norm; all where left out.")
    t_end: Positive | None = None
    points: Points = 401
    band: Tolerance = Field(0.02, description="Share of the final value that counts as settled.")
    seed: Annotated[int, Field(ge=0)] | None = None

    @property
    def of_a_response(self) -> bool:
        """Whether the metric is that of a time response."""
        return self.metric in ("peak-deviation", "peak", "rms", "overshoot", "settling-time")

    @model_validator(mode="after")
    def _needs_a_response(self) -> Self:
        if self.of_a_response and (not (self.input or self.sine) or self.t_end is None):
            raise PydanticCustomError(
                "needs_response", "{metric} needs input (or sine) and t_end", {"metric": self.metric}
            )
        return self

    def unit_of_metric(self, ahead: Ahead) -> Any:
        """Unit of the metric's values; ``float`` where it is not known yet."""
        if self.metric in ("overshoot", "settling-time"):
            return "%" if self.metric == "overshoot" else "s"
        outputs = ahead[self.of].outputs
        if not self.of_a_response or not outputs or (self.output is None and len(outputs) > 1):
            return float
        return outputs.get(self.output or next(iter(outputs)), float)

    def options(self, work: Workspace) -> dict[str, Any]:
        """Keyword arguments for a metric as the step says."""
        import numpy as np

        options: dict[str, Any] = {"seed": work.seed if self.seed is None else self.seed, "band": self.band}
        options |= {"output": self.output, "input": self.from_input}
        if self.of_a_response:
            assert self.t_end is not None
            options["t"], options["u"] = _excitation(work.uncertain(self.of), self, self.t_end, self.points)
            options["hold"] = _hold(self)
        elif self.t_end is not None:
            options["t"] = np.linspace(0.0, self.t_end, self.points)
        return options


def _sampled_output(step: SampleStep, work: Workspace, responses: Any, k: int) -> tuple[dict[str, Any], list[Fact]]:
    """Numbers, facts and figure of the k-th output."""
    from robustlab.report.robustness_figures import response_figure

    name, unit = responses.outputs[k]
    y, nominal = responses.y[:, :, k], responses.nominal[:, k]
    lower, upper = responses.lower[:, k], responses.upper[:, k]
    final = {"nominal": float(nominal[-1]), "lower": float(lower[-1]), "upper": float(upper[-1])}
    references = [(r.value, r.text) for r in step.reference if r.output == name]
    covers = [final["lower"] <= value <= final["upper"] for value, _ in references]
    span = f"{quantity(final['lower'])} … {quantity(final['upper'], unit)}"
    facts = [Fact(f"{name} at the end", f"{span} (nominal {quantity(final['nominal'], unit)})")]
    for (value, text), inside in zip(references, covers, strict=True):
        facts.append(Fact(text, f"{quantity(value, unit)}: {'covered' if inside else 'not covered'}"))
    if step.percent is None:  # else the curves would lie on one another
        figure = response_figure(responses.t, y, nominal, (lower, upper), output=(name, unit), references=references)
        members = f"{step.n} random members and {step.vertices} vertices of Δ"
        work.draw(figure, name, f"{name} after {_amplitudes(step, responses.inputs)}: {members}.")
    deviation = float(abs(y - nominal).max(initial=0.0))
    numbers = {"final": final, "peak_deviation": deviation, "covers": covers, "worst_member": responses.worst[k]}
    size = float(abs(nominal).max())
    if size > 0:
        numbers["peak_percent"] = 100 * deviation / size
    return numbers, facts


def _percent_bands(step: SampleStep, work: Workspace, responses: Any, numbers: Any, published: float) -> Fact:
    """The members' deviations in percent of the largest nominal value, drawn beside a published band."""
    import numpy as np

    from robustlab.thesis.figures import percent_figure

    bands: dict[str, Any] = {}
    for k, (name, _) in enumerate(responses.outputs):
        nominal = responses.nominal[:, k]
        if np.abs(nominal).max() > 0:
            bands[name] = 100 * (responses.y[:, :, k] - nominal) / np.abs(nominal).max()
    caption = f"Change of {', '.join(bands)} in percent of the largest nominal value, and the published band."
    work.draw(percent_figure(responses.t, bands, published), "percent", caption)
    found = ", ".join(f"{name} {numbers[name]['peak_percent']:.4g} %" for name in bands)
    return Fact("Largest change of a member", f"{found}; published ±{published:g} %")


def _excitation(model: Any, step: DrivenStep, t_end: float, points: int) -> tuple[Any, Any]:
    """Times (n_t,) and inputs (n_t, n_u): steps, plus sines, of the given amplitudes on the named inputs."""
    import numpy as np

    known = [s.name for s in model.inputs]
    for name in [*step.input, *step.sine]:
        _known(name, known, "input")
    t = np.linspace(0.0, t_end, points)
    u = np.tile([step.input.get(name, 0.0) for name in known], (points, 1))
    if step.frequency is not None:
        wave = np.sin(2 * np.pi * step.frequency * t)
        u = u + wave[:, None] * [step.sine.get(name, 0.0) for name in known]
    return t, u


def _hold(step: DrivenStep) -> Any:
    return "foh" if step.sine else "zoh"


def _known(name: str, known: list[str], where: str) -> None:
    if name not in known:
        raise unknown_name(f"{where} {name!r}", "no such signal", name, known)


def _amplitudes(step: DrivenStep, inputs: Any) -> str:
    """What drives, in words."""
    units = dict(inputs)
    parts: list[str] = []
    sine = f"a sine of {step.frequency:g} Hz" if step.frequency else ""
    for amplitudes, what in ((step.input, "a step"), (step.sine, sine)):
        given = {name: quantity(value, units[name]) for name, value in amplitudes.items()}
        if len(given) > 2 and len(set(given.values())) == 1:
            parts.append(f"{what} of {next(iter(given.values()))} on {len(given)} inputs")
        elif given:
            parts.append(f"{what} of {', '.join(f'{value} on {name}' for name, value in given.items())}")
    return " and ".join(parts)


@step
class CampaignStep(MetricStep):
    """A metric of many members, computed in worker processes and stored one by one; an interrupted run goes on."""

    do: Literal["campaign"]
    draw: Literal["samples", "vertices", "search"] = Field(
        "samples", description="Random members, vertices of Delta, or whole worst-case searches from own starts."
    )
    n: Annotated[int, Field(ge=1, le=1_000_000_000)] = 1000
    limit: float | None = Field(None, description="Count how often the metric is worse than it.")
    workers: Annotated[int, Field(ge=1, le=1024)] | None = Field(None, description="One per processor where left out.")

    def foretell(self, ahead: Ahead) -> Foretold:
        unit = self.unit_of_metric(ahead)
        return Foretold(
            leaves={
                **dict.fromkeys(("worst_index", "done", "lost", "unbounded", "unseen"), "1"), "worst": unit,
                "nominal": unit, "delta": {"*": ...}, "digest": str, "quantiles": {"*": unit},
                "violation": dict.fromkeys(("count", "of", "lower", "upper"), "1"),
            }
        )  # fmt: skip

    def run(self, work: Workspace) -> Outcome:
        from robustlab.campaign import CampaignSettings, Crew, Identity, run_campaign

        model = work.uncertain(self.of)
        seed = work.seed if self.seed is None else self.seed
        options = self.options(work)
        u = dict(self.input) or None
        if self.sine:  # not a constant: sample by sample
            u = {name: column.tolist() for (name, _), column in zip(model.inputs, options["u"].T, strict=True)}
        settings = CampaignSettings(
            self.metric,
            self.n,
            self.draw,
            seed,
            self.output,
            self.from_input,
            u,
            self.t_end,
            self.points,
            options.get("hold", "zoh"),
            band=self.band,
        )
        # The name holds the campaign's hash: what was begun with another recipe is neither used nor spoilt.
        store = work.unfinished / f"{work.step}-{Identity.of(model, settings).hash[:12]}.sqlite"
        store.parent.mkdir(parents=True, exist_ok=True)
        result = run_campaign(model, settings, store, crew=Crew(self.workers), limit=self.limit)
        summary = f"{self.metric} of {result.done} {_members(self)} of {self.of}, seed {seed}; {result.label}."
        return told(replace(result, store=str(_published(store, work))), None, summary, work)


def _members(step: CampaignStep) -> str:
    return {"samples": "random members", "vertices": "vertices of Δ", "search": "searches over Δ"}[step.draw]


def _published(store: Path, work: Workspace) -> Path:
    """Move the finished store to the evidence of this run, and say where it is."""
    target = work.folder / "evidence" / f"{work.step}.sqlite"
    target.parent.mkdir(exist_ok=True)
    store.replace(target)
    work.files.append(f"evidence/{target.name}")
    store.with_name(f"{store.name}.lock").unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        store.parent.rmdir()  # stays where another campaign is unfinished
    return target
