"""Types of keys that the steps of recipes share: numbers, names, references and weights."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, WrapValidator
from pydantic_core import PydanticCustomError, ValidationError

from robustlab.operations.kinds import Thing


class Strict(BaseModel):
    """Reject unknown keys, silent conversion (TOML has types), NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, populate_by_name=True)


# "any": the object of a loaded file is known only at run time.
ToModel = Annotated[str, Thing(("plant", "model", "uncertain", "any"))]
ToSaved = Annotated[str, Thing(("saved",))]
ToAnything = Annotated[str, Thing(("plant", "model", "uncertain", "problem", "controller", "record", "any"))]

StepName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*\.h5$", max_length=100)]
Text = Annotated[str, Field(max_length=2000)]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=0, le=1_000_000)]


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


class ReferenceLine(Strict):
    """A known value to draw with a response."""

    output: str
    value: float
    text: Text
