"""Files of MATLAB (version 5 read and written, version 7.3 in HDF5) brought to one form.

MATLAB stores matrices column by column: version 7.3 files show them transposed to every other HDF5 reader; datasets
that MATLAB marked (attribute ``MATLAB_class``) are transposed back here. MathWorks, *MAT-File Format* (R2024a).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.signature import Limits, size_text
from robustlab.files.tree import REFERENCES, Dataset, Tree, Unread

NUMERIC = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
MAX_EMPTY = 1 << 31  # longest side of an array without entries
MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
OPAQUE_FIELDS = ("s0", "s1", "s2", "arr")  # of an object as scipy hands it over: variable, system, class, content
MAX_NESTED, MAX_STRUCTS = 32, 10_000  # of struct arrays in version 7.3
# What one value takes once it is read: numbers become float64, a struct is a Python object.
BYTES_OF_VALUE = {"struct": 400, "object": 400}


# --- version 5 -------------------------------------------------------------------------------------------------------


def read_matlab5(path: str, limits: Limits, shown: str | None = None) -> Tree:
    """The variables of a version 5 file; a struct becomes a group, a cell array of texts a text dataset."""
    from scipy.io import loadmat, whosmat

    where = shown or path
    tree = Tree(file=where)
    try:
        with suppress(TypeError):  # an object of MATLAB declares no size: the reader process has its limit of memory
            _check_sizes(whosmat(path), where, limits)
        variables = loadmat(path, struct_as_record=False, squeeze_me=False)
    except (InputError, MemoryError):  # of memory the reader process tells
        raise
    except Exception as error:  # whatever the library says about a damaged file is a finding about the file
        raise InputError(where, f"damaged MATLAB file ({type(error).__name__}: {str(error)[:100]})") from error
    for name, value in variables.items():
        if not (name.startswith("__") and name.endswith("__")):
            if isinstance(value, np.ndarray) and value.dtype.names == OPAQUE_FIELDS and value.size == 1:
                name = _latin(value["s0"].flat[0])  # scipy calls objects None, or by nothing
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
    if hasattr(value, "toarray"):  # a sparse matrix
        value = value.toarray()
    array = np.asarray(value)
    if array.dtype.kind == "O" and array.size == 1 and hasattr(array.flat[0], "_fieldnames"):
        if depth > limits.depth:
            raise InputError(tree.file, f"/{name}: structs are nested deeper than {limits.depth}")
        group, struct = tree.group(name), array.flat[0]
        for key in struct._fieldnames:
            _variable(group, key, getattr(struct, key), limits, depth + 1)
        return
    if array.dtype.kind == "O" and array.size > 1 and all(hasattr(item, "_fieldnames") for item in array.flat):
        group = tree.group(name)
        for k, item in enumerate(array.ravel(order="F").tolist()):  # a struct array: one group an element
            _variable(group, str(k + 1), item, limits, depth + 1)
        return
    tree.datasets[name] = Dataset(_matlab_values(array))


def _matlab_values(array: AnyArray) -> Any:
    if array.dtype.kind in "fiu":
        return array.astype(np.float64)
    if array.dtype.kind == "c":
        return array.astype(np.complex128)
    if array.dtype.kind in "bU":
        return array
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


def write_matlab5(path: str | Path, variables: Mapping[str, Any]) -> None:
    """Write variables (arrays, numbers, texts, lists of texts as cell columns) to a version 5 file."""
    from scipy.io import savemat

    for name in variables:
        if not MATLAB_NAME.fullmatch(name):
            raise InputError(
                str(path), f"variable name {name!r}", "a letter, then letters, digits and underscores (63 at most)"
            )
    content = {
        name: np.array(value, dtype=object).reshape(-1, 1) if isinstance(value, list) else value
        for name, value in variables.items()
    }
    with Path(path).open("wb") as stream:
        # zlib carries a checksum, which version 5 itself has not
        savemat(stream, content, appendmat=False, do_compression=True)


# --- version 7.3 -----------------------------------------------------------------------------------------------------


def from_matlab73(tree: Tree) -> Tree:
    """The same tree with everything that MATLAB marked in MATLAB's own shape; unmarked datasets stay as they are."""
    # Where MATLAB keeps the contents of cells and of fields of struct arrays; only the latter are put in their places.
    return _group73(tree, tree.groups.get("#refs#", Tree()), 0, [0])


