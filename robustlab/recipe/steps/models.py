"""Steps that make models: from physics, from files, from one another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.errors import InputError, unknown_name
from robustlab.recipe.steps.contract import (
    Ahead,
    Fact,
    Foretold,
    Outcome,
    Step,
    Workspace,
    facts_of,
    least_trusted,
    quantity,
    step,
    told,
)
from robustlab.recipe.steps.leaves import COMPLEX
from robustlab.recipe.steps.vocabulary import (
    Band,
    FileName,
    Names,
    NumberOrPair,
    Positive,
    RefersTo,
    RelativeTolerance,
    Text,
    ToAnything,
    ToModel,
    ToOneModel,
    ToPlant,
    ToSaved,
    as_pair,
)

# What is left of a model, and of an uncertain one.
MODEL: dict[str, Any] = {
    "states": "1", "inputs": [str], "outputs": [str], "spectral_abscissa": float, "poles": [COMPLEX],
}  # fmt: skip
RANK = {"rank": "1", "states": "1", "full": bool}
UNCERTAIN: dict[str, Any] = {"blocks": [str], "channels": "1", "states": "1", "sampled": [str]}


def model_leaves(told: Foretold, leaves: Mapping[str, Any] = MODEL) -> dict[str, Any]:
    """What is left of a model with these signals: its lists are as long as these."""
    sides = {"inputs": told.inputs, "outputs": told.outputs}
    poles = {"poles": (COMPLEX,) * told.value.n_states} if isinstance(told.value, rl.StateSpaceModel) else {}
    return {**leaves, **{side: (str,) * len(names) for side, names in sides.items() if names is not None}, **poles}


def same_signals(self: Any, ahead: Ahead) -> Foretold:
    """What steps foretell that change a model and not its signals."""
    return ahead[self.of].select(None)


@step
class PlantStep(Step):
    """A plant from physics."""

    gives: ClassVar[str] = "plant"
    do: Literal["plant"]
    plant: str = Field(
        description='Name of the plant, for example "dc-motor"; or "file.py:name", beside the recipe: that file is run.'
    )
    parameters: dict[str, NumberOrPair] = Field(
        {}, description='Values in SI units, [value, relative tolerance], or texts: "0.5 mH", "10%".'
    )
    choices: dict[str, str | bool | list[float]] = Field(
        {}, description='What is no single number: preset = "physical", motors = true, m = [1.0, 2.0] for a chain.'
    )

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        twice = sorted(set(self.parameters) & set(self.choices))
        if twice:
            raise PydanticCustomError("named_once", "{name} is among parameters and choices", {"name": twice[0]})
        return self

    @property
    def _given(self) -> dict[str, Any]:
        return {name: tuple(value) if isinstance(value, list) else value for name, value in self.parameters.items()}

    def foretell(self, ahead: Ahead) -> Foretold:
        parameter: dict[str, Any] = {"value": float, "unit": str, "tolerance": "1"}
        if ahead.step in ahead.sources:  # code of the user's is run when the recipe is
            return Foretold(leaves={"code": {"*": str}, "parameters": {"*": parameter}})
        made: Any = rl.plant(self.plant, **self._given, **self.choices)
        parameters = {name: {**parameter, "value": p.unit} for name, p in made.parameters.items()}
        return Foretold.of(made, {"parameters": parameters})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.plant_file import plant_from_file, unit_reference
        from robustlab.provenance import code_of

        given = self._given
        facts: list[Fact] = []
        numbers: dict[str, Any] = {}
        if work.step in work.sources:
            source, given = work.sources[work.step], {**given, **self.choices}
            unit = unit_reference(self.plant)
            made: Any = rl.plant(str(source), **given) if unit else plant_from_file(self.plant, given, source)
            numbers["code"] = code_of(made)
            facts = [Fact(f"Code of {self.plant}", f"SHA-256 {sha}", file) for file, sha in numbers["code"].items()]
            work.inputs.update({f"{work.step}: {Path(file).name}": sha for file, sha in numbers["code"].items()})
        else:
            made = rl.plant(self.plant, **given, **self.choices)
        for p in made.parameters.values():
            spread = f" ± {p.tolerance_text}" if p.tolerance else ""
            facts.append(Fact(f"{p.name}, {p.meaning}", f"{quantity(p.value, p.unit)}{spread}", p.source))
        numbers["parameters"] = {
            name: {"value": p.value, "unit": p.unit, "tolerance": p.tolerance} for name, p in made.parameters.items()
        }
        signals = " → ".join(", ".join(f"{s.name} [{s.unit}]" for s in side) for side in (made.inputs, made.outputs))
        return Outcome(made, f"Plant {self.plant}: {signals}.", numbers, tuple(facts))


@step
class LineariseStep(Step):
    """The linear state-space model of a plant; states that the kept outputs do not show are left out."""

    gives: ClassVar[str] = "model"
    leaves: ClassVar[Any] = MODEL
    do: Literal["linearise"]
    of: ToPlant
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | dict[str, float] | None = Field(
        None,
        description="Pose of a mechanism: tx, ty, tz in m, ax, ay, az in rad; or where another plant that is not linear"
        " rests: states, inputs and outputs by name. Home, or the rest nearest to zero, where left out.",
    )
    outputs: Annotated[list[str], Names("outputs")] | None = None

    def foretell(self, ahead: Ahead) -> Foretold:
        told = ahead[self.of].select(self.outputs)
        return replace(told, leaves=model_leaves(told))

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics import LinearPlant
        from robustlab.linear_analysis.structural import drop_unconnected

        given = work.values[self.of]
        if self.at is not None and isinstance(given, LinearPlant):
            raise InputError("at", f"a rest of {self.of}, which is linear", "none: the model is the same everywhere")
        model = rl.linearise(given, at=rl.trim(given, **self.at) if isinstance(self.at, dict) else self.at)
        if self.outputs is not None:
            model = drop_unconnected(model.select(outputs=self.outputs))
        where = ""
        if isinstance(self.at, dict):
            where = f" at {', '.join(f'{name} = {value:g}' for name, value in self.at.items())}"
        elif self.at is not None:
            where = f" at the pose {', '.join(f'{value:g}' for value in self.at)}"
        return Outcome(model, f"State-space model of {self.of}{where}.", _model_numbers(model), _model_facts(model))


@step
class LoadStep(Step):
    """A model from an HDF5 file: a path, or the file that an earlier step saved."""

    gives: ClassVar[str] = "any"
    leaves: ClassVar[Any] = {"kind": str, "verified": bool, **MODEL}
    do: Literal["load"]
    path: Text | None = None
    saved: ToSaved | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.path is None) == (self.saved is None):
            raise PydanticCustomError("one_source", "expected either path or saved")
        return self

    def foretell(self, ahead: Ahead) -> Foretold:
        from robustlab.storage import read

        if self.saved is not None:
            return replace(ahead[self.saved], leaves=self.leaves)
        told = Foretold.of(read(ahead.sources[ahead.step]).object)
        is_model = isinstance(told.value, rl.StateSpaceModel)
        return replace(told, leaves=model_leaves(told, self.leaves)) if is_model else told

    def run(self, work: Workspace) -> Outcome:
        from robustlab.storage import read

        path = work.sources[work.step] if self.saved is None else work.values[self.saved]
        loaded = read(path)
        found: Any = loaded.object
        kind = type(found).__name__
        model = found.to_model() if hasattr(found, "to_model") else found
        is_model = isinstance(model, rl.StateSpaceModel)
        proof = "its checksums and content hash are right" if loaded.verified else "it carries no content hash to check"
        return Outcome(
            found,
            f"{kind} read from {path.name}; {proof}.",
            {"kind": kind, "verified": loaded.verified, **(_model_numbers(model) if is_model else {})},
            _model_facts(model) if is_model else (),
            notes=loaded.warnings,
        )


@step
class SaveStep(Step):
    """Write the object of an earlier step to an HDF5 file in the output folder."""

    gives: ClassVar[str] = "saved"
    leaves: ClassVar[Any] = {"sha256": str}
    do: Literal["save"]
    of: ToAnything
    file: FileName

    foretell = same_signals

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics import NonlinearPlant
        from robustlab.provenance import file_sha256

        path = work.folder / self.file
        given = work.values[self.of]
        if hasattr(given, "to_uncertain"):  # a tracking problem is kept as its generalised plant
            given = given.to_uncertain()
        if not isinstance(given, (rl.StateSpaceModel, rl.UncertainModel, rl.Record, rl.Controller, NonlinearPlant)):
            given = given.to_model()  # a linear plant without effects is kept as its linear model
        rl.save(path, given, work.provenance())
        work.files.append(self.file)
        digest = file_sha256(path)
        return Outcome(
            path,
            f"{type(given).__name__} of {self.of} written to {self.file}.",
            {"sha256": digest},
            (Fact("SHA-256", digest),),
        )


@step
class StructuralStep(Step):
    """Controllability and observability."""

    leaves: ClassVar[Any] = {"controllability": RANK, "observability": RANK}
    do: Literal["structural"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        model = work.values[self.of]
        parts = {"controllability": rl.controllability(model), "observability": rl.observability(model)}
        numbers: dict[str, Any] = {
            name: {"rank": part.rank, "states": part.n_states, "full": part.rank == part.n_states}
            for name, part in parts.items()
        }
        facts = tuple(
            Fact(f"{name.capitalize()} rank", f"{part.rank} of {part.n_states} states") for name, part in parts.items()
        )
        statuses = [part.status for part in parts.values()]
        return Outcome(None, f"Structure of {self.of}.", numbers, facts, least_trusted(statuses))


@step
class ZerosStep(Step):
    """Finite invariant zeros of a model with their kinds."""

    leaves: ClassVar[Any] = {
        "values": [COMPLEX], "kinds": [str], "normal_rank": "1", "count": "1", "not_minimum_phase": "1",
    }  # fmt: skip
    do: Literal["zeros"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model

        model = as_model(work.values[self.of], self.of)
        found = rl.zeros(model)
        outside = abs(found.values) >= 1 if model.is_discrete else found.values.real >= 0
        numbers = {
            "values": found.values, "kinds": list(found.kinds), "normal_rank": found.normal_rank, "count": len(found),
            "not_minimum_phase": int(outside.sum()),
        }  # fmt: skip
        facts = (*facts_of(found), Fact("On the boundary or beyond", str(int(outside.sum()))))
        return Outcome(None, f"Zeros of {self.of}.", numbers, facts, found.status)


@step
class SteadyStateStep(Step):
    """Outputs in steady state under constant inputs; inputs left out are zero."""

    do: Literal["steady-state"]
    of: ToModel
    inputs: Annotated[dict[str, float], Names("inputs")]
    outputs: Annotated[list[str], Names("outputs")] | None = None

    def foretell(self, ahead: Ahead) -> Foretold:
        kept = ahead[self.of].select(self.outputs).outputs
        return Foretold(leaves={"outputs": {"*": float} if kept is None else dict(kept)})

    def run(self, work: Workspace) -> Outcome:

        from robustlab.linear_analysis.structural import drop_unconnected
        from robustlab.statespace import as_model

        model = as_model(work.values[self.of])
        if self.outputs is not None:
            model = drop_unconnected(model.select(outputs=self.outputs))
        for name in self.inputs:
            if name not in model.input_names:
                raise unknown_name(f"inputs.{name}", "no such input", name, model.input_names)
        if not model.is_stable():
            raise InputError(
                f"model {self.of}",
                "is not stable, so it has no steady state",
                "a stable model",
                "keep only outputs that settle with outputs = [...]",
            )
        u = np.array([self.inputs.get(name, 0.0) for name in model.input_names])
        y = model.dc_gain() @ u
        numbers = {s.name: float(value) for s, value in zip(model.outputs, y, strict=True)}
        facts = tuple(Fact(s.name, quantity(float(value), s.unit)) for s, value in zip(model.outputs, y, strict=True))
        inputs = ", ".join(
            f"{s.name} = {quantity(self.inputs[s.name], s.unit)}" for s in model.inputs if s.name in self.inputs
        )
        return Outcome(None, f"Steady state of {self.of} at {inputs}.", {"outputs": numbers}, facts)


@step
class UncertainStep(Step):
    """An uncertain model of a plant: each parameter in `tolerances` varies by that share of its value, 0.05 or "5%"."""

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = UNCERTAIN
    do: Literal["uncertain"]
    of: ToPlant
    tolerances: Annotated[dict[str, RelativeTolerance], Field(min_length=1), Names("parameters")]
    outputs: Annotated[list[str], Names("outputs")] | None = None
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | dict[str, float] | None = Field(
        None, description="Nonlinear plants: pose tx, ty, tz in m, ax, ay, az in rad, or states, inputs, outputs."
    )
    hold: list[str] | None = Field(
        None, description="Nonlinear plants: states and inputs that stay while the parameters change."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        return ahead[self.of].select(self.outputs)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics import LinearPlant

        given = work.values[self.of]
        exact = {name: (p.value, 0.0) for name, p in given.parameters.items()}
        ranges = {name: (given.values.get(name, 1.0), tolerance) for name, tolerance in self.tolerances.items()}
        made = given.with_parameters(**{**exact, **ranges})
        rest = {key: value for key, value in (("at", self.at), ("hold", self.hold)) if value is not None}
        if rest and isinstance(made, LinearPlant):
            raise InputError(next(iter(rest)), f"{self.of} is linear", "it for a nonlinear plant only")
        model = made.uncertain(self.outputs, **rest)
        facts = [Fact(b.name, _range(b), b.origin) for b in model.blocks]
        kind = "Sampled" if model.sampled else "Exact"
        summary = f"{kind} uncertain model of {self.of}; uncertain: {', '.join(b.name for b in model.blocks)}."
        return Outcome(model, summary, uncertain_numbers(model), tuple(facts), notes=model.remarks)


@step
class ReduceModelStep(Step):
    """A model of lower order, its error certified; modes that are not stable are kept, but for "coprime"."""

    gives: ClassVar[str] = "model"
    leaves: ClassVar[Any] = {
        "order": "1", "error": float, "states": "1", "bound": float, "n_apart": "1", "hankel": [float], "stable": bool,
    }  # fmt: skip
    do: Literal["reduce-model"]
    of: ToOneModel
    order: Annotated[int, Field(ge=0, le=1000)] | None = None
    tolerance: Positive | None = Field(None, description="In place of order: largest error, as it is told.")
    method: Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"] = "truncation"
    input_weight: ToOneModel | None = Field(None, description="A stable model W_i: the error is W_o (G - Gr) W_i.")
    output_weight: ToOneModel | None = Field(None, description="The same for W_o.")
    band: Band | None = Field(None, description="[low, high] in rad/s: the error between these alone.")
    floor: Annotated[float, Field(ge=0)] = Field(
        0.0, description="Of stochastic: gain below which errors count absolutely."
    )

    @model_validator(mode="after")
    def _one_measure(self) -> Self:
        if (self.order is None) == (self.tolerance is None):
            raise PydanticCustomError("one_measure", "expected either order or tolerance")
        return self

    foretell = same_signals

    def run(self, work: Workspace) -> Outcome:
        weights = {
            name: None if given is None else work.values[given]
            for name, given in (("input_weight", self.input_weight), ("output_weight", self.output_weight))
        }
        found = rl.reduce_model(
            work.values[self.of], self.order, tolerance=self.tolerance, method=self.method,
            band=as_pair(self.band), floor=self.floor, **weights,
        )  # fmt: skip
        return told(found, found.model, f"{self.of} with {found.order} states.", found.numbers(), work)


@step
class ResampleStep(Step):
    """A model with another sample time: a continuous one discretised, a discrete one resampled or made continuous.

    The digital form of a controller, judged in its loop, is the step `discretise`.
    """

    gives: ClassVar[str] = "model"
    leaves: ClassVar[Any] = {**MODEL, "dt": "s", "error": float}
    do: Literal["resample"]
    of: ToOneModel
    dt: Annotated[float, Field(ge=0)] = Field(description="Sample time in s; 0: continuous.")
    method: Literal["zoh", "foh", "tustin"] = "zoh"

    foretell = same_signals

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model

        model = as_model(work.values[self.of], self.of)
        if not model.is_discrete:
            if not self.dt:
                raise InputError("dt", f"0, and {self.of} is continuous", "a sample time in s")
            made, found = rl.discretise(model, self.dt, self.method), None
        else:
            found = rl.d2d(model, self.dt, self.method) if self.dt else rl.d2c(model, self.method)
            made = found.model
        facts = _model_facts(made) + (() if found is None else facts_of(found))
        summary = f"{self.of} with a sample time of {self.dt:g} s." if self.dt else f"{self.of} in continuous time."
        numbers = {**_model_numbers(made), "dt": made.dt} | ({} if found is None else {"error": found.error})
        return Outcome(made, summary, numbers, facts, None if found is None else found.status)


ToPart = Annotated[str, RefersTo(("plant", "model", "uncertain", "controller", "any"))]


@step
class ConnectStep(Step):
    """Models wired by the names of their signals: an output feeds every input of the same name."""

    gives: ClassVar[str] = "any"  # an uncertain model where a part is one
    leaves: ClassVar[Any] = {**UNCERTAIN, **MODEL}
    do: Literal["connect"]
    parts: Annotated[list[ToPart], Field(min_length=1, max_length=100)]
    inputs: list[str] = Field(description="Signals from outside, in this order.")
    outputs: list[str] = Field(description="Signals to show, in this order.")
    sums: list[Text] = Field([], description='Summing junctions: "e = r - y" makes the signal e.')

    def foretell(self, ahead: Ahead) -> Foretold:
        units: dict[str, str] = {}
        for part in self.parts:
            units |= {**(ahead[part].inputs or {}), **(ahead[part].outputs or {})}
        return Foretold(None, *({name: units.get(name, "") for name in side} for side in (self.inputs, self.outputs)))

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.uncertainty.named_wiring import connected

        given = [work.values[name] for name in self.parts]
        found = connected(given, self.parts, self.inputs, self.outputs, self.sums)
        numbers = uncertain_numbers(found) if isinstance(found, rl.UncertainModel) else {}
        model = as_model(found)
        sums = f" and {len(self.sums)} sums" if self.sums else ""
        summary = f"{', '.join(self.parts)}{sums}, wired by the names of their signals."
        return Outcome(found, summary, {**numbers, **_model_numbers(model)}, _model_facts(model))


@step
class ElementwiseStep(Step):
    """An uncertain model from a nominal model and the same model perturbed as far as it may go."""

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = {**UNCERTAIN, "endpoint_residual": "1"}
    do: Literal["elementwise"]
    nominal: ToModel
    perturbed: ToModel
    structure: Literal["elements", "columns", "rows", "matrices", "single", "cover"] = Field(
        "elements", description="cover: a full block for each matrix, which holds every element-wise member."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        return ahead[self.nominal].select(None)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.uncertainty.covering.elementwise_cover import elementwise_cover
        from robustlab.uncertainty.elementwise import endpoint_residual

        perturbed = work.values[self.perturbed]
        if self.structure == "cover":
            cover = elementwise_cover(work.values[self.nominal], perturbed)
            facts = (Fact("Blocks of Δ", ", ".join(f"{b.name} {b.rows} x {b.cols}" for b in cover.blocks) or "none"),)
            note = "Contains every member of the element-wise set: what is proved for it is proved for them."
            summary = f"Cover of the element-wise uncertainty from {self.nominal} and {self.perturbed}."
            return Outcome(cover, summary, uncertain_numbers(cover), facts, notes=(note,))
        model = rl.elementwise(work.values[self.nominal], perturbed, self.structure)
        residual = endpoint_residual(model, perturbed).largest
        numbers = {**uncertain_numbers(model), "endpoint_residual": residual}
        facts = (
            Fact("Structure", self.structure),
            Fact("Blocks of Δ", ", ".join(b.name for b in model.blocks) or "none: the models are equal"),
            Fact("Largest relative difference to the perturbed model at Δ = I", f"{residual:.2g}"),
        )
        status = rl.Status.CERTIFIED if residual <= 1e-12 else rl.Status.INACCURATE
        notes = ("No uncertainty: nominal and perturbed model are equal.",) if not model.blocks else ()
        return Outcome(
            model, f"Element-wise uncertainty from {self.nominal} and {self.perturbed}.", numbers, facts, status, notes
        )


def _model_numbers(model: Any) -> dict[str, Any]:
    return {
        "states": model.n_states,
        "inputs": list(model.input_names),
        "outputs": list(model.output_names),
        "spectral_abscissa": model.spectral_abscissa(),
        "poles": model.poles(),
    }


def _model_facts(model: Any) -> tuple[Fact, ...]:
    poles = ", ".join(
        f"{p.real:.5g}{p.imag:+.5g}j" if p.imag else f"{p.real:.5g}" for p in sorted(model.poles(), key=abs)[:12]
    )
    return (
        Fact("States", ", ".join(model.state_names) or "none"),
        Fact("Poles", f"{poles or 'none'} {'rad/s' if not model.dt else ''}"),
    )


def uncertain_numbers(model: Any) -> dict[str, Any]:
    """Size of an uncertain model, for requirements."""
    numbers = {"blocks": [b.name for b in model.blocks], "channels": model.delta_shape[0], "states": model.M.n_states}
    return {**numbers, "sampled": list(model.sampled)} if model.sampled else numbers


def _range(block: Any) -> str:
    p = block.parameter
    if p is None:
        return f"{block.rows} channels"
    return f"{quantity(p.low)} … {quantity(p.high, p.unit)}"
