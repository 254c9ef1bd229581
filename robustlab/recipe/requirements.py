"""Judging requirements: find the number that is meant, compare it, say the outcome in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robustlab.errors import InputError, did_you_mean
from robustlab.recipe.schema import Requirement


@dataclass(frozen=True)
class Judgement:
    """A requirement and what became of it.

    Attributes
    ----------
    requirement
        The requirement.
    value
        What was found; None where the step gave no numbers.
    met
        True where it was found and fulfils the condition.
    why_not
        Why no value could be judged; empty where one was.
    """

    requirement: Requirement
    value: Any
    met: bool
    why_not: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        r = self.requirement
        return {
            "text": r.text,
            "that": r.that,
            "condition": r.condition,
            "limits": r.limits,
            "unit": r.unit,
            "value": self.value,
            "met": self.met,
            "why_not": self.why_not,
        }


def judge(requirement: Requirement, numbers: Mapping[str, Mapping[str, Any]], missing: Mapping[str, str]) -> Judgement:
    """Judge one requirement.

    Parameters
    ----------
    numbers
        Step name -> its numbers.
    missing
        Step name -> why it has none.

    Raises
    ------
    InputError
        The step is done, but has no number of that name.
    """
    step = requirement.that.split(".")[0]
    if step in missing:
        return Judgement(requirement, None, False, missing[step])
    value = look_up(requirement.that, numbers, lists=requirement.contains is not None)
    return Judgement(requirement, value, bool(_holds(requirement, value)))


def look_up(path: str, numbers: Mapping[str, Any], lists: bool = False) -> Any:
    """The value at a dotted path through tables and lists, for example ``gap.outputs.q.fit`` or ``loop.poles.0``.

    Raises
    ------
    InputError
        There is nothing at that path, or a whole table; a whole list, unless ``lists`` asks for one.
    """
    here: Any = numbers
    done: list[str] = []
    for part in path.split("."):
        known: list[str] = []
        if isinstance(here, Mapping):
            known = [str(key) for key in here]
            if part in here:
                here = here[part]
                done.append(part)
                continue
        elif isinstance(here, Sequence) and not isinstance(here, str):
            known = [str(i) for i in range(len(here))]
            if part in known:
                here = here[int(part)]
                done.append(part)
                continue
        expected = f"one of {', '.join(known)}" if known else f"nothing below {'.'.join(done)}"
        raise InputError(f"require: {path}", f"{'.'.join(done)} has no {part!r}", expected, did_you_mean(part, known))
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
    if isinstance(value, bool) or value is None:
        raise InputError(f"require: {r.that}", f"{value!r}", "a number, because the condition compares numbers")
    if isinstance(value, str):  # infinities and NaN are kept as texts in plain results
        if value not in ("inf", "-inf", "nan"):
            raise InputError(f"require: {r.that}", f"{value!r}", "a number, because the condition compares numbers")
        value = float(value)
    if math.isnan(value):
        return False
    if r.at_least is not None:
        return value >= r.at_least
    if r.at_most is not None:
        return value <= r.at_most
    if r.within is not None:
        return r.within[0] <= value <= r.within[1]
    assert r.equals is not None
    return abs(value - r.equals) <= (r.tolerance or 0.0)
