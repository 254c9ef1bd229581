"""Steps of a recipe that make an uncertain model: around a set of models, and of what a discovery found."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from robustlab.recipe.vocabulary import (
    GUARD,
    Effort,
    Positive,
    RefersTo,
    StepBase,
    TimeLimit,
    ToController,
    Tolerance,
    ToOneModel,
    ToRecord,
)

__all__ = ["CoverModelsStep", "UncertainFromStep", "WithLoadsStep"]

ToPlantOrFile = Annotated[str, RefersTo(("plant", "any"))]
AmplitudePair = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Pose = Annotated[list[float], Field(min_length=6, max_length=6)]


class CoverModelsStep(StepBase):
    """The smallest uncertain model of a chosen form that holds every one of a set of models.

    The set: the models of earlier steps, or one plant linearised at several poses, or both.
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
        "ellipsoid",
        "additive",
        "input-multiplicative",
        "output-multiplicative",
        "inverse-additive",
        "inverse-input-multiplicative",
        "inverse-output-multiplicative",
    ] = "elements"
    nominal: ToOneModel | None = Field(None, description="Where left out, the middle, or what makes the set smallest.")
    outputs: list[str] | None = None
    tolerance: Annotated[float, Field(ge=0, lt=1)] = Field(
        1e-9, description="Share of its matrix' largest that an entry may be off: pca, ellipsoid need fewer directions."
    )
    directions: Annotated[int, Field(ge=1, le=100)] | None = Field(None, description="Of pca and ellipsoid.")
    order: Annotated[int, Field(ge=0, le=12)] = Field(4, description="Largest order of the weight of a full block.")
    excess: Tolerance = Field(0.1, description="How far above the bound a weight of lower order may be.")
    controller: ToController | None = Field(
        None, description="Closed around the models and the cover, u = K (r - y), before their gains are compared."
    )
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


class UncertainFromStep(StepBase):
    """An uncertain model of what a `discover` step found and left unexplained; each block says where it comes from."""

    gives: ClassVar[str] = "uncertain"
    do: Literal["uncertain-from"]
    of: ToPlantOrFile = Field(description="A discover step, a plant, or the file of an updated plant.")
    outputs: list[str] | None = None
    amplitude: dict[str, Positive | AmplitudePair] = Field(
        {}, description="Of the signal of a joint, position, input or output: at which the effects are described there."
    )
    dry: Literal["load", "gain", "both"] | None = Field(
        None,
        description="Dry friction and other bounded forces: load, an input, exact at any speed; gain, that of the "
        "describing function; where left out, a gain where an amplitude is given, else a load.",
    )
    sigmas: Annotated[float, Field(ge=0, le=10)] = Field(
        2.0, description="Half width of the range of a fitted value in its standard deviations."
    )
    pade: Annotated[int, Field(ge=1, le=8)] = Field(2, description="Order of the Padé approximation of delays.")


class WithLoadsStep(StepBase):
    """A record with the bounded forces of a plant's effects as further inputs, as the plant itself makes them.

    A set that takes such forces as inputs (`uncertain-from` without amplitudes) needs them for `validate` or `cover`.
    """

    gives: ClassVar[str] = "record"
    do: Literal["with-loads"]
    of: ToPlantOrFile = Field(description="A discover step, or a plant with effects.")
    record: ToRecord
    sigmas: Annotated[float, Field(ge=0, le=10)] = Field(2.0, description="As in the step that made the set.")
