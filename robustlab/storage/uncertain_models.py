"""Uncertain models in a file: M beside one row for each block of Delta."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.files.tree import Tree
from robustlab.storage.matrices import (
    Problems,
    decode_model,
    decode_point,
    encode_model,
    encode_point,
    entries,
    find_children,
)
from robustlab.uncertainty.blocks import KINDS, Block, ParameterRange
from robustlab.uncertainty.lft import UncertainModel

FIELDS = ("name", "kind", "rows", "cols", "nominal", "radius", "unit", "below", "origin", "sign")


def encode_uncertain(tree: Tree, model: UncertainModel) -> None:
    """Group ``M`` as a state-space model, group ``blocks`` with one entry per block in each dataset.

    The dataset ``below`` (width of a range beneath its nominal value) is there only if some range is not symmetric,
    ``origin`` only if some block says where it comes from, ``sign`` only if physics limits some parameter's sign.
    """
    encode_model(tree.group("M"), model.M)
    if model.operating_point is not None:
        encode_point(tree, model.operating_point)
    encode_blocks(tree, model.blocks)


def encode_blocks(tree: Tree, blocks: Sequence[Block]) -> None:
    """Group ``blocks``; see `encode_uncertain`."""
    for b in blocks:
        if KINDS.get(b.stored_as) is not type(b):
            found = f"a {type(b).__name__}, a kind of block without a place in the file format"
            raise InputError(f"save: block {b.name!r}", found, f"blocks of the kinds {', '.join(KINDS)}")
    parameters = [b.parameter for b in blocks]
    columns: dict[str, Any] = {
        "name": np.array([b.name for b in blocks], dtype=np.str_),
        "kind": np.array([b.stored_as for b in blocks], dtype=np.str_),
        "rows": np.array([b.rows for b in blocks], dtype=np.int64),
        "cols": np.array([b.cols for b in blocks], dtype=np.int64),
        "nominal": np.array([p.nominal if p else np.nan for p in parameters], dtype=np.float64),
        "radius": np.array([p.radius if p else np.nan for p in parameters], dtype=np.float64),
        "unit": np.array([p.unit if p else "" for p in parameters], dtype=np.str_),
    }
    if any(p and p.below is not None for p in parameters):
        widths = [np.nan if p is None or p.below is None else p.below for p in parameters]
        columns["below"] = np.array(widths, dtype=np.float64)
    signs = [p.sign if p else "any" for p in parameters]
    if any(sign != "any" for sign in signs):
        columns["sign"] = np.array(signs, dtype=np.str_)
    if any(b.origin for b in blocks):
        columns["origin"] = np.array([b.origin for b in blocks], dtype=np.str_)
    for name, values in columns.items():
        tree.group("blocks").put(name, values)


def decode_uncertain(tree: Tree, problems: Problems, transpose: bool = False) -> UncertainModel:
    """Inverse of `encode_uncertain`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("M", "blocks"), problems, kind="group")
    model = decode_model(tree.groups["M"], problems, transpose) if "M" in tree.groups else None
    blocks = decode_blocks(tree.groups["blocks"], problems) if "blocks" in tree.groups else ()
    point = decode_point(tree, problems)
    problems.raise_any()
    assert model is not None
    try:
        return UncertainModel(model, blocks, point)
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None


def decode_blocks(group: Tree, problems: Problems) -> tuple[Block, ...]:
    """Inverse of `encode_blocks`; what does not fit is noted in ``problems``."""
    find_children(group, FIELDS[:4], problems, kind="dataset")
    columns: dict[str, list[Any]] = {}
    for name in FIELDS:
        if name not in group.datasets:
            continue
        found = entries(group, name, "U" if name in ("name", "kind", "unit", "origin", "sign") else "fi", problems)
        if found is not None:
            columns[name] = found
    lengths = {name: len(values) for name, values in columns.items()}
    if problems.lines:
        return ()
    for name, length in lengths.items():
        if length != lengths["name"]:
            names = group.child_path("name")
            problems.add(f"{group.child_path(name)} has {length} entries, expected {lengths['name']} as {names}")
    if problems.lines:
        return ()
    result = [_block(i, columns, group.path, problems) for i in range(lengths["name"])]
    return tuple(block for block in result if block is not None)


def _block(i: int, columns: dict[str, list[Any]], path: str, problems: Problems) -> Block | None:
    name, kind, rows, cols = (columns[field][i] for field in FIELDS[:4])
    if kind not in KINDS:
        problems.add(f"{path}/kind[{i}] is {kind!r}, expected real, complex or full")
        return None
    whole = all(math.isfinite(size) and size == int(size) and size >= 1 for size in (rows, cols))
    if not whole or (KINDS[kind].is_scalar and rows != cols):
        problems.add(
            f"{path}: block {name!r} ({kind}) is {rows:g} x {cols:g}, expected whole sizes, square for a scalar block"
        )
        return None
    origin = columns["origin"][i] if "origin" in columns else ""
    try:
        return KINDS[kind].from_row(name, int(rows), int(cols), _parameter(i, columns, path, problems), origin)
    except InputError as error:
        problems.absorb(error)
        return None


def _parameter(i: int, columns: dict[str, list[Any]], path: str, problems: Problems) -> ParameterRange | None:
    if "nominal" not in columns or "radius" not in columns:
        return None
    nominal, radius = columns["nominal"][i], columns["radius"][i]
    if np.isnan(nominal) and np.isnan(radius):
        return None
    if not (np.isfinite(nominal) and np.isfinite(radius)):
        name = columns["name"][i]
        problems.add(
            f"{path}: block {name!r}: nominal {nominal:g}, radius {radius:g}, expected both finite or both NaN"
        )
        return None
    below = columns["below"][i] if "below" in columns and not np.isnan(columns["below"][i]) else None
    sign = columns["sign"][i] if "sign" in columns else "any"
    return ParameterRange(nominal, radius, columns["unit"][i] if "unit" in columns else "", below, sign=sign)
