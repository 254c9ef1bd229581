"""The step that simulates random members of an uncertain model."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber, unknown_name
from robustlab.operations.vocabulary import Count, Names, Points, Positive, ReferenceLine, ToUncertain
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Step, Workspace, quantity, step


@step
class SampleStep(Step):
    """Responses of random members of an uncertain model and of vertices of Delta, with their envelope.

    Inputs: a step of `input` at t = 0, plus a `sine` of `frequency`, until `t_end`.
    """

    do: Literal["sample"]
    of: ToUncertain
    input: Annotated[dict[str, float], Names("inputs")] = Field({}, description="Amplitude of the step on each input.")
    sine: Annotated[dict[str, float], Names("inputs")] = Field({}, description="Amplitude of the sine on each input.")
    frequency: Positive | None = Field(None, description="Frequency of the sine in Hz.")
    t_end: Positive
    points: Points = 401
    seed: Annotated[int, Field(ge=0)] | None = Field(None, description="The recipe's seed where left out.")
    n: Count = 20
    vertices: Count = 0
    reference: list[ReferenceLine] = Field([])
    outputs: Annotated[list[str], Field(min_length=1), Names("outputs")] | None = Field(
        None, description="All where left out."
    )
    percent: float | None = Field(
        None, gt=0, description="Draw the members' deviation in percent too, with this published band (+-)."
    )

    def infer(self, ahead: Ahead) -> Inferred:
        outputs = ahead[self.of].select(self.outputs).outputs
        if outputs is None:
            outputs = dict.fromkeys(self.outputs or ["*"], float)
        else:
            self._check_references(list(outputs))
        left = {
            name: {
                "final": dict.fromkeys(("nominal", "lower", "upper"), unit),
                "peak_deviation": unit, "peak_percent": "%", "covers": list, "worst_member": "1",
            }
            for name, unit in outputs.items()
        }  # fmt: skip
        return Inferred(leaves={"outputs": left, "members": "1", "unstable": "1"})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.operations.members import Excitation

        model = work.wanted(self.of, rl.UncertainModel)
        if self.outputs:
            model = model.select(None, self.outputs)
        drive = Excitation(self.input, self.sine, self.frequency, self.t_end, self.points).of(model)
        seed = work.seed if self.seed is None else self.seed
        responses = rl.sample(model, self.n, seed, vertices=self.vertices).respond(**drive)
        if not responses.status.trustworthy:
            raise NoTrustworthyNumber(f"sample {self.of}", "responses outgrow every number", hint="a smaller t_end")
        numbers: dict[str, Any] = {}
        facts: list[Fact] = []
        for k, (name, _) in enumerate(responses.outputs):
            numbers[name], found = self._output(work, responses, k)
            facts += found
        if self.percent is not None:
            facts.append(self._percent_bands(work, responses, numbers, self.percent))
        count, unstable = len(responses.y), len(responses.unstable)
        summary = f"{count} members of {self.of} simulated ({self.n} random, seed {seed}; the rest vertices of Δ)."
        notes = (f"{unstable} of these {count} members are unstable.",) if unstable else ()
        notes += ("Sampled, not proved: members that were not drawn may lie outside this envelope.",)
        numbers = {"outputs": numbers, "members": count, "unstable": unstable}
        return Outcome(None, summary, numbers, tuple(facts), notes=notes)

    def _check_references(self, known: list[str]) -> None:
        for name in (line.output for line in self.reference):
            if name not in known:
                raise unknown_name(f"reference: output {name!r}", "no such signal", name, known)

    def _output(self, work: Workspace, responses: Any, k: int) -> tuple[dict[str, Any], list[Fact]]:
        from robustlab.report.robustness_figures import response_figure

        name, unit = responses.outputs[k]
        y, nominal = responses.y[:, :, k], responses.nominal[:, k]
        lower, upper = responses.lower[:, k], responses.upper[:, k]
        final = {"nominal": float(nominal[-1]), "lower": float(lower[-1]), "upper": float(upper[-1])}
        references = [(r.value, r.text) for r in self.reference if r.output == name]
        covers = [final["lower"] <= value <= final["upper"] for value, _ in references]
        span = f"{quantity(final['lower'])} … {quantity(final['upper'], unit)}"
        facts = [Fact(f"{name} at the end", f"{span} (nominal {quantity(final['nominal'], unit)})")]
        for (value, text), inside in zip(references, covers, strict=True):
            facts.append(Fact(text, f"{quantity(value, unit)}: {'covered' if inside else 'not covered'}"))
        if self.percent is None:  # else the percent figure shows the curves
            figure = response_figure(
                responses.t, y, nominal, (lower, upper), output=(name, unit), references=references
            )
            members = f"{self.n} random members and {self.vertices} vertices of Δ"
            work.draw(figure, name, f"{name} after {self._amplitudes(responses.inputs)}: {members}.")
        deviation = float(abs(y - nominal).max(initial=0.0))
        numbers = {"final": final, "peak_deviation": deviation, "covers": covers, "worst_member": responses.worst[k]}
        size = float(abs(nominal).max())
        return numbers | ({"peak_percent": 100 * deviation / size} if size > 0 else {}), facts

    def _percent_bands(self, work: Workspace, responses: Any, numbers: Any, published: float) -> Fact:
        """Draw the members' deviations in percent of the largest nominal value with a published band."""
        from robustlab.thesis.figures import percent_figure

        bands: dict[str, Any] = {}
        for k, (name, _) in enumerate(responses.outputs):
            nominal = responses.nominal[:, k]
            if abs(nominal).max() > 0:
                bands[name] = 100 * (responses.y[:, :, k] - nominal) / abs(nominal).max()
        caption = f"Change of {', '.join(bands)} in percent of the largest nominal value, and the published band."
        work.draw(percent_figure(responses.t, bands, published), "percent", caption)
        found = ", ".join(f"{name} {numbers[name]['peak_percent']:.4g} %" for name in bands)
        return Fact("Largest change of a member", f"{found}; published ±{published:g} %")

    def _amplitudes(self, inputs: Any) -> str:
        units = dict(inputs)
        sine = f"a sine of {self.frequency:g} Hz" if self.frequency else ""
        return " and ".join(
            f"{what} of {', '.join(f'{quantity(value, units[name])} on {name}' for name, value in given.items())}"
            for given, what in ((self.input, "a step"), (self.sine, sine))
            if given
        )
