"""Messages between robustlab and the child that runs a unit: a JSON header and float64 arrays. No pickle."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, RobustlabError

__all__ = ["error_header", "raise_sent", "receive", "send"]

LARGEST_HEADER = 1 << 28  # bytes; a description of 200 000 variables has a third of it
LARGEST_ARRAY = 1 << 33


def send(stream: BinaryIO, header: dict[str, Any], arrays: Sequence[Array] = ()) -> None:
    """Write one message."""
    plain = [np.ascontiguousarray(a, dtype="<f8") for a in arrays]
    raw = json.dumps({**header, "shapes": [a.shape for a in plain]}).encode()
    stream.write(len(raw).to_bytes(8, "little") + raw)
    for a in plain:
        stream.write(a.tobytes())
    stream.flush()


def receive(stream: BinaryIO) -> tuple[dict[str, Any], list[Array]]:
    """Read one message.

    Raises
    ------
    EOFError
        The other end is gone.
    ValueError
        What came is no message.
    """
    size = int.from_bytes(_exactly(stream, 8), "little")
    if size > LARGEST_HEADER:
        raise ValueError("no header")
    header = json.loads(_exactly(stream, size))
    arrays = []
    for shape in header.pop("shapes"):
        count = math.prod(int(n) for n in shape)
        if not 0 <= 8 * count <= LARGEST_ARRAY:
            raise ValueError("no array")
        arrays.append(np.frombuffer(bytearray(_exactly(stream, 8 * count)), dtype="<f8").reshape(shape))
    return header, arrays


def error_header(error: RobustlabError) -> dict[str, Any]:
    """An error as a message's header."""
    kind = "number" if isinstance(error, NoTrustworthyNumber) else "input"
    return {"error": [kind, error.where, error.found, error.expected, error.hint]}


def raise_sent(header: dict[str, Any]) -> None:
    """Raise the error that a header holds, if it does."""
    if "error" in header:
        kind, *said = header["error"]
        raise (NoTrustworthyNumber if kind == "number" else InputError)(*said)


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size) if size else b""
    if data is None or len(data) < size:
        raise EOFError
    return data