def _group73(tree: Tree, stored: Tree, depth: int, count: list[int]) -> Tree:
    result = Tree(dict(tree.attrs), {}, {}, tree.path, tree.file)
    elements = _elements73(tree)
    if elements:
        count[0] += len(elements)
        if depth > MAX_NESTED or count[0] > MAX_STRUCTS:  # references may lead to one struct from many, and in circles
            raise InputError(tree.file, f"{tree.path}: more than {MAX_STRUCTS} structs, or nested too deep")
        for k, fields in enumerate(elements, start=1):
            element = Tree({}, {}, {}, f"{tree.path}/{k}", tree.file)
            for name, path in fields.items():
                key = path.removeprefix("/#refs#/")
                if key in stored.datasets:
                    element.datasets[name] = stored.datasets[key]
                elif key in stored.groups:
                    element.groups[name] = stored.groups[key]
            result.groups[str(k)] = _group73(element, stored, depth + 1, count)
        return result
    for name, dataset in tree.datasets.items():
        result.datasets[name] = _from_matlab73(dataset)
    for name, group in tree.groups.items():
        if name not in ("#refs#", "#subsystem#"):
            result.groups[name] = _group73(group, stored, depth + 1, count)
    return result


def _elements73(tree: Tree) -> list[dict[str, str]]:
    """Field -> path, for each element of a struct array; it is stored as a group with a list of references a field."""
    marker = np.asarray(tree.attrs.get("MATLAB_class", ""))
    if marker.size != 1 or str(marker.flat[0]) != "struct" or not tree.datasets or tree.groups:
        return []
    lists: dict[str, list[str]] = {}
    for name, dataset in tree.datasets.items():
        if not isinstance(dataset.values, np.ndarray) or REFERENCES not in dataset.attrs:
            return []
        lists[name] = dataset.values.ravel().tolist()
    if len({len(paths) for paths in lists.values()}) > 1:
        return []
    return [dict(zip(lists, paths, strict=True)) for paths in zip(*lists.values(), strict=True)]


def _from_matlab73(dataset: Dataset) -> Dataset:
    marker = np.asarray(dataset.attrs.get("MATLAB_class", ""))
    values = dataset.values
    if REFERENCES in dataset.attrs:
        values = Unread("reference", np.shape(values) if isinstance(values, np.ndarray) else values.shape)
        attrs = {key: item for key, item in dataset.attrs.items() if key != REFERENCES}
        dataset = Dataset(values, attrs)
    if marker.dtype.kind != "U" or marker.size != 1 or not marker.flat[0]:
        return dataset
    kind = str(marker.flat[0])
    attrs = {key: item for key, item in dataset.attrs.items() if not key.startswith("MATLAB_")}
    if isinstance(values, Unread):
        known = kind in NUMERIC or values.dtype == "not read"
        return Dataset(Unread(values.dtype if known else f"MATLAB {kind}", values.shape[::-1]), attrs)
    empty = np.asarray(dataset.attrs.get("MATLAB_empty", 0))
    if empty.dtype.kind in "fib" and empty.any():
        # An empty array is stored as its sizes, in MATLAB's order.
        shape = tuple(int(n) for n in values.ravel()) if values.dtype.kind == "i" and values.size <= 32 else ()
        if 0 not in shape or min(shape) < 0 or max(shape) > MAX_EMPTY:
            return Dataset(Unread(f"MATLAB {kind}, marked empty, of size {shape}", shape), attrs)
        return Dataset(np.zeros(shape), attrs)
    if values.dtype.kind not in "fib":
        return Dataset(Unread(f"MATLAB {kind} that holds other values", values.shape[::-1]), attrs)
    if kind in NUMERIC:
        return Dataset(np.ascontiguousarray(values.T), attrs)
    if kind == "logical":
        return Dataset(np.ascontiguousarray(values.T).astype(bool), attrs)
    if kind == "char":
        codes = values.ravel(order="F").tolist()
        if not all(isinstance(code, int) and (0 < code < 0xD800 or 0xE000 <= code <= 0xFFFF) for code in codes):
            return Dataset(Unread("MATLAB char with other characters", values.shape[::-1]), attrs)
        return Dataset(np.array(["".join(map(chr, codes))]), attrs)
    return Dataset(Unread(f"MATLAB object ({kind})", values.shape[::-1]), attrs)
