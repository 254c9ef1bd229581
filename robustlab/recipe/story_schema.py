"""What a recipe may say about the way from a record to a better controller: covers by records, and the whole story."""

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
    Text,
    TimeLimit,
    ToController,
    ToRecord,
    ToUncertain,
)

__all__ = ["DataCoverStep", "StoryStep"]

ToPlantOrFile = Annotated[str, RefersTo(("plant", "any"))]
ToPerformance = Annotated[str, RefersTo(("performance",))]
ToRuns = Annotated[str, RefersTo(("runs",))]
BeforeAfter = Field(min_length=2, max_length=2)


class DataCoverStep(StepBase):
    """The set of models around a plant that explains its records: tolerances, and the smallest unmodelled dynamics.

    Effects of the plant become bounded inputs ("load *") that are known along a record.
    """

    gives: ClassVar[str] = "uncertain"
    do: Literal["data-cover"]
    of: ToPlantOrFile
    records: Annotated[list[ToRecord], Field(min_length=1, max_length=20)]
    held_out: list[ToRecord] = Field([], description="Records on which the set is checked; they do not change it.")
    noise: Annotated[dict[str, Positive], Field(min_length=1)] = Field(
        description="Output that is compared -> largest noise, in its unit."
    )
    margin: Annotated[float, Field(ge=1)] = Field(
        1.1, description="Radius over the smallest that explains the records."
    )
    least: Annotated[float, Field(ge=0, lt=1)] = Field(0.02, description="Smallest radius of any set.")
    window: Positive | None = Field(
        None, description="s; each window with a free start. The whole record where left out."
    )
    at_rest: bool = Field(False, description="The records start at rest.")
    decimate: Annotated[int, Field(ge=1, le=100)] = Field(
        1, description="Keep every so-many-th sample; inputs are averaged in between."
    )
    effort: Effort = Field(1.0, description="Multiple of the usual work, for each record.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


class StoryStep(StepBase):
    """One picture from the gap to the better controller, before and after an effect was named; first in the report.

    Every list holds two entries: before and after.
    """

    do: Literal["story"]
    record: ToRecord | None = Field(None, description="Record that both plants are simulated against, from rest.")
    output: Text = Field("", description="Output of the record to draw; the first where left out.")
    plants: Annotated[list[ToPlantOrFile], BeforeAfter] | None = None
    covers: Annotated[list[ToUncertain], BeforeAfter] | None = Field(None, description="data-cover steps.")
    performance: Annotated[list[ToPerformance], BeforeAfter] = Field(description="robust-performance steps.")
    controllers: Annotated[list[ToController], BeforeAfter]
    runs: ToRuns = Field(description="simulate-control or follow-trajectory step with both controllers.")

    @model_validator(mode="after")
    def _together(self) -> Self:
        if (self.record is None) != (self.plants is None):
            raise PydanticCustomError("together", "record and plants belong together")
        return self
