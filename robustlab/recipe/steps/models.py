"""Steps that make models: from physics, from files, from one another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.operations.vocabulary import FileName, NumberOrPair, Text, ToAnything, ToSaved
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Step, Workspace, facts_of, quantity, step


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
        {},
        description='Options beyond numbers: preset = "physical", motors = true, m = [1.0, 2.0] for a chain.',
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
    saved: ToSaved | None = None

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
    of: ToAnything
    file: FileName

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
