"""Edits that spoil a file: of its bytes, and of what it holds (for `fuzz`)."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse

Edit = Callable[[random.Random, bytes], bytes]

NUMBERS = [0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 62, (1 << 64) - 1]


def flip(rng: random.Random, raw: bytes) -> bytes:
    """One to eight bits, or one byte."""
    out = bytearray(raw)
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[rng.randrange(len(out))] ^= rng.choice((1 << rng.randrange(8), rng.randrange(1, 256)))
    return bytes(out)


def cut(rng: random.Random, raw: bytes) -> bytes:
    """The end, or a piece out of the middle, is missing."""
    i, j = sorted(rng.randrange(len(raw)) for _ in range(2))
    return raw[:i] if rng.random() < 0.5 else raw[:i] + raw[j:]


def insert(rng: random.Random, raw: bytes) -> bytes:
    """Bytes more than there were: noise, a repeated piece, a thousand of one kind."""
    i, j = sorted(rng.randrange(len(raw)) for _ in range(2))
    piece = rng.choice(
        (rng.randbytes(rng.randrange(1, 64)), raw[i : min(j, i + 4096)], bytes([rng.randrange(256)]) * 1000)
    )
    return raw[:i] + piece + raw[i:]


def number(rng: random.Random, raw: bytes) -> bytes:
    """A whole number of 1, 2, 4 or 8 bytes is another one: a size, an offset, a type."""
    size = rng.choice((1, 2, 4, 8))
    i = rng.randrange(max(len(raw) - size, 1)) // size * size
    value = (rng.choice(NUMBERS) + rng.choice((-1, 0, 0, 1))) % (1 << 8 * size)
    return raw[:i] + value.to_bytes(size, rng.choice(("little", "big"))) + raw[i + size :]


BYTES: tuple[Edit, ...] = (flip, flip, cut, insert, number, number)


def hdf5_object(rng: random.Random, raw: bytes) -> bytes:
    """One object, attribute or link of an HDF5 file is another one."""
    image = io.BytesIO(raw)
    with h5py.File(image, "r+") as file:
        paths: list[str] = []
        file.visit(paths.append)
        path = rng.choice(paths or ["/"])
        thing = file[path]
        match rng.randrange(10):
            case 0:
                del file[path]
            case 1:
                file.move(path, path + rng.choice(("x", "%", "é", " ", "A")))
            case 2:
                file[f"{path}_l"] = rng.choice((h5py.SoftLink(path), h5py.ExternalLink("other.h5", "/A"), thing))
            case 3 | 4:
                _attribute(rng, rng.choice((file, thing)))
            case 5 if isinstance(thing, h5py.Dataset) and thing.size and thing.dtype.kind in "fi":
                index = tuple(rng.randrange(n) for n in thing.shape)
                thing[index] = rng.choice((np.nan, np.inf, 1e308, 0.0, -1.0, 1e-320)) if thing.dtype.kind == "f" else 7
            case 6 | 7:
                del file[path]
                if rng.random() < 0.2:
                    file.create_group(path)
                else:
                    file[path] = rng.choice(_hostile(rng))
            case 8:
                file.create_dataset(
                    f"{path}_z", (1500, 1500), dtype=rng.choice("bf"), chunks=(500, 500), compression=9
                )[...] = 0
            case _:
                pass
        if rng.random() < 0.7:  # with its hash, the file is refused before anybody looks at the structure
            file.attrs.pop("content_sha256", None)
        file.flush()
    return image.getvalue()


def _hostile(rng: random.Random) -> list[Any]:
    return [
        np.zeros((0, 3)), np.zeros((3, 0)), np.float64(1.0), np.ones((2, 2, 2)), np.array([[1 + 2j]]),
        np.ones((2, 2), bool), b"text", np.array(["a", "\x1b[31m"], dtype=h5py.string_dtype()),
        np.full((3, 3), np.nan), np.ones(3, ">i2"),
        np.full(2, 2**63 + 5, np.uint64), np.zeros(2, [("a", "f8"), ("b", "i4")]), np.ones((2, 2), np.float16),
        np.full((2, 2), -1, np.int64), h5py.Empty("f8"), np.array([b"\xff\xfe"]), np.arange(rng.randrange(1, 50) * 1.0),
        np.frombuffer(b"\x01" * 8, "V8"), np.array("x" * 60_000, dtype=h5py.string_dtype()),
    ]  # fmt: skip


def _attribute(rng: random.Random, thing: Any) -> None:
    name = rng.choice([*thing.attrs, "dt", "Ts", "sequence", "null", "MATLAB_class", "format"])
    value = rng.choice(
        (0, -1, 1e400, np.nan, 2**62, "", "x" * 3000, "robustlab", "9.9", np.ones(3), np.zeros(0), b"\xff")
    )
    if rng.random() < 0.3:
        thing.attrs.pop(name, None)
    else:
        thing.attrs[name] = value


def matlab_variables(rng: random.Random, raw: bytes) -> bytes:
    """Other variables in a MATLAB file: another class, nested, empty, many."""
    content = {k: v for k, v in scipy.io.loadmat(io.BytesIO(raw)).items() if not k.startswith("__")}
    name = rng.choice([*content, "new"])
    deep: Any = 1.0
    for _ in range(rng.choice((3, 15, 40))):
        deep = {"s": deep}
    content[name] = rng.choice((
        np.zeros((0, 3)), "text", np.array(["a", "b"], object), deep, np.ones((2, 2, 2)), np.full((2, 2), np.nan),
        scipy.sparse.csc_matrix((60_000, 60_000)), np.array([np.eye(2), "x"], object), np.zeros((3000, 3000), np.uint8),
        np.array([1 + 2j]), np.array(True), np.array([[b"x"]]), np.zeros(3, [("a", object), ("b", object)]),
        np.int8(-1),
    ))  # fmt: skip
    out = io.BytesIO()
    scipy.io.savemat(out, content, do_compression=rng.random() < 0.5)
    return out.getvalue()


STRUCTURAL = (hdf5_object, matlab_variables)
