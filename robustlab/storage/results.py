"""Results in files: nested groups of the values of ``to_json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from functools import cache
from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.evidence.verification import claims_of
from robustlab.files.tree import Tree, Unread, link_name, signal_name
from robustlab.result import Result, Status
from robustlab.statespace import StateSpaceModel
from robustlab.storage.matrices import Problems
from robustlab.verification.claim import Claim

LEAVES: dict[str, Any] = {
    "text": str,
    "bool": (bool, np.bool_),
    "number": (int, float, np.integer, np.floating),
    "complex": (complex, np.complexfloating),
}


def encode_result(tree: Tree, result: Any) -> None:
    """Write attributes ``type`` and ``status``, and group ``data`` with a dataset per value and a group per table.

    Evidence for `robustlab.verify` is in ``claims/0``, ``claims/1``, ..., with the kind in the attribute ``claim``.
    """
    data = dict(result.to_json())
    if isinstance(result, Result):
        data.pop("type")
    data.pop("status", None)
    tree.attrs.update(
        type=result.type if isinstance(result, Result) else type(result).__name__, status=Status(result.status).value
    )
    _table(tree.group("data"), data)
    encode_claims(tree, claims_of(result))


def encode_claims(tree: Tree, claims: Sequence[Claim]) -> None:
    """Write a group for each claim."""
    for k, claim in enumerate(claims):
        node = tree.group("claims").group(str(k))
        node.attrs["claim"] = claim.kind
        for name, values in claim.numbers.items():
            node.put(name, values)


def _table(tree: Tree, data: Mapping[Any, Any]) -> None:
    for key, value in data.items():
        _put(tree, link_name(str(key)), value)


def _put(tree: Tree, link: str, value: Any) -> None:
    """Write a rectangular list of numbers or texts as one dataset, another list as a group of numbered children."""
    if hasattr(value, "to_json"):
        value = value.to_json()
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, (set, frozenset)) or (isinstance(value, np.ndarray) and value.dtype == object):
        value = list(value)
    if value is None:
        tree.put(link, "", null=True)
    elif isinstance(value, Mapping):
        _table(tree.group(link), value)
    elif not isinstance(value, (list, tuple)):
        tree.put(link, value)
    elif len(_kinds(value)) == 1 and _is_rectangular(value):
        tree.put(link, np.asarray(value))
    else:
        group = tree.group(link)
        group.attrs["sequence"] = len(value)
        for i, item in enumerate(value):
            _put(group, str(i), item)


def _kinds(items: Sequence[Any]) -> set[str]:
    """Return the kinds of values in a nested list: text, bool, number, complex; "" and "other" for anything else."""
    kinds: set[str] = set()
    for item in items:
        if isinstance(item, (list, tuple)):
            kinds |= _kinds(item)
        else:
            kind = next((word for word, types in LEAVES.items() if isinstance(item, types)), "other")
            kinds |= {"", kind} if kind == "other" or isinstance(item, Enum) else {kind}
    return kinds


def _is_rectangular(items: Sequence[Any]) -> bool:
    try:
        return np.asarray(items).dtype != object
    except ValueError:
        return False


class NotStored(InputError, AttributeError):
    """An attribute of a result that is not in its file."""


class LoadedResult(Result):
    """A result from a file, with the stored values as attributes."""

    def __getattr__(self, name: str) -> Any:
        data = vars(self).get("data", {})
        if name not in data:
            raise NotStored(type(self).__name__, f"{name!r} is not in its file", f"one of {', '.join(data)}")
        return _attribute(data[name])

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.data]

    def __reduce__(self) -> tuple[Any, ...]:
        return restored, (self.type, self.status, self.data)


def restored(kind: str, status: Status, data: Mapping[str, Any]) -> LoadedResult:
    """Return a result whose class has the name of the saved one."""
    return _class(kind)(kind, status, data)


@cache
def _class(name: str) -> type[LoadedResult]:
    return type(name, (LoadedResult,), {"__doc__": LoadedResult.__doc__}) if name.isidentifier() else LoadedResult


def _attribute(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_attribute, value))
    if not isinstance(value, Mapping):
        return value
    if value.get("type") and value.get("status") in list(Status):
        rest = {name: x for name, x in value.items() if name not in ("type", "status")}
        return restored(str(value["type"]), Status(value["status"]), rest)
    if {"A", "B", "C", "D", "dt", "inputs", "outputs", "states"} <= set(value):
        A, B, C, D = (value[letter] for letter in "ABCD")
        u, y, x = ([tuple(pair) for pair in value[side]] for side in ("inputs", "outputs", "states"))
        return StateSpaceModel(A, B, C, D, value["dt"], u, y, x)
    return {name: _attribute(x) for name, x in value.items()}


def decode_result(tree: Tree, _problems: Problems, _transpose: bool = False) -> LoadedResult:
    """Invert `encode_result`; lists of numbers become arrays."""
    text = str(np.asarray(tree.attrs.get("status", "")))
    if text not in list(Status):
        raise InputError(tree.file, f"attribute status is {text!r}", f"one of {', '.join(Status)}")
    data = _value(tree.groups["data"]) if "data" in tree.groups else None
    if not isinstance(data, dict):
        raise InputError(tree.file, "/data is a sequence" if data else "missing /data", "a table")
    return restored(str(np.asarray(tree.attrs.get("type", ""))), Status(text), data)


def _value(node: Tree) -> Any:
    names = [*node.datasets, *node.groups]
    if "sequence" not in node.attrs:
        return {signal_name(link): _child(node, link) for link in names}
    length = np.asarray(node.attrs["sequence"])
    if length.dtype.kind != "i" or length.size != 1:
        raise InputError(node.file, f"{node.path}: attribute sequence is no whole number", "the length of the list")
    numbered = [str(i) for i in range(min(int(length.flat[0]), len(names)))]
    return [_child(node, name) for name in numbered if name in names]


def _child(node: Tree, link: str) -> Any:
    if link not in node.datasets:
        return _value(node.groups[link])
    values = node.datasets[link].values
    if isinstance(values, Unread):
        raise InputError(node.file, f"{node.child_path(link)} has dtype {values.dtype}", "numbers or text")
    if "null" in node.datasets[link].attrs:
        return None
    return values.tolist() if values.ndim == 0 or values.dtype.kind == "U" else values
