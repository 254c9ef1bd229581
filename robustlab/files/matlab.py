"""MATLAB files: version 5 read and written, version 7.3 (HDF5) brought to the same form.

MATLAB stores matrices column by column. Version 7.3 files therefore show them transposed to every other HDF5 reader;
datasets that MATLAB marked (attribute ``MATLAB_class``) are transposed back here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.files.limits import Limits
from robustlab.files.matlab_sizes import check_matlab5_sizes
from robustlab.files.tree import Dataset, Tree, Unread

__all__ = ["from_matlab73", "read_matlab5", "write_matlab5"]

NUMERIC = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
MAX_EMPTY = 1 << 31  # longest side of an array without entries
MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


# --- version 5 -------------------------------------------------------------------------------------------------------


def read_matlab5(path: str, limits: Limits, shown: str | None = None) -> Tree:
    """The variables of a version 5 file; a struct becomes a group, a cell array of texts a text dataset.

    Raises
    ------
    InputError
        Variables that declare more than the limits, a damaged file.
    """
    from scipy.io import loadmat

    where = shown or path
    tree = Tree(file=where)
    check_matlab5_sizes(path, where, limits)
    try:
        variables = loadmat(path, struct_as_record=False, squeeze_me=False)
    except InputError:
        raise
    except MemoryError:
        raise InputError(where, "needs more memory than the reader may use") from None
    except Exception as error:  # whatever the library says about a damaged file is a finding about the file
        raise InputError(where, f"damaged MATLAB file ({type(error).__name__}: {str(error)[:100]})") from error
    for name, value in variables.items():
        if not (name.startswith("__") and name.endswith("__")):
            _variable(tree, name, value, limits, 0)
    return tree


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
    tree.datasets[name] = Dataset(_matlab_values(array))


def _matlab_values(array: np.ndarray[Any, Any]) -> Any:
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
        return Unread("struct array" if cells and hasattr(array.flat[0], "_fieldnames") else "cell array", array.shape)
    return Unread("MATLAB object", array.shape)


def write_matlab5(path: str | Path, variables: Mapping[str, Any]) -> None:
    """Write variables (arrays, numbers, texts, lists of texts as cell columns) to a version 5 file.

    Raises
    ------
    InputError
        A name that MATLAB does not allow.
    """
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
    result = Tree(dict(tree.attrs), {}, {}, tree.path, tree.file)
    for name, dataset in tree.datasets.items():
        result.datasets[name] = _from_matlab73(dataset)
    for name, group in tree.groups.items():
        # Where MATLAB keeps the contents of cells and objects; they are reached by references, which are not followed.
        if name not in ("#refs#", "#subsystem#"):
            result.groups[name] = from_matlab73(group)
    return result


def _from_matlab73(dataset: Dataset) -> Dataset:
    marker = np.asarray(dataset.attrs.get("MATLAB_class", ""))
    values = dataset.values
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
