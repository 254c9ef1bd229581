"""What a recipe says as a whole (format ``robustlab.recipe/1``); its steps are in `robustlab.recipe.steps`.

The JSON Schema of it is committed as ``recipes/recipe.schema.json``, so that an editor can complete and check recipes.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal, Self, Union

from pydantic import Field, create_model, model_validator
from pydantic_core import PydanticCustomError

from robustlab.recipe.steps.contract import KINDS, Step
from robustlab.recipe.steps.vocabulary import StepName, Strict, Text

STEPS: Any = Field(min_length=1, max_length=200, description="Run in the order written.")


class Requirement(Strict):
    """A statement about a number of a step; together the requirements decide the exit code."""

    that: Annotated[str, Field(min_length=1, max_length=300)] = Field(description='For example "margin.lower".')
    text: Text = Field(description="What is required and why, in a sentence.")
    at_least: float | None = None
    at_most: float | None = None
    within: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    equals: float | bool | str | None = None
    contains: Annotated[str, Field(min_length=1, max_length=300)] | None = Field(
        None, description="A text that a list of texts must have among its items."
    )
    tolerance: Annotated[float, Field(ge=0)] | None = Field(
        None, description="Largest allowed difference from `equals`."
    )
    unit: Annotated[str, Field(max_length=40)] = Field(
        "", description="Unit of the number, shown beside it and its limits. It is a label: nothing is converted."
    )

    @model_validator(mode="after")
    def _one_condition(self) -> Self:
        given = [n for n in ("at_least", "at_most", "within", "equals", "contains") if getattr(self, n) is not None]
        if not given:
            raise PydanticCustomError("condition", "expected at_least, at_most, within, equals or contains")
        if len(given) > 1:
            raise PydanticCustomError("condition", "expected one condition; a range is within = [low, high]")
        if self.within is not None and self.within[0] > self.within[1]:
            raise PydanticCustomError("condition", "within is [low, high], and low is above high")
        if self.tolerance is not None and (isinstance(self.equals, (bool, str)) or self.equals is None):
            raise PydanticCustomError("condition", "tolerance belongs to an equals with a number")
        if self.unit and self.limits is None:
            raise PydanticCustomError("condition", "unit belongs to a condition with a number")
        return self

    @property
    def condition(self) -> str:
        """The condition in words, for example ``at least 1 rad/s``."""
        return f"{self._bare_condition} {self.unit}".rstrip()

    @property
    def _bare_condition(self) -> str:
        if self.at_least is not None:
            return f"at least {self.at_least:.10g}"
        if self.at_most is not None:
            return f"at most {self.at_most:.10g}"
        if self.within is not None:
            return f"between {self.within[0]:.10g} and {self.within[1]:.10g}"
        if self.contains is not None:
            return f"contains {self.contains!r}"
        if isinstance(self.equals, bool):
            return "yes" if self.equals else "no"
        if isinstance(self.equals, str):
            return f"{self.equals!r}"
        margin = f" ± {self.tolerance:.10g}" if self.tolerance else ""
        return f"{self.equals:.10g}{margin}"

    @property
    def limits(self) -> list[float | None] | None:
        """Lowest and highest number that is met, None where there is no such end; None of a condition on no number."""
        if self.within is not None:
            return [*self.within]
        if self.equals is not None and not isinstance(self.equals, (bool, str)):
            return [self.equals - (self.tolerance or 0.0), self.equals + (self.tolerance or 0.0)]
        if self.at_least is None and self.at_most is None:
            return None
        return [self.at_least, self.at_most]


class Recipe(Strict):
    """A whole recipe."""

    schema_: Literal["robustlab.recipe/1"] = Field(alias="schema")
    name: StepName
    title: Text = Field("", description="Heading of the report; the name where left out.")
    description: Annotated[str, Field(max_length=10_000)] = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    step: dict[StepName, Step]
    require: Annotated[list[Requirement], Field(max_length=1000)] = Field([])


def recipe_model() -> type[Recipe]:
    """`Recipe` with its steps told apart by ``do``: every kind that is known by now."""
    return _with_kinds(tuple(KINDS.values()))


@cache
def _with_kinds(kinds: tuple[type[Step], ...]) -> type[Recipe]:
    any_step: Any = Annotated[Union[kinds], Field(discriminator="do")]  # noqa: UP007  made of a tuple
    steps = dict[StepName, any_step]
    return create_model("Recipe", __base__=Recipe, __doc__=Recipe.__doc__, step=(steps, STEPS))


def json_schema() -> dict[str, Any]:
    """The JSON Schema of a recipe, as committed in ``recipes/recipe.schema.json``."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **recipe_model().model_json_schema(by_alias=True),
    }
