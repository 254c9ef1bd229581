"""Uncertain models and frequency responses in files: M, and one row for each block of Delta."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.files.tree import Tree, Unread
from robustlab.storage.matrices import (
    Problems,
    columns,
    decode_model,
    decode_point,
    decode_signals,
    encode_point,
    encode_signals,
    encode_state_space,
    entries,
    need,
    put_columns,
)
from robustlab.uncertainty.blocks import KINDS, Block, ParameterRange
from robustlab.uncertainty.lft import UncertainModel

# Columns of a block, those of its range, and optional ones.
OF_BLOCK = {"name": "U", "stored_as": "U", "rows": "i", "cols": "i"}
OF_RANGE = {"nominal": "fi", "radius": "fi", "unit": "U"}
RARE = {"below": "fi", "sign": "U", "origin": "U"}


def encode_uncertain(tree: Tree, model: UncertainModel) -> None:
    """Write group ``M`` as a state-space model, and group ``blocks`` with one entry per block in each dataset.

    Optional datasets: ``below`` (width of a range below its nominal value) if some range is not symmetric, ``origin``
    if some block has one, ``sign`` if physics limits some parameter's sign.
    """
    encode_state_space(tree.group("M"), model.M)
    if model.operating_point is not None:
        encode_point(tree, model.operating_point)
    encode_blocks(tree, model.blocks)


def encode_blocks(tree: Tree, blocks: Sequence[Block]) -> None:
    """Write group ``blocks``; see `encode_uncertain`."""
    group, ranges = tree.group("blocks"), [b.parameter for b in blocks]
    put_columns(group, OF_BLOCK, blocks)
    group.datasets["kind"] = group.datasets.pop("stored_as")
    put_columns(group, OF_RANGE, ranges)
    if any(p and p.below is not None for p in ranges):
        put_columns(group, {"below": "fi"}, ranges)
    if any(p and p.sign != "any" for p in ranges):
        group.put("sign", np.array([p.sign if p else "any" for p in ranges], np.str_))
    if any(b.origin for b in blocks):
        put_columns(group, {"origin": "U"}, blocks)


def decode_uncertain(tree: Tree, problems: Problems, transpose: bool = False) -> UncertainModel:
    """Invert `encode_uncertain`. Raises InputError: with all faults."""
    need(tree, problems, groups=("M", "blocks"))
    model = decode_model(tree.groups["M"], problems, transpose)
    blocks = decode_blocks(tree, problems)
    return problems.built(UncertainModel, model, blocks, decode_point(tree, problems))


def decode_blocks(tree: Tree, problems: Problems) -> tuple[Block, ...]:
    """Invert `encode_blocks`; add faults to ``problems``."""
    group = tree.groups["blocks"]
    kinds = {"name": "U", "kind": "U", "rows": "fi", "cols": "fi", **OF_RANGE, **RARE}
    found = columns(group, kinds, problems, (*OF_RANGE, *RARE))
    if problems.lines:
        return ()
    rows = [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
    blocks: list[Block] = []
    for i, row in enumerate(rows):
        name, kind, size = row["name"], row["kind"], (row["rows"], row["cols"])
        if kind not in KINDS:
            problems.add(f"{group.path}/kind[{i}] is {kind!r}, expected real, complex or full")
        elif not all(math.isfinite(n) and n == int(n) >= 1 for n in size) or (
            KINDS[kind].is_scalar and size[0] != size[1]
        ):
            found_size = f"block {name!r} ({kind}) is {size[0]:g} x {size[1]:g}"
            problems.add(f"{group.path}: {found_size}, expected whole sizes, square for a scalar block")
        else:
            try:
                span = _range(row, f"{group.path}: block {name!r}")
                made: Any = KINDS[kind]
                sizes = [int(n) for n in size][: 1 if made.is_scalar else 2]
                known = {"parameter": span} if made.is_real else {}
                blocks.append(made(name, *sizes, **known, origin=row.get("origin", "")))
            except InputError as error:
                problems.absorb(error)
    return tuple(blocks)


def _range(row: dict[str, Any], where: str) -> ParameterRange | None:
    nominal, radius = (row.get(name, math.nan) for name in ("nominal", "radius"))
    if math.isnan(nominal) and math.isnan(radius):
        return None
    if not (math.isfinite(nominal) and math.isfinite(radius)):
        raise InputError(where, f"nominal {nominal:g}, radius {radius:g}", "both finite or both NaN")
    below = row.get("below", math.nan)
    below = None if math.isnan(below) else below
    return ParameterRange(nominal, radius, row.get("unit", ""), below, sign=row.get("sign", "any"))


# --- frequency responses ----------------------------------------------------------------------------------------------


def encode_frequency_data(tree: Tree, data: Any) -> None:
    """Write datasets ``omega`` and ``M``, group ``blocks`` as of an uncertain model, ``signals``."""
    tree.put("omega", np.asarray(data.omega, dtype=np.float64))
    tree.put("M", np.asarray(data.M, dtype=np.complex128))
    encode_blocks(tree, data.blocks)
    encode_signals(tree, ((), data.inputs, data.outputs))


def decode_frequency_data(tree: Tree, problems: Problems, _transpose: bool = False) -> Any:
    """Invert `encode_frequency_data`."""
    from robustlab.uncertainty.frequency_responses import UncertainFrequencyData

    need(tree, problems, groups=("blocks",), datasets=("omega", "M"))
    omega, values = entries(tree, "omega", "fi", problems), tree.datasets["M"].values
    if isinstance(values, Unread) or values.dtype.kind not in "fic":
        problems.add(f"{tree.child_path('M')} is not readable as complex numbers")
    blocks = decode_blocks(tree, problems)
    _, inputs, outputs = decode_signals(tree, problems)
    return problems.built(UncertainFrequencyData, omega, values, blocks, inputs, outputs)
