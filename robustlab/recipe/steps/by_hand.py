"""Steps written by hand, and those that do more than their operation: plants, files, records, samples, the thesis."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, WrapValidator, model_validator
from pydantic_core import PydanticCustomError, ValidationError

import robustlab as rl
from robustlab.display import number
from robustlab.errors import NoTrustworthyNumber, unknown_name
from robustlab.operations.declaration import InLoop
from robustlab.operations.parameter_types import Thing
from robustlab.recipe.steps.generated import OperationStep
from robustlab.recipe.steps.step import (
    Ahead,
    Fact,
    Inferred,
    Outcome,
    Positive,
    Step,
    Strict,
    Text,
    Workspace,
    facts_of,
    step,
)

quantity = partial(number, digits=5)


def _number_or_pair(value: Any, handler: Any) -> Any:
    try:
        return handler(value)
    except ValidationError:
        raise PydanticCustomError("number_or_pair", "expected a number, or [number, relative tolerance]") from None


# A number with a unit or a per cent sign, which the plant reads.
NumberText = Annotated[str, Field(pattern=r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", max_length=100)]
NumberOrPair = Annotated[
    float | NumberText | Annotated[list[float | NumberText], Field(min_length=2, max_length=2)],
    WrapValidator(_number_or_pair),
]


@step
class PlantStep(Step):
    """A plant from physics."""

    gives: ClassVar[str] = "plant"
    do: Literal["plant"]
    plant: str = Field(
        description='Name of the plant, for example "dc-motor"; or "file.py:name", near the recipe: that file is run.'
    )
    parameters: dict[str, NumberOrPair] = Field(
        {}, description='Values in SI units, [value, relative tolerance], or texts: "0.5 mH", "10%".'
    )
    choices: dict[str, str | bool | list[float]] = Field(
        {}, description='Options beyond numbers: preset = "physical", motors = true, m = [1.0, 2.0] for a chain.'
    )

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        twice = sorted(set(self.parameters) & set(self.choices))
        if twice:
            raise PydanticCustomError("named_once", "{name} is among parameters and choices", {"name": twice[0]})
        return self

    @property
    def _given(self) -> dict[str, Any]:
        pairs = {name: tuple(value) if isinstance(value, list) else value for name, value in self.parameters.items()}
        return pairs | self.choices

    @property
    def reads(self) -> tuple[str, str | None]:
        from robustlab.dynamics.plant_file import plant_reference, unit_reference

        parts = plant_reference(self.plant)
        return "plant", self.plant if unit_reference(self.plant) else parts and parts[0]

    def infer(self, ahead: Ahead) -> Inferred:
        parameter: dict[str, Any] = {"value": float, "unit": str, "tolerance": "1"}
        if ahead.step in ahead.sources:  # a user's code runs only with the recipe
            return Inferred(leaves={"code": {"*": str}, "parameters": {"*": parameter}})
        made: Any = rl.plant(self.plant, **self._given)
        parameters = {name: {**parameter, "value": p.unit} for name, p in made.parameters.items()}
        return Inferred.of(made, {"parameters": parameters})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.plant_file import plant_from_file, unit_reference
        from robustlab.provenance import code_of

        given = self._given
        facts: list[Fact] = []
        numbers: dict[str, Any] = {}
        if work.step in work.ahead.sources:
            source, unit = work.ahead.sources[work.step], unit_reference(self.plant)
            made: Any = rl.plant(str(source), **given) if unit else plant_from_file(self.plant, given, source)
            numbers["code"] = code_of(made)
            facts = [Fact(f"Code of {self.plant}", f"SHA-256 {sha}", file) for file, sha in numbers["code"].items()]
            work.inputs.update({f"{work.step}: {Path(file).name}": sha for file, sha in numbers["code"].items()})
        else:
            made = rl.plant(self.plant, **given)
        for p in made.parameters.values():
            spread = f" ± {p.tolerance_text}" if p.tolerance else ""
            facts.append(Fact(f"{p.name}, {p.meaning}", f"{quantity(p.value, p.unit)}{spread}", p.source))
        numbers["parameters"] = {
            name: {"value": p.value, "unit": p.unit, "tolerance": p.tolerance} for name, p in made.parameters.items()
        }
        signals = " → ".join(", ".join(f"{s.name} [{s.unit}]" for s in side) for side in (made.inputs, made.outputs))
        return Outcome(made, f"Plant {self.plant}: {signals}.", numbers, tuple(facts))


@step
class LoadStep(Step):
    """A model from an HDF5 file: a path, or the file that an earlier step saved."""

    gives: ClassVar[str] = "any"
    leaves: ClassVar[Any] = {"kind": str, "verified": bool, **rl.StateSpaceModel.quantities}
    do: Literal["load"]
    path: Text | None = None
    saved: Annotated[str, Thing(("saved",))] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.path is None) == (self.saved is None):
            raise PydanticCustomError("one_source", "expected either path or saved")
        return self

    def infer(self, ahead: Ahead) -> Inferred:
        from robustlab.storage import read

        if self.saved is not None:
            return replace(ahead[self.saved], leaves=self.leaves)
        return Inferred.of(read(ahead.sources[ahead.step]).object)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.storage import read

        path = work.ahead.sources[work.step] if self.saved is None else work.values[self.saved]
        loaded = read(path)
        found: Any = loaded.object
        kind = type(found).__name__
        model = found.to_model() if hasattr(found, "to_model") else found
        numbers: dict[str, Any] = {"kind": kind, "verified": loaded.verified}
        if isinstance(model, rl.StateSpaceModel):
            numbers |= model.numbers()
        proof = "its checksums and content hash are right" if loaded.verified else "it carries no content hash to check"
        summary = f"{kind} read from {path.name}; {proof}."
        return Outcome(found, summary, numbers, facts_of(found), notes=loaded.warnings)


@step
class SaveStep(Step):
    """Write the object of an earlier step to an HDF5 file in the output folder."""

    gives: ClassVar[str] = "saved"
    leaves: ClassVar[Any] = {"sha256": str}
    do: Literal["save"]
    of: Annotated[str, Thing(("plant", "model", "uncertain", "problem", "controller", "record", "any"))]
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*\.h5$", max_length=100)]

    def infer(self, ahead: Ahead) -> Inferred:
        return ahead[self.of].select(None)

    def run(self, work: Workspace) -> Outcome:
        import h5py

        from robustlab.dynamics import NonlinearPlant

        path = work.folder / self.file
        given = work.values[self.of]
        if hasattr(given, "to_uncertain"):  # a tracking problem is kept as its generalised plant
            given = given.to_uncertain()
        if not isinstance(given, (rl.StateSpaceModel, rl.UncertainModel, rl.Record, rl.Controller, NonlinearPlant)):
            given = given.to_model()  # a linear plant without effects is kept as its linear model
        rl.save(path, given, work.provenance())
        work.files.append(self.file)
        with h5py.File(path) as written:
            # Excludes provenance: equal content gives an equal hash.
            digest = str(written.attrs["content_sha256"])
        summary = f"{type(given).__name__} of {self.of} written to {self.file}."
        return Outcome(path, summary, {"sha256": digest}, (Fact("SHA-256 of the content", digest),))


# --- measurements ----------------------------------------------------------------------------------------------------


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
    clock: str | None = Field(None, description="Signal that contains the times, if it is not called t or time.")
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


class ReferenceLine(Strict):
    """A known value to draw with a response."""

    output: str
    value: float
    text: Text


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
            wrong = next((line.output for line in self.reference if line.output not in outputs), None)
            if wrong is not None:
                raise unknown_name(f"reference: output {wrong!r}", "no such signal", wrong, list(outputs))
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
        drawn = f"{given['n']} random, seed {found.extras['seed']}; the rest vertices of Δ"
        notes = (f"{unstable} of these {count} members are unstable.",) if unstable else ()
        notes += ("Sampled, not proved: members that were not drawn may lie outside this envelope.",)
        numbers = {"outputs": numbers, "members": count, "unstable": unstable}
        return Outcome(
            None, f"{count} members of {given['of']} simulated ({drawn}).", numbers, tuple(facts), notes=notes
        )

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


BASES: dict[str, type[OperationStep]] = {"discover": Naming, "compare": Comparing, "sample": SampleStep}

# --- the thesis ------------------------------------------------------------------------------------------------------

_MEANING = {
    "R": "reproduced within the fair tolerance",
    "F": "fitted: a value that is not printed was chosen so that it agrees; no reproduction",
    "P": "reproduced in part, or under the reading stated",
    "N": "not reproducible from the text, for the reason stated",
}


@step
class PublishedNumbersStep(Step):
    """The numbers that L. Březina's thesis prints about its Stewart platform, and ours, with its figures redrawn."""

    do: Literal["published-numbers"]
    n: Annotated[int, Field(ge=1, le=1000)] = Field(20, description="Random members in each figure of perturbed models")

    def infer(self, ahead: Ahead) -> Inferred:
        from robustlab.thesis.numbers import PublishedNumber

        row = {f.name: ... for f in fields(PublishedNumber)} | {"difference": ..., "agrees": ...}
        bands = {"*": {"*": "%"}}
        return Inferred(leaves={"rows": {"*": row}, "counts": {"*": "1"}, "disagreeing": "1", "bands": bands})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.thesis.figures import case_picture, pictures_of_numbers
        from robustlab.thesis.numbers import published_numbers as compute

        found = compute()
        work.keep(found)
        bands: dict[str, dict[str, float]] = {}
        for name, picture in pictures_of_numbers(found):
            work.draw(picture.figure, name, picture.caption)
        for case in found.cases:
            picture, bands[case.name] = case_picture(case, self.n, work.seed)
            work.draw(picture.figure, f"case-{case.name}", picture.caption)
        rows = {key: row.to_json() for key, row in found.rows.items()}
        counts = {status: len(found.with_status(status)) for status in _MEANING}
        off = found.disagreeing
        facts = tuple(Fact(f"Rows {status}: {meaning}", str(counts[status])) for status, meaning in _MEANING.items())
        facts += (Fact("Rows R and F that do not agree", ", ".join(off) or "none"),)
        facts += tuple(_fact(row) for row in found.rows.values())
        reproduced = sum(row.agrees is True for row in found.with_status("R"))
        summary = (
            f"{len(rows)} rows: {reproduced} of {counts['R']} declared reproducible are; {counts['F']} more are fits, "
            "which are not counted."
        )
        numbers = {"rows": rows, "counts": counts, "disagreeing": len(off), "bands": bands}
        return Outcome(None, summary, numbers, facts, found.status)


