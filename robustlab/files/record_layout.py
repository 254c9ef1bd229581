"""Layout of a record in format 1: ``t``, ``inputs/<name>``, ``outputs/<name>``; attributes ``unit``, ``meaning``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, not_finite
from robustlab.errors import InputError
from robustlab.files.tree import Tree, link_name, signal_name, text_attr, type_name


def encode_record(tree: Tree, keywords: Mapping[str, Any]) -> None:
    """Put the arguments of a Record into ``tree``."""
    tree.attrs["name"] = keywords["name"]
    of_clock = {"meaning": keywords["meaning"]["t"]} if "t" in keywords["meaning"] else {}
    tree.put("t", keywords["t"], unit="s", **of_clock)
    for side in ("inputs", "outputs"):
        group = tree.group(side)
        for position, (name, values) in enumerate(keywords[side].items()):
            attrs = {
                "unit": keywords["units"].get(name, ""),
                "meaning": keywords["meaning"].get(name, ""),
                "position": position,
            }
            group.put(link_name(name), values, **attrs)


def decode_record(node: Tree, where: str) -> dict[str, Any]:
    """Inverse of `encode_record`.

    Raises
    ------
    InputError
        All of: missing ``t``, datasets that are not columns of finite real numbers, lengths that differ.
    """
    problems: list[str] = []
    keywords: dict[str, Any] = {"name": str(node.attrs.get("name", "")) or "record", "units": {}, "meaning": {}}
    if "t" not in node.datasets:
        problems.append(f"missing {node.child_path('t')}")
        n = None
    else:
        keywords["t"] = _column(node, "t", problems)
        n = len(keywords["t"])
        if text := text_attr(node.datasets["t"].attrs, "meaning"):
            keywords["meaning"]["t"] = text
    for side in ("inputs", "outputs"):
        keywords[side] = {}
        group = node.groups.get(side, Tree())
        for link in sorted(group.datasets, key=lambda name: (_position(group, name), name)):
            name = signal_name(link)
            values = _column(group, link, problems)
            if n is not None and len(values) != n:
                problems.append(
                    f"{group.child_path(link)} has {len(values)} samples, expected {n} as {node.child_path('t')}"
                )
            keywords[side][name] = values
            for key, table in (("unit", "units"), ("meaning", "meaning")):
                text = np.asarray(group.datasets[link].attrs.get(key, ""))
                if text.size == 1 and str(text.flat[0]):
                    keywords[table][name] = str(text.flat[0])
    if problems:
        raise InputError(where, problems[0], None, None, tuple(f"{where}: {line}" for line in problems[1:]))
    return keywords


def _position(group: Tree, link: str) -> int:
    value = np.asarray(group.datasets[link].attrs.get("position", 1 << 30))
    return int(value.flat[0]) if value.size == 1 and value.dtype.kind in "if" else 1 << 30


def _column(node: Tree, name: str, problems: list[str]) -> AnyArray:
    values, path = node.datasets[name].values, node.child_path(name)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fi":
        problems.append(f"{path} has dtype {type_name(values)}, expected a column of real numbers")
        return np.zeros(0)
    if values.ndim == 2 and 1 in values.shape:
        values = values.reshape(-1)
    if values.ndim != 1:
        problems.append(f"{path} is {values.shape}, expected one column")
        return np.zeros(0)
    bad = not_finite(values, "samples")
    if bad is not None:
        problems.append(f"{path}[{bad[0]}] {bad[1]}")
    return values.astype(np.float64)
