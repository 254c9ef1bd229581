"""What Octave's ``save -hdf5`` writes, brought to the form of every other file.

Each variable is a group with datasets ``type`` and ``value`` and the attribute ``OCTAVE_NEW_FORMAT``; matrices are
stored column by column, so that they show transposed; a struct's ``value`` is a group of such groups, and a cell's one
with ``dims`` and ``_0``, ``_1``, ... (Octave's source, libinterp/corefcn/ls-hdf5.cc and ``save_hdf5`` of each type).
"""

from __future__ import annotations

import math
import re

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.files.tree import Dataset, Tree, Unread

MARK, EMPTY = "OCTAVE_NEW_FORMAT", "OCTAVE_EMPTY_MATRIX"
WHOLE = re.compile(r"u?int(8|16|32|64) (scalar|matrix)")
NUMBERS = ("scalar", "matrix", "float scalar", "float matrix", "bool", "bool matrix")
COMPLEX = ("complex scalar", "complex matrix", "float complex scalar", "float complex matrix")
TEXTS = ("string", "sq_string")
RANGES = ("range", "double_range")
MAX_CELLS, MAX_RANGE = 10_000, 10_000_000


def from_octave(tree: Tree) -> Tree:
    """The same tree with every variable that Octave marked as a dataset, or as a group where it is a struct.

    Scalars become 0-d, matrices (rows, columns), texts one text a row, and a cell of texts an array of texts of the
    cell's size; a range is a row. What has no such form (a cell of other things, a struct array, a sparse matrix) is a
    dataset that is not read, under Octave's own word for it. Groups without the mark stay as they are.
    """
    result = Tree(dict(tree.attrs), {}, dict(tree.datasets), tree.path, tree.file)
    for name, group in tree.groups.items():
        kind = _kind(group)
        if kind is None:
            result.groups[name] = from_octave(group)
        elif kind == "scalar struct" and "value" in group.groups:
            held = from_octave(group.groups["value"])
            result.groups[name] = _moved(held, tree.child_path(name))
        else:
            result.datasets[name] = Dataset(_values(group, kind))
    return result


def _kind(group: Tree) -> str | None:
    """Octave's word for the type of a variable, or None for a group that it did not write."""
    marked = MARK in group.attrs or {*group.datasets, *group.groups} == {"type", "value"}
    kind = group.datasets["type"].values if marked and "type" in group.datasets else None
    if not isinstance(kind, np.ndarray) or kind.dtype.kind != "U" or kind.size != 1:
        return None
    return str(kind.flat[0])


def _moved(tree: Tree, path: str) -> Tree:
    """The tree under another path."""
    moved = Tree(tree.attrs, {}, tree.datasets, path, tree.file)
    moved.groups = {name: _moved(group, moved.child_path(name)) for name, group in tree.groups.items()}
    return moved


def _values(group: Tree, kind: str) -> AnyArray | Unread:
    """The value of a variable that is no struct."""
    if kind == "cell" and "value" in group.groups:
        return _cell(group.groups["value"])
    if "value" not in group.datasets:
        return Unread(f"Octave {kind}", ())
    values = group.datasets["value"].values
    if kind in RANGES:
        return _range(group.datasets["value"])
    if isinstance(values, Unread):
        return Unread(values.dtype if values.dtype == "not read" else f"Octave {kind}", values.shape[::-1])
    if kind not in (*NUMBERS, *COMPLEX, *TEXTS) and not WHOLE.fullmatch(kind):
        return Unread(f"Octave {kind}", values.shape[::-1])
    if bool(np.any(group.attrs.get(EMPTY, False))):
        return _empty(values, kind)
    if values.dtype.kind == "U":
        return Unread(f"Octave {kind} that holds text", values.shape[::-1])
    if kind in TEXTS:
        return _text(values)
    array = np.ascontiguousarray(values.T).reshape(values.shape[::-1])
    return array.astype(bool) if kind.startswith("bool") else array


def _range(stored: Dataset) -> AnyArray | Unread:
    """``0:0.1:1`` as a row; stored are its base, limit and increment, and how many elements it has."""
    values, count = stored.values, np.asarray(stored.attrs.get("OCTAVE_RANGE_NELEM", -1))
    if isinstance(values, Unread) or values.shape != (3,) or count.size != 1 or not 0 <= int(count) <= MAX_RANGE:
        return Unread("Octave range", ())
    base, limit, increment = values
    row = base + increment * np.arange(int(count), dtype=np.float64)
    return (np.minimum if increment > 0 else np.maximum)(row, limit).reshape(1, -1)  # as Octave: never beyond the limit


def _empty(sizes: AnyArray, kind: str) -> AnyArray | Unread:
    """An empty array is stored as its sizes, in Octave's order."""
    shape = tuple(int(n) for n in sizes.ravel()) if sizes.dtype.kind == "i" else (-1,)
    if 0 not in shape or min(shape) < 0 or len(shape) > 32 or max(shape) > 2**31:
        return Unread(f"Octave {kind}, marked empty, of size {shape[:8]}", ())
    return np.array([""]) if kind in TEXTS else np.zeros(shape)


def _text(codes: AnyArray) -> AnyArray | Unread:
    """Bytes of UTF-8, one column of the dataset for each row of the text; blanks fill up shorter rows."""
    if codes.dtype.kind != "i" or codes.ndim not in (1, 2):
        return Unread("Octave text of another shape", codes.shape)
    rows = codes.reshape(len(codes), -1).T.astype(np.uint8)
    texts = [bytes(row.tolist()).decode("utf-8", "replace") for row in rows]
    if any("\0" in text for text in texts):
        return Unread("Octave text with NUL characters", (len(texts),))
    return np.array([text.rstrip(" ") if len(texts) > 1 else text for text in texts], np.str_)


def _cell(held: Tree) -> AnyArray | Unread:
    """A cell of texts as an array of texts."""
    dims = held.datasets["dims"].values if "dims" in held.datasets else None
    if not isinstance(dims, np.ndarray) or dims.dtype.kind != "i" or not 1 <= dims.size <= 32:
        return Unread("cell array", ())
    shape = tuple(int(n) for n in dims.ravel())[::-1]  # stored as the axes of a matrix are: the last first
    if min(shape) < 0 or math.prod(shape) > MAX_CELLS:
        return Unread("cell array", shape)
    texts: list[str] = []
    for i in range(math.prod(shape)):
        item = held.groups.get(f"_{i}")
        values = _values(item, kind) if item is not None and (kind := _kind(item)) in TEXTS else None
        if not isinstance(values, np.ndarray) or values.size != 1:
            return Unread("cell array", shape)
        texts.append(str(values.flat[0]))
    return np.array(texts, np.str_).reshape(shape, order="F")
