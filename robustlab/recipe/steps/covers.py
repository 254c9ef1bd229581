"""Steps from records and models to sets that hold them."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.operations.vocabulary import (
    GUARD,
    Effort,
    Feedback,
    Names,
    Positive,
    TimeLimit,
    ToController,
    Tolerance,
    ToOneModel,
    ToPlantOrFile,
    ToRecord,
)
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Step, Workspace, facts_of, quantity, step

if TYPE_CHECKING:
    from robustlab.dynamics.extended.effect_blocks import NoiseInput


@step
class DataCoverStep(Step):
    """The set of models around a plant that explains its records: tolerances, and the smallest unmodelled dynamics.

    Effects of the plant become bounded inputs ("load *") that are known along a record.
    """

    gives: ClassVar[str] = "uncertain"
    do: Literal["data-cover"]
    of: ToPlantOrFile
    records: Annotated[list[ToRecord], Field(min_length=1, max_length=20)]
    held_out: list[ToRecord] = Field([], description="Records on which the set is checked; they do not change it.")
    noise: Annotated[dict[str, Positive], Field(min_length=1), Names("outputs")] = Field(
        description="Output that is compared -> largest noise, in its unit."
    )
    margin: Annotated[float, Field(ge=1)] = Field(
        1.1, description="Radius over the smallest that explains the records."
    )
    least: Annotated[float, Field(ge=0, lt=1)] = Field(0.02, description="Smallest radius of any set.")
    window: Positive | None = Field(
        None, description="s; each window with a free initial state. The whole record where left out."
    )
    at_rest: bool = Field(False, description="The records start at rest.")
    decimate: Annotated[int, Field(ge=1, le=100)] = Field(
        1, description="Keep every n-th sample; inputs are averaged in between."
    )
    effort: Effort = Field(1.0, description="Multiple of the usual work, for each record.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def infer(self, ahead: Ahead) -> Inferred:
        from robustlab.identification.validation.data_cover import DataCover

        leaves = {f.name: ... for f in fields(DataCover)} | {"passes": ..., "blocks": ..., "loads": {"*": ...}}
        # The loads of the plant's effects come before its inputs.
        return Inferred(outputs=ahead[self.of].outputs, leaves=leaves)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.report.set_figures import validation_figure

        def thinned(name: str) -> Any:
            # An input is averaged until the next kept sample, over which it is then held.
            r, k = work.wanted(name, rl.Record), self.decimate
            n = r.n // k
            inputs = {key: u[: n * k].reshape(n, k).mean(axis=1) for key, u in r.inputs.items()}
            outputs = {key: y[: n * k : k] for key, y in r.outputs.items()}
            return rl.Record(r.t[: n * k : k], inputs, outputs, r.units, name, r.meaning)

        found = rl.data_cover(
            work.values[self.of], [thinned(n) for n in self.records], self.noise,
            held_out=[thinned(n) for n in self.held_out], margin=self.margin, least=self.least, window=self.window,
            at_rest=self.at_rest, effort=self.effort, time_limit=self.time_limit,
        )  # fmt: skip
        work.keep(found)
        if found.model is None:
            raise NoTrustworthyNumber(
                "data-cover", f"no unmodelled dynamics of {self.of} explains {', '.join(self.records)}",
                "a larger noise bound, or a plant that is nearer",
            )  # fmt: skip
        for name, validation in found.validations.items():
            for output, _ in validation.outputs:
                caption = f"{name} as recorded, of the nominal model, and as the smallest Δ explains it."
                work.draw(validation_figure(validation, output), f"{name}-{output}", caption)
        facts = (
            *facts_of(found),
            *(Fact(x.name, f"at most {quantity(x.bound, x.unit)}", x.origin) for x in found.loads),
        )
        summary = f"The set of models around {self.of} that explains {', '.join(self.records)}."
        return Outcome(found.model, summary, found.numbers(), facts, found.status, found.notes, found.summary())


Pose = Annotated[list[float], Field(min_length=6, max_length=6)]


@step
class CoverModelsStep(Step):
    """The smallest uncertain model of a chosen form that contains a set of models.

    The set: the models of earlier steps, or one plant linearised at several poses, or both. Of a plant with effects,
    as after `discover`, those that have no linear model (dry friction) become bounded inputs ("load *"), exact for
    every motion: a tracking problem takes them as loads.
    """

    gives: ClassVar[str] = "uncertain"
    do: Literal["cover-models"]
    models: Annotated[list[ToOneModel], Field(max_length=100)] = Field([])
    of: ToPlantOrFile | None = Field(None, description="A mechanism, linearised at each of `poses`.")
    poses: Annotated[list[Pose], Field(max_length=100)] = Field(
        [], description="Operating points: tx, ty, tz in m, ax, ay, az in rad."
    )
    form: Literal[
        "elements",
        "pca",
        "additive",
        "input-multiplicative",
        "output-multiplicative",
        "inverse-additive",
        "inverse-input-multiplicative",
        "inverse-output-multiplicative",
    ] = "elements"
    nominal: ToOneModel | None = Field(
        None, description="Where left out, the middle, or the model of the smallest set."
    )
    outputs: Annotated[list[str], Names("outputs")] | None = None
    tolerance: Annotated[float, Field(ge=0, lt=1)] = Field(
        1e-9, description="Allowed error of an entry, relative to its matrix' largest: pca needs fewer directions."
    )
    directions: Annotated[int, Field(ge=1, le=100)] | None = Field(None, description="Of pca.")
    order: Annotated[int, Field(ge=0, le=12)] = Field(4, description="Largest order of the weight of a full block.")
    excess: Tolerance = Field(0.1, description="How far above the bound a weight of lower order may be.")
    controller: ToController | None = Field(
        None, description="Closed around the models and the cover before their gains are compared."
    )
    sign: Feedback = None
    conservatism: bool = Field(True, description="Compare the worst gain of the cover with that of the set.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof of the worst gain.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    @model_validator(mode="after")
    def _is_a_set(self) -> Self:
        if (self.of is None) != (not self.poses):
            raise PydanticCustomError("poses", "of and poses belong together")
        if len(self.models) + len(self.poses) < 2:
            raise PydanticCustomError("set", "expected at least two models, or of with at least two poses")
        return self

    def infer(self, ahead: Ahead) -> Inferred:
        from robustlab.mu_analysis.margins.cover import Cover

        source = ahead[self.of if self.of is not None else self.models[0]]
        return replace(source.select(self.outputs), inputs=None, leaves={**Cover.quantities, "loads": {"*": float}})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.report.set_figures import cloud_figure, weight_figure
        from robustlab.synthesis.specifications.tracking import tracking_loop, with_law

        models = [_selected(work.values[name], self.outputs) for name in self.models]
        at_poses = [_at_pose(work.values[self.of], pose) for pose in self.poses] if self.of is not None else []
        models += [_selected(model, self.outputs) for model, _ in at_poses]
        words, loop = "", None
        if self.controller is not None:  # one sign for all: that of the first
            K, words = with_law(models[0], work.values[self.controller], self.sign)
            loop = partial(tracking_loop, controller=K)
        nominal = None if self.nominal is None else _selected(work.values[self.nominal], self.outputs)
        found = rl.cover(
            models, self.form, nominal=nominal, tolerance=self.tolerance, directions=self.directions, order=self.order,
            excess=self.excess, loop=loop, gain=self.conservatism,
            effort=self.effort, time_limit=self.time_limit,
        )  # fmt: skip
        work.keep(found)
        if found.fit is not None:
            caption = "The weight, and below it the error of every model against the nominal one."
            work.draw(weight_figure(found, models), "weight", caption)
        elif found.model.blocks:
            work.draw(cloud_figure(found), "cloud", "Every model as a point in the box of the parameters.")
        numbers, facts = found.numbers(), (*facts_of(found), *([Fact("Loop", words)] if words else []))
        loads = at_poses[0][1] if at_poses else ()
        numbers["loads"] = {load.name: load.bound for load in loads}
        facts += tuple(Fact(x.name, f"at most {quantity(x.bound, x.unit)}", x.origin) for x in loads)
        return Outcome(found.model, f"{found.headline()}.", numbers, facts, found.status, found.notes, found.tables())


@step
class WithLoadsStep(Step):
    """A record with the bounded forces of a plant's effects as further inputs, computed by the plant.

    A set that takes such forces as inputs (`uncertain-from` without amplitudes) needs them for `validate` or `cover`.
    """

    gives: ClassVar[str] = "record"
    leaves: ClassVar[Any] = {"largest": {"*": "1"}, "bound": {"*": float}}
    do: Literal["with-loads"]
    of: ToPlantOrFile = Field(description="A discover step, or a plant with effects.")
    record: ToRecord
    sigmas: Annotated[float, Field(ge=0, le=10)] = Field(2.0, description="As in the step that made the set.")

    def infer(self, ahead: Ahead) -> Inferred:
        return Inferred(outputs=ahead[self.record].outputs)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.extended.effect_blocks import effect_loads

        record = work.wanted(self.record, rl.Record)
        made = effect_loads(work.values[self.of], self.sigmas, [record])
        shown = made.along(record)
        largest = {load.name: float(abs(shown[load.name]).max()) for load in made.loads}
        facts = tuple(
            Fact(
                load.name,
                f"at most {quantity(load.bound, load.unit)}; along the record {largest[load.name]:.3g} of it",
                load.origin,
            )
            for load in made.loads
        )
        numbers = {"largest": largest, "bound": {load.name: load.bound for load in made.loads}}
        summary = f"{self.record} with {len(made.loads)} loads of {self.of} as known inputs."
        return Outcome(shown, summary, numbers, facts)


def _at_pose(plant: Any, pose: list[float]) -> tuple[rl.StateSpaceModel, tuple[NoiseInput, ...]]:
    """Linearise a plant at a pose; return the model with the effects' loads before its inputs, and the loads."""
    from robustlab.dynamics.extended.effect_blocks import loaded_model
    from robustlab.dynamics.extended.extended_plant import ExtendedNonlinearPlant

    at = rl.trim(plant, pose=pose)
    return loaded_model(plant, at) if isinstance(plant, ExtendedNonlinearPlant) else (rl.linearise(plant, at=at), ())


def _selected(given: Any, outputs: list[str] | None) -> rl.StateSpaceModel:
    """Return a model, of a plant its linearisation, with the outputs that are kept."""
    from robustlab.dynamics import Plant
    from robustlab.linear_analysis.structural import drop_unconnected
    from robustlab.statespace import as_model

    model = rl.linearise(given) if isinstance(given, Plant) else as_model(given)
    return model if outputs is None else drop_unconnected(model.select(outputs=outputs))
