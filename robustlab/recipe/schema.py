"""A recipe as a whole (format ``robustlab.recipe/1``), its JSON Schema, and how its requirements are judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, Self, Union

from pydantic import Field, create_model, model_validator
from pydantic_core import PydanticCustomError

from robustlab.errors import InputError
from robustlab.recipe.steps.step import KINDS, Step, Strict, Text, nothing_there

StepName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]
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
        None, description="A text that a list of texts must contain."
    )
    tolerance: Annotated[float, Field(ge=0)] | None = Field(
        None, description="Largest allowed difference from `equals`."
    )
    unit: Annotated[str, Field(max_length=40)] = Field(
        "", description="Unit of the number, shown with it and its limits. It is a label: nothing is converted."
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
        """Return the condition as text, for example ``at least 1 rad/s``."""
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
        """Return the lowest and highest number that meets it, None for an open end; None of a condition on text."""
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
    verify: bool = Field(
        False, description="Verify the results of all steps again, from the files that the run writes; see rl.verify."
    )
    step: dict[StepName, Step]
    require: Annotated[list[Requirement], Field(max_length=1000)] = Field([])


def recipe_model() -> type[Recipe]:
    return _with_kinds(tuple(KINDS.values()))


@cache
def _with_kinds(kinds: tuple[type[Step], ...]) -> type[Recipe]:
    any_step: Any = Annotated[Union[kinds], Field(discriminator="do")]  # noqa: UP007  made of a tuple
    steps = dict[StepName, any_step]
    return create_model("Recipe", __base__=Recipe, __doc__=Recipe.__doc__, step=(steps, STEPS))


def json_schema() -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **recipe_model().model_json_schema(by_alias=True),
    }


@dataclass(frozen=True)
class Judgement:
    """A requirement and its judgement."""

    requirement: Requirement
    value: Any  # the value found, or None
    met: bool
    why_not: str = ""  # why it cannot be judged; empty where it was
    misstated: bool = False  # it names something that the finished step does not have
    free_run: Mapping[str, Any] | None = None  # of a number in windows: the same in free run, `value` and `met`

    def to_json(self) -> dict[str, Any]:
        return {
            **{name: getattr(self.requirement, name) for name in ("text", "that", "condition", "limits", "unit")},
            **{name: getattr(self, name) for name in ("value", "met", "why_not", "free_run")},
        }


def judge(requirement: Requirement, numbers: Mapping[str, Mapping[str, Any]], missing: Mapping[str, str]) -> Judgement:
    """Judge one requirement; one that cannot be judged is not met, with the reason."""
    step = requirement.that.split(".")[0]
    if step in missing:
        return Judgement(requirement, None, False, missing[step])
    value = None
    try:
        value = look_up(requirement.that, numbers, lists=requirement.contains is not None)
        met = bool(_holds(requirement, value))
    except InputError as error:
        why = f"{error.found}, expected {error.expected}" + (f" ({error.hint})" if error.hint else "")
        return Judgement(requirement, value, False, why, misstated=True)
    is_nan = value == "nan" and requirement.limits is not None
    return Judgement(requirement, value, met, "there is no number to judge (NaN)" if is_nan else "")


def look_up(path: str, numbers: Mapping[str, Any], lists: bool = False) -> Any:
    """Return the value at a dotted path through tables and lists, for example ``loop.poles.0``."""
    here: Any = numbers
    done: list[str] = []
    for part in path.split("."):
        if isinstance(here, (list, tuple)):
            here = {str(i): item for i, item in enumerate(here)}
        known: Mapping[str, Any] = here if isinstance(here, Mapping) else {}
        if part not in known:
            raise nothing_there(f"require: {path}", done, part, [str(key) for key in known])
        here = known[part]
        done.append(part)
    if lists and isinstance(here, (list, tuple)):
        return list(here)
    if isinstance(here, (Mapping, list, tuple)):
        raise InputError(f"require: {path}", "names a table", "a single number, text, or yes/no")
    return here


def _holds(requirement: Requirement, value: Any) -> bool:
    r = requirement
    if r.contains is not None:
        if not isinstance(value, list):
            raise InputError(f"require: {r.that}", f"{value!r}", "a list, because the condition is contains")
        return r.contains in value
    if isinstance(r.equals, (bool, str)):
        return type(value) is type(r.equals) and value == r.equals
    # Infinities and NaN are kept as texts in plain results.
    if value is None or isinstance(value, bool) or (isinstance(value, str) and value not in ("inf", "-inf", "nan")):
        raise InputError(f"require: {r.that}", f"{value!r}", "a number, because the condition compares numbers")
    low, high = r.limits or (None, None)
    number = float(value)
    return not (math.isnan(number) or (low is not None and number < low) or (high is not None and number > high))
