"""Steps on measurements: reading and comparing records, identifying missing effects."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.operations.declaration import InLoop
from robustlab.operations.vocabulary import Positive, Text
from robustlab.recipe.steps.contract import Ahead, Inferred, Outcome, Step, Workspace, facts_of, step
from robustlab.recipe.steps.generated import BASES, OperationStep


@step
class RecordStep(Step):
    """A record from HDF5, MATLAB or CSV; its file may be anywhere."""

    gives: ClassVar[str] = "record"
    leaves: ClassVar[Any] = rl.Record.quantities
    do: Literal["record"]
    path: Text
    group: str | None = None
    inputs: list[str] | None = None
    outputs: list[str] | None = None
    dt: Positive | None = None
    clock: str | None = Field(None, description="Signal with the times, where it is not called t or time.")
    units: dict[str, str] = Field(
        {}, description='Unit that the numbers in the file are in: { phi = "deg" }; they are converted to SI.'
    )
    simulated: bool = Field(False, description="The record is simulated, not measured; the report notes it.")
    about: Text = Field(
        "", description="Description, publisher and source of the record; shown where the file is missing."
    )

    def infer(self, ahead: Ahead) -> Inferred:
        path = ahead.sources[ahead.step]
        return Inferred.of(
            rl.Record.read(path, self.group, self.inputs, self.outputs, self.dt, units=self.units, clock=self.clock)
        )

    def run(self, work: Workspace) -> Outcome:
        path, found = work.ahead.sources[work.step], work.ahead[work.step].value
        notes = (" ".join(self.about.split()),) if self.about else ()
        if self.simulated:
            work.simulated.add(work.step)
        summary = f"Record {path.name} read ({'simulated' if self.simulated else 'measured'})."
        return Outcome(found, summary, found.numbers(), facts_of(found), notes=notes)


class Naming(OperationStep):
    """Effect identification: saves the updated plant as STEP-plant.h5; the recipe chooses the accepted verdicts."""

    accept: Annotated[list[Literal["no missing effect", "named", "ambiguous", "unknown"]], Field(min_length=1)] = Field(
        ["no missing effect", "named"],
        description="Verdicts that this recipe accepts; any other is no trustworthy number (exit code 4).",
    )

    def infer(self, ahead: Ahead) -> Inferred:
        of = vars(self)["of"]
        return replace(super().infer(ahead), inputs=ahead[of].inputs, outputs=ahead[of].outputs)

    def pattern(self, ahead: Ahead) -> Any:
        from robustlab.identification.missing_effects.discovery_result import units_of_effects

        given = vars(self)
        effects = units_of_effects(given["exclude"] or ())
        parameters = getattr(ahead[given["of"]].value, "parameters", None)
        nominal = {"*": float} if parameters is None else {name: p.unit for name, p in parameters.items()}
        confidence = {"confidence": dict.fromkeys(effects, "1"), "nominal": nominal}
        return {**self.leaves, **dict.fromkeys(("effects", "lower", "upper"), effects), **confidence}

    def in_free_run(self, path: str) -> str | None:
        step, _, name = path.partition(".")
        if name.startswith("gaps."):
            return f"{step}.free_run.outputs.{name.removeprefix('gaps.')}"
        whole = {"gap_before": "before", "gap_refitted": "refitted", "gap_after": "after"}
        return f"{step}.free_run.{whole[name]}" if name in whole else None

    def outcome(self, found: InLoop, work: Workspace) -> Outcome:
        named = found.result
        if named.interrupted:
            raise KeyboardInterrupt  # later steps must not use an incomplete result
        outcome = super().outcome(found, work)
        work.discoveries[work.step] = named
        notes = [*(f.message for f in named.findings), *outcome.notes]
        status = named.status
        if not status.trustworthy and named.verdict in self.accept:
            status = rl.Status.CONVERGED
            notes.append(f"The verdict {named.verdict!r} is accepted by this recipe.")
        if named.model is not None:
            file = f"{work.step}-plant.h5"
            rl.save(work.folder / file, named.model, work.provenance())
            work.files.append(file)
            notes.append(f"The updated plant is in {file}.")
        if named.next_experiment is not None:
            file = f"{work.step}-next-experiment.csv"
            named.next_experiment.save(work.folder / file)
            work.files.append(file)
            notes.append(f"The signal of the next experiment is in {file}.")
        return replace(outcome, summary=f"{named.headline()}.", status=status, notes=tuple(notes))


class Comparing(OperationStep):
    """Comparison with a record: every number in windows has a counterpart in free run."""

    def in_free_run(self, path: str) -> str | None:
        return path.replace(".windowed_", ".") if ".outputs." in path and ".windowed_" in path else None


BASES |= {"discover": Naming, "compare": Comparing}
