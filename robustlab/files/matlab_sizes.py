"""How much memory a MATLAB version 5 file would take, from what its elements declare, before any of it is kept.

Compressed elements are inflated in small pieces that are thrown away, and only as far as their declared sizes stay
within the limits: 0.8 MB of zlib can hold gigabytes. Nested cells and structs count with all that they hold.

References
----------
MathWorks, *MAT-File Format* (R2024a), chapter 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from robustlab.errors import InputError
from robustlab.files.limits import Limits, size_text

__all__ = ["check_matlab5_sizes"]

HEADER = 128  # bytes
MATRIX, COMPRESSED = 14, 15  # data types of elements
CELL, STRUCT, OBJECT, CHAR, SPARSE = 1, 2, 3, 4, 5  # classes of matrices; 6 to 15 are numbers
COMPLEX = 0x800  # flag
LONGEST_HEADER = 256  # bytes of flags, of 32 sizes, of a name
MAX_ELEMENTS = 100_000
PIECE = 1 << 16  # bytes inflated at a time
# What one value of each class takes once it is read: numbers become float64, a struct is a Python object.
BYTES_OF_VALUE = {CELL: 8, STRUCT: 400, OBJECT: 400, CHAR: 8}
BYTES_OF_MATRIX = 200  # of an array without values


def check_matlab5_sizes(path: str | Path, where: str, limits: Limits) -> None:
    """Refuse a version 5 file whose variables take more than the limits, by the name of the variable.

    Raises
    ------
    InputError
        A variable above ``limits.dataset``, all of them above ``limits.total``, more than `MAX_ELEMENTS` elements,
        nesting below ``limits.depth``; elements that do not lie inside each other (a damaged file).
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
        place, of_value, expected = 0, 0, 0
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
                of_value = BYTES_OF_VALUE.get(flags & 0xFF, 16 if flags & COMPLEX else 8)
            elif place == 1 and len(data) >= 4:
                expected = of_value * math.prod(struct.unpack(f"{self.order}{len(data) // 4}I", data[: len(data) & ~3]))
            elif place == 2:
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
