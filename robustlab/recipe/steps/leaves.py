"""The names that requirements may refer to, declared before a step runs, as nested tables down to a unit.

A text is the unit of a number, "1" of a pure one; ``{name: ...}`` a table, where a name with ``*`` stands for all that
match; `Each` a table by signals; a class of parts its fields. Below anything else may be what there is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from fnmatch import fnmatchcase
from typing import Any

from robustlab.errors import InputError, did_you_mean
from robustlab.result import Evidence
from robustlab.shown import Each


def with_signals(
    names: Any, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None, unit: str | None = None
) -> Any:
    """Return the names with those of the signals in each `Each`, "*" where they are not known; ``unit``: of "*"."""
    if isinstance(names, Each):
        known = inputs if names.side == "inputs" else outputs
        every = {**({"*": ""} if known is None else known), **dict.fromkeys(names.more, "")}
        return {name: with_signals(names.leaf, inputs, outputs, of) for name, of in every.items()}
    if isinstance(names, type) and is_dataclass(names):
        stated = getattr(names, "quantities", {})
        as_fields = stated or getattr(names, "to_json", None) is Evidence.to_json
        names = {**{f.name: ... for f in fields(names)}, **stated} if as_fields else ...
    if isinstance(names, Mapping):
        return {name: with_signals(below, inputs, outputs, unit) for name, below in names.items()}
    if isinstance(names, (list, tuple)):
        return [with_signals(below, inputs, outputs, unit) for below in names]
    if isinstance(names, str):
        return unit if names == "*" and unit is not None else names
    return ...


def look_ahead(path: str, leaves: Any) -> Any:
    """Return the unit at a dotted path below a step's name, "" or ``...`` where it is not known."""
    step, *parts = path.split(".")
    here, done = with_signals(leaves, None, None), [step]
    for part in parts:
        if isinstance(here, list) and part.isdecimal():
            here = here[min(int(part), len(here) - 1)]
            continue
        if not isinstance(here, dict):
            return ...
        name = part if part in here else next((name for name in here if "*" in name and fnmatchcase(part, name)), None)
        if name is None:
            raise nothing_there("that", done, part, [name for name in here if name != "*"])
        here = here[name]
        done.append(part)
    return here


def nothing_there(where: str, done: Sequence[str], part: str, known: Sequence[str]) -> InputError:
    """The error for a path that goes on after ``done`` with something that is not there."""
    expected = f"one of {', '.join(known)}" if known else f"nothing below {'.'.join(done)}"
    return InputError(where, f"{'.'.join(done)} has no {part!r}", expected, did_you_mean(part, list(known)))
