"""Files of MATLAB (version 5 read and written, version 7.3 in HDF5) brought to one form.

Before anything of a version 5 file is kept, its elements are walked, to see how much memory they declare. Compressed
elements are inflated in small pieces that are thrown away, and only as far as their declared sizes stay within the
limits: 0.8 MB of zlib can hold gigabytes. Nested cells and structs count with all that they hold.

MATLAB stores matrices column by column. Version 7.3 files therefore show them transposed to every other HDF5 reader;
datasets that MATLAB marked (attribute ``MATLAB_class``) are transposed back here.

References
----------
MathWorks, *MAT-File Format* (R2024a), chapter 1.
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.signature import Limits, size_text
from robustlab.files.tree import REFERENCES, Dataset, Tree, Unread

NUMERIC = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
MAX_EMPTY = 1 << 31  # longest side of an array without entries
MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
HEADER = 128  # bytes
MATRIX, COMPRESSED = 14, 15  # data types of elements
OPAQUE_FIELDS = ("s0", "s1", "s2", "arr")  # of an object as scipy hands it over: variable, system, class, content
CELL, STRUCT, OBJECT, CHAR, SPARSE, OPAQUE = 1, 2, 3, 4, 5, 17  # classes of matrices; 6 to 15 are numbers
COMPLEX = 0x800  # flag
LONGEST_HEADER = 256  # bytes of flags, of 32 sizes, of a name
MAX_ELEMENTS = 100_000
MAX_NESTED, MAX_STRUCTS = 32, 10_000  # of struct arrays in version 7.3
PIECE = 1 << 16  # bytes inflated at a time
# What one value of each class takes once it is read: numbers become float64, a struct is a Python object.
BYTES_OF_VALUE = {CELL: 8, STRUCT: 400, OBJECT: 400, CHAR: 8}
BYTES_OF_MATRIX = 200  # of an array without values


# --- version 5 -------------------------------------------------------------------------------------------------------


def read_matlab5(path: str, limits: Limits, shown: str | None = None) -> Tree:
    """The variables of a version 5 file; a struct becomes a group, a cell array of texts a text dataset.

    Raises InputError: variables that declare more than the limits, a damaged file.
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
            if isinstance(value, np.ndarray) and value.dtype.names == OPAQUE_FIELDS and value.size == 1:
                name = _latin(value["s0"].flat[0])  # scipy calls objects None, or by nothing
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
    """Write variables (arrays, numbers, texts, lists of texts as cell columns) to a version 5 file.

    Raises InputError: a name that MATLAB does not allow.
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


# --- what a version 5 file would take --------------------------------------------------------------------------------


def check_matlab5_sizes(path: str | Path, where: str, limits: Limits) -> None:
    """Refuse a version 5 file whose variables take more than the limits, by the name of the variable.

    Raises InputError: a variable above ``limits.dataset``, all of them above ``limits.total``, more than `MAX_ELEMENTS`
    elements, nesting below ``limits.depth``; elements that do not lie inside each other (a damaged file).
    """
    with Path(path).open("rb") as file:
        order = "<" if file.read(HEADER)[126:128] == b"IM" else ">"
        walk = _Walk(where, limits, order)
        while True:
            tag = file.read(8)
            if not tag:
                return
            if len(tag) < 8:
                raise walk.damaged(f"{len(tag)} bytes after the last variable")
            kind, size = struct.unpack(order + "II", tag)
            end = file.tell() + size
            if kind == COMPRESSED:
                inflated = _Source(_inflated(file, size), walk)
                kind, inner = struct.unpack(order + "II", inflated.take(8))
                walk.variable(kind, inner, inflated)
            else:
                walk.variable(kind, size, _Source(_pieces(file, size), walk))
            file.seek(end)


def _pieces(file: BinaryIO, size: int) -> Iterator[bytes]:
    while size > 0 and (piece := file.read(min(size, PIECE))):
        size -= len(piece)
        yield piece


def _inflated(file: BinaryIO, size: int) -> Iterator[bytes]:
    """The content of a compressed element, never more than `PIECE` bytes at a time."""
    inflate = zlib.decompressobj()
    for piece in _pieces(file, size):
        rest = piece
        while rest and not inflate.eof:
            yield inflate.decompress(rest, PIECE)
            rest = inflate.unconsumed_tail
    while not inflate.eof and (piece := inflate.decompress(inflate.unconsumed_tail, PIECE)):
        yield piece


@dataclass
class _Source:
    """Bytes in the order in which they come, each of them once."""

    pieces: Iterator[bytes]
    walk: _Walk
    held: bytes = b""

    def take(self, count: int) -> bytes:
        """The next ``count`` bytes."""
        while len(self.held) < count:
            self.held += self._next()
        taken, self.held = self.held[:count], self.held[count:]
        return taken

    def skip(self, count: int) -> None:
        """Go over the next ``count`` bytes."""
        while len(self.held) < count:
            count -= len(self.held)
            self.held = self._next()
        self.held = self.held[count:]

    def _next(self) -> bytes:
        try:
            return next(self.pieces)
        except StopIteration:
            raise self.walk.damaged("an element is longer than what holds it") from None
        except zlib.error as error:
            raise self.walk.damaged(str(error)) from None


@dataclass
class _Walk:
    """What is known of the file so far; ``total`` are bytes in memory, ``start`` what it was before this variable."""

    where: str
    limits: Limits
    order: str
    name: str = "?"
    total: int = 0
    start: int = 0
    elements: int = 0

    def variable(self, kind: int, size: int, source: _Source) -> None:
        """Count one variable of ``size`` bytes."""
        self.name, self.start = "?", self.total
        if kind != MATRIX:
            raise self.damaged(f"an element of type {kind} where a variable should be")
        self._matrix(size, source, 0)

    def _matrix(self, left: int, source: _Source, depth: int) -> None:
        """Count a matrix of ``left`` bytes and all that is in it: flags, sizes, name, then data or further matrices."""
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            raise self._refused(f"more than {MAX_ELEMENTS} cells and fields in the file")
        if depth > self.limits.depth:
            raise self._refused(f"cells and structs are nested deeper than {self.limits.depth}")
        self._count(BYTES_OF_MATRIX)
        place, of_value, expected, opaque = 0, 0, 0, False
        while left >= 8:
            raw = source.take(8)
            kind, length = struct.unpack(self.order + "II", raw)
            left -= 8
            if kind >> 16:  # a small element stands in its own tag
                kind, data = kind & 0xFFFF, raw[4 : 4 + (kind >> 16)]
            else:
                if length > left:
                    raise self.damaged("an element is longer than what holds it")
                padded = length if kind == MATRIX else min(length + -length % 8, left)
                left -= padded
                if kind == MATRIX:
                    self._matrix(length, source, depth + 1)
                    continue
                data = source.take(padded)[:length] if place < 3 and length <= LONGEST_HEADER else b""
                if not data:
                    self._count(max(0, min(length, length - expected)))  # more data than the sizes say
                    expected = max(0, expected - length)
                    source.skip(padded)
            if place == 0 and len(data) >= 4:
                flags = struct.unpack(self.order + "I", data[:4])[0]
                opaque = flags & 0xFF == OPAQUE  # of these name, system and class follow, no sizes
                of_value = BYTES_OF_VALUE.get(flags & 0xFF, 16 if flags & COMPLEX else 8)
            elif place == 1 and len(data) >= 4 and not opaque:
                expected = of_value * math.prod(struct.unpack(f"{self.order}{len(data) // 4}I", data[: len(data) & ~3]))
            elif place == 1 and opaque:
                self.name = self.name if depth else data.decode("latin-1") or "?"
            elif place == 2 and not opaque:
                self.name = self.name if depth else data.decode("latin-1") or "?"
                self._count(expected)
            place += 1
        source.skip(left)

    def _count(self, size: int) -> None:
        """Add to the total, and refuse what is above the limits."""
        self.total += size
        if self.total - self.start > self.limits.dataset:
            taken = size_text(self.total - self.start)
            raise self._refused(f"declares {taken}, limit {size_text(self.limits.dataset)}")
        if self.total > self.limits.total:
            limit = size_text(self.limits.total)
            raise self._refused(f"with this variable {size_text(self.total)} in all, limit {limit}")

    def _refused(self, found: str) -> InputError:
        return InputError(self.where, f"/{self.name[:60]}: {found}")

    def damaged(self, found: str) -> InputError:
        """The elements do not fit into each other."""
        at = f" in variable {self.name[:60]}" if self.name != "?" else ""
        return InputError(self.where, f"damaged MATLAB file ({found}{at})")


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
