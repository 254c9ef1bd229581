"""Read files of MATLAB version 5; convert trees of version 7.3 (HDF5).

MATLAB stores matrices column by column, so other HDF5 readers see them transposed; datasets with the attribute
``MATLAB_class`` are transposed back here. MathWorks, *MAT-File Format* (R2024a).
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.file_types import Limits, size_text
from robustlab.files.tree import Dataset, Tree, Unread, text_attr

NUMERIC = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
MAX_EMPTY = 1 << 31  # longest side of an array without entries
OPAQUE_FIELDS = ("s0", "s1", "s2", "arr")  # of an object in scipy: variable, system, class, content
# Bytes of a value in memory: numbers become float64, a struct is a Python object.
BYTES_OF_VALUE = {"struct": 400, "object": 400}


def read_matlab5(path: str, limits: Limits, shown: str | None = None) -> Tree:
    """Read the variables of a version 5 file; a struct becomes a group, a cell array of texts a text dataset."""
    from scipy.io import loadmat, whosmat

    where = shown or path
    tree = Tree(file=where)
    try:
        with suppress(TypeError):  # an object of MATLAB declares no size; the reader process limits memory
            _check_sizes(whosmat(path), where, limits)
        variables = loadmat(path, struct_as_record=False, squeeze_me=False)
    except (InputError, MemoryError):  # the reader process reports MemoryError
        raise
    except Exception as error:  # any error of the library means a damaged file
        raise InputError(where, f"damaged MATLAB file ({type(error).__name__}: {str(error)[:100]})") from error
    for name, value in variables.items():
        if not (name.startswith("__") and name.endswith("__")):
            if isinstance(value, np.ndarray) and value.dtype.names == OPAQUE_FIELDS and value.size == 1:
                name = _latin(value["s0"].flat[0])  # scipy gives objects no name
            _variable(tree, name, value, limits, 0)
    return tree


def _check_sizes(declared: list[tuple[str, tuple[int, ...], str]], where: str, limits: Limits) -> None:
    total = 0
    for name, shape, kind in declared:
        size = math.prod(shape) * BYTES_OF_VALUE.get(kind, 8)
        total += size
        if size > limits.dataset:
            limit = size_text(limits.dataset)
            raise InputError(where, f"/{name[:60]}: declares {size_text(size)}, limit {limit}")
        if total > limits.total:
            found = f"/{name[:60]}: with this variable {size_text(total)} in all, limit {size_text(limits.total)}"
            raise InputError(where, found)


def _variable(tree: Tree, name: str, value: Any, limits: Limits, depth: int) -> None:
    array = np.asarray(value.toarray() if hasattr(value, "toarray") else value)  # a sparse matrix
    structs = array.ravel(order="F").tolist() if array.dtype.kind == "O" else []
    if not structs or not all(hasattr(item, "_fieldnames") for item in structs):
        tree.datasets[name] = Dataset(_matlab_values(array))
        return
    if depth > limits.depth:
        raise InputError(tree.file, f"/{name}: structs are nested deeper than {limits.depth}")
    group = tree.group(name)
    for k, struct in enumerate(structs):  # a struct array: one group an element
        element = group if len(structs) == 1 else group.group(str(k + 1))
        for key in struct._fieldnames:
            _variable(element, key, getattr(struct, key), limits, depth + 1)


def _matlab_values(array: AnyArray) -> Any:
    if array.dtype.kind in "fiucbU":
        wanted = {"c": np.complex128, "b": array.dtype, "U": array.dtype}.get(array.dtype.kind, np.float64)
        return array.astype(wanted)
    if array.dtype.kind == "O":
        cells = [np.asarray(item) for item in array.ravel().tolist()]
        if all(cell.dtype.kind == "U" and cell.size <= 1 for cell in cells):
            texts = [str(cell.flat[0]) if cell.size else "" for cell in cells]
            return np.array(texts, dtype=np.str_).reshape(array.shape)
        return Unread("cell array", array.shape)
    if array.dtype.names == OPAQUE_FIELDS and array.size == 1:
        return Unread(f"MATLAB object ({_latin(array['s2'].flat[0])})", array.shape)
    return Unread("MATLAB object", array.shape)


def _latin(text: Any) -> str:
    return text.decode("latin-1") if isinstance(text, bytes) else str(text)


def from_matlab73(tree: Tree) -> Tree:
    """Return the tree with all datasets marked by MATLAB in MATLAB's shape."""
    result = Tree(tree.attrs, {}, {}, tree.path, tree.file)
    result.datasets = {name: _from_matlab73(dataset) for name, dataset in tree.datasets.items()}
    result.groups = {name: from_matlab73(g) for name, g in tree.groups.items() if name not in ("#refs#", "#subsystem#")}
    return result


def _from_matlab73(dataset: Dataset) -> Dataset:
    kind, values = text_attr(dataset.attrs, "MATLAB_class"), dataset.values
    if not kind:
        return dataset
    attrs = {key: item for key, item in dataset.attrs.items() if not key.startswith("MATLAB_")}

    def unread(what: str) -> Dataset:
        return Dataset(Unread(what, values.shape[::-1]), attrs)

    if isinstance(values, Unread):
        return unread(values.dtype if kind in NUMERIC or values.dtype == "not read" else f"MATLAB {kind}")
    empty = np.asarray(dataset.attrs.get("MATLAB_empty", 0))
    if empty.dtype.kind in "fib" and empty.any():
        # An empty array is stored as its sizes, in MATLAB's order.
        shape = tuple(int(n) for n in values.ravel()) if values.dtype.kind == "i" and values.size <= 32 else ()
        if 0 not in shape or min(shape) < 0 or max(shape) > MAX_EMPTY:
            return unread(f"MATLAB {kind}, marked empty, of size {shape}")
        return Dataset(np.zeros(shape), attrs)
    if values.dtype.kind not in "fib":
        return unread(f"MATLAB {kind} that holds other values")
    if kind in NUMERIC or kind == "logical":
        turned = np.ascontiguousarray(values.T)
        return Dataset(turned.astype(bool) if kind == "logical" else turned, attrs)
    if kind == "char":
        codes = values.ravel(order="F").tolist()
        if not all(isinstance(code, int) and (0 < code < 0xD800 or 0xE000 <= code <= 0xFFFF) for code in codes):
            return unread("MATLAB char with other characters")
        return Dataset(np.array(["".join(map(chr, codes))]), attrs)
    return unread(f"MATLAB object ({kind})")
