"""The step that simulates random members of an uncertain model."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from robustlab.errors import NoTrustworthyNumber, unknown_name
from robustlab.operations.declaration import InLoop
from robustlab.operations.vocabulary import ReferenceLine
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Workspace, quantity
from robustlab.recipe.steps.generated import BASES, OperationStep


class SampleStep(OperationStep):
    """Responses of members: the numbers of each output, compared with known values."""

    reference: list[ReferenceLine] = Field([])
    percent: float | None = Field(
        None, gt=0, description="Draw the members' deviation in percent too, with this published band (+-)."
    )

    def infer(self, ahead: Ahead) -> Inferred:
        given = vars(self)
        outputs = ahead[given["of"]].select(given["outputs"]).outputs
        if outputs is None:
            outputs = dict.fromkeys(given["outputs"] or ["*"], float)
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

    def outcome(self, found: InLoop, work: Workspace) -> Outcome:
        given, responses = vars(self), found.result
        if not responses.status.trustworthy:
            raise NoTrustworthyNumber(f"sample {given['of']}", "responses outgrow every number", hint="a smaller t_end")
        numbers: dict[str, Any] = {}
        facts: list[Fact] = []
        for k, (name, _) in enumerate(responses.outputs):
            numbers[name], of_output = self._output(work, responses, k)
            facts += of_output
        if self.percent is not None:
            facts.append(self._percent_bands(work, responses, numbers, self.percent))
        count, unstable = len(responses.y), len(responses.unstable)
        drawn = f"{given['n']} random, seed {found.beside['seed']}; the rest vertices of Δ"
        notes = (f"{unstable} of these {count} members are unstable.",) if unstable else ()
        notes += ("Sampled, not proved: members that were not drawn may lie outside this envelope.",)
        numbers = {"outputs": numbers, "members": count, "unstable": unstable}
        return Outcome(
            None, f"{count} members of {given['of']} simulated ({drawn}).", numbers, tuple(facts), notes=notes
        )

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
            members = "{n} random members and {vertices} vertices of Δ".format(**vars(self))
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
        units, own = dict(inputs), vars(self)
        sine = f"a sine of {own['frequency']:g} Hz" if own["frequency"] else ""
        return " and ".join(
            f"{what} of {', '.join(f'{quantity(value, units[name])} on {name}' for name, value in given.items())}"
            for given, what in ((own["input"], "a step"), (own["sine"], sine))
            if given
        )


BASES["sample"] = SampleStep