@step
class ThesisCaseStep(Step):
    """The platform of L. Březina's thesis, uncertain as in a case of its section 10.3.1.

    Inputs: the six torques, and `gravity`: 1 where the holding torque stays that of the nominal machine while gravity
    acts on the perturbed one, 0 where each member is trimmed anew.
    """

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = {
        "blocks": "1", "channels": "1", "published": "%", "gain_percent": "%", "released": "N m", "worst": "1",
        "changes": {"*": "%"},
    }  # fmt: skip
    do: Literal["thesis-case"]
    case: Literal["1", "2a", "2b", "2c"]
    structure: Literal["elements", "columns", "rows", "matrices", "single"] = "single"
    n: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        0, description="Random members in the picture with nominal and worst Δ; no picture where 0."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.stewart.stewart_platform import stewart_platform
        from robustlab.thesis.figures import case_picture
        from robustlab.thesis.numbers import cases

        (case,) = [c for c in cases(stewart_platform()) if c.name == self.case]
        model = rl.elementwise(*case.with_gravity(), self.structure)
        numbers: dict[str, Any] = {"blocks": len(model.blocks), "channels": model.delta_shape[0]}
        numbers |= {name: getattr(case, name) for name in ("published", "gain_percent", "released", "worst")}
        if self.n:
            picture, numbers["changes"] = case_picture(case, self.n, work.seed)
            work.draw(picture.figure, f"case-{case.name}", picture.caption)
        what = f"{len(model.blocks)} real parameters ({self.structure}), {model.delta_shape[0]} channels"
        facts = (
            Fact("Uncertain", what),
            Fact("The thesis prints", f"±{quantity(case.published, '%')}", "figures 10.6-10.21"),
            Fact("Change of the torques' gain B alone", quantity(case.gain_percent, "%")),
            Fact("Holding torque, nominal minus perturbed", quantity(case.released, "N m")),
            Fact("Worst end of the set with one parameter", case.worst_in_words),
        )
        return Outcome(model, f"Case {case.name}: {case.words}.", numbers, facts)


def _fact(row: Any) -> Fact:
    """Return a row as a line of the report: published, ours, difference; the reason as its source."""
    limit = {"equal": "", "at most": "at most ", "at least": "at least "}[row.bound]
    published = "not printed" if row.published is None else f"published {limit}{quantity(row.published, row.unit)}"
    ours = "ours: none" if row.ours is None else f"ours {number(row.ours, row.unit, 6)}"
    gap = "" if row.difference is None else f"; difference {number(row.difference, row.unit, 3)}"
    return Fact(f"{row.key} ({row.status}): {row.quantity}, {row.where}", f"{published}; {ours}{gap}", row.why)
