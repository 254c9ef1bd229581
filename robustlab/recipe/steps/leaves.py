"""What a step leaves for requirements, declared before it runs, in patterns of plain values.

=====================  =================================================================
``"rad/s"``, ``"1"``   a number in that unit; ``"1"`` is a pure number
``float``, ``""``      a number whose unit is not known before the run
``bool``, ``str``      yes or no; a text
``[pattern]``          a list of such, of any length
``(pattern, ...)``     a list of just these
``{name: pattern}``    a table; a name with ``*`` stands for all that match
a class of parts       its fields, with the units that its ``quantities`` say
``Each``               a table by signals; see `with_signals`
``...``                not said: anything may be there
=====================  =================================================================

A result class says the same with the annotations of its fields; `leaves_of` reads them.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from fnmatch import fnmatchcase
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from robustlab.errors import InputError, did_you_mean
from robustlab.result import Evidence
from robustlab.shown import Each

COMPLEX = {"re": float, "im": float}


def leaves_of(kind: type, *without: str, **more: Any) -> dict[str, Any]:
    """The pattern of a result class: its fields but those ``without``, and what ``more`` says over that.

    A field's unit is not in its annotation: ``more`` names it where it matters.
    """
    return {name: leaf for name, leaf in _of_class(kind).items() if name not in without} | more


@cache
def _of_class(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: _of_annotation(hints[field.name]) for field in fields(kind)}


def _of_annotation(hint: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        meant = [a for a in arguments if a is not type(None)]
        return _of_annotation(meant[0]) if len(meant) == 1 else ...
    if origin is Literal:
        return str if all(isinstance(a, str) for a in arguments) else ...
    if not isinstance(origin or hint, type):
        return ...
    kind: type = origin or hint
    if issubclass(kind, Mapping):
        return {"*": _of_annotation(arguments[1])} if arguments else ...
    if issubclass(kind, (bool, str, Enum)):
        return bool if kind is bool else str
    if issubclass(kind, (int, float)):
        return float
    if issubclass(kind, Sequence) and arguments:
        if issubclass(kind, tuple) and ... not in arguments:
            return tuple(_of_annotation(a) for a in arguments)
        return [_of_annotation(arguments[0])] if set(arguments[1:]) <= {...} else ...
    # A class that writes its JSON itself may leave something else than its fields.
    return _of_class(kind) if is_dataclass(kind) and getattr(kind, "to_json", None) is Evidence.to_json else ...


def with_signals(pattern: Any, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None) -> Any:
    """The pattern with the names and units of signals in each `Each`; "*" and no unit where they are not known."""
    pattern = _of_part(pattern)
    if isinstance(pattern, Each):
        known = inputs if pattern.side == "inputs" else outputs
        found = {name: _in_unit(pattern.leaf, unit) for name, unit in ({"*": ""} if known is None else known).items()}
        return with_signals(found | dict.fromkeys(pattern.more, _in_unit(pattern.leaf, "")), inputs, outputs)
    return _inside(pattern, lambda leaf: with_signals(leaf, inputs, outputs))


def _in_unit(leaf: Any, unit: str) -> Any:
    """A leaf with the unit of its signal in the place of "*"."""
    if isinstance(leaf, str) and leaf == "*":
        return unit
    return leaf if isinstance(leaf, Each) else _inside(_of_part(leaf), lambda inner: _in_unit(inner, unit))


def _inside(pattern: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(pattern, Mapping):
        return {name: change(leaf) for name, leaf in pattern.items()}
    return type(pattern)(map(change, pattern)) if isinstance(pattern, (list, tuple)) else pattern


def _of_part(pattern: Any) -> Any:
    """Of a class of parts its fields, with what its quantities say of them."""
    if not (isinstance(pattern, type) and is_dataclass(pattern)):
        return pattern
    stated = getattr(pattern, "quantities", {})
    return {**_of_class(pattern), **stated} if stated else _of_annotation(pattern)


def look_ahead(path: str, leaves: Any) -> Any:
    """The pattern at a dotted path below a step's name, as far as it is said; ``...`` where it is not.

    Raises InputError: nothing of that name can be there.
    """
    step, *parts = path.split(".")
    here, done = with_signals(leaves, None, None), [step]
    for part in parts:
        known: list[str] = []
        if here is ...:
            return ...
        if isinstance(here, dict):
            if part in here:
                here = here[part]
                done.append(part)
                continue
            matching = [leaf for name, leaf in here.items() if "*" in name and fnmatchcase(part, name)]
            if matching:
                here = matching[0]
                done.append(part)
                continue
            known = [name for name in here if name != "*"]
        elif isinstance(here, (list, tuple)):
            known = [str(i) for i in range(len(here))] if isinstance(here, tuple) else ["0", "1", "..."]
            if part in known or (isinstance(here, list) and re.fullmatch("0|[1-9][0-9]*", part)):
                here = here[int(part) if isinstance(here, tuple) else 0]
                done.append(part)
                continue
        raise nothing_there("that", done, part, known)
    return here


def nothing_there(where: str, done: Sequence[str], part: str, known: Sequence[str]) -> InputError:
    """The error for a path that goes on after ``done`` with something that is not there."""
    expected = f"one of {', '.join(known)}" if known else f"nothing below {'.'.join(done)}"
    return InputError(where, f"{'.'.join(done)} has no {part!r}", expected, did_you_mean(part, list(known)))


def kind_in_words(leaf: Any) -> str:
    """What stands at a leaf."""
    if isinstance(leaf, dict):
        return "a table"
    if isinstance(leaf, (list, tuple)):
        return "a list"
    return {bool: "yes or no", str: "a text"}.get(leaf, "a number")
