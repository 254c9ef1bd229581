"""The samples of one piece of work as they come from a worker: arrays, and one line of text for each lost sample."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.uncertainty.blocks import Block, ComplexScalar, RealScalar

__all__ = ["DONE", "LOST", "Rows", "decode_delta", "delta_width", "encode_delta"]

DONE, LOST = 0, 1


@dataclass(frozen=True)
class Rows:
    """Consecutive samples.

    Attributes
    ----------
    first
        Index of the first one.
    values
        The metric, shape (k,); NaN where a sample is lost.
    deltas
        Normalised Deltas as numbers, shape (k, width); see `encode_delta`.
    seconds
        Time each one took, shape (k,); samples computed together share their time evenly.
    lost
        Index -> reason, for samples that gave no value.
    """

    first: int
    values: NDArray[np.float64]
    deltas: NDArray[np.float64]
    seconds: NDArray[np.float64]
    lost: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.values)

    def up_to(self, n: int) -> Rows:
        """The samples with an index below ``n``."""
        count = max(0, min(len(self), n - self.first))
        lost = {index: reason for index, reason in self.lost.items() if index < n}
        return Rows(self.first, self.values[:count], self.deltas[:count], self.seconds[:count], lost)

    def followed_by(self, others: Sequence[Rows]) -> Rows:
        """These samples and those that come next, in one piece."""
        parts = [self, *others]
        return Rows(
            self.first,
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.deltas for part in parts]),
            np.concatenate([part.seconds for part in parts]),
            {index: reason for part in parts for index, reason in part.lost.items()},
        )

    def to_bytes(self) -> bytes:
        """A line of JSON, then the arrays as little-endian float64."""
        head = {"first": self.first, "shape": list(self.deltas.shape), "lost": list(self.lost.items())}
        arrays = [array.astype("<f8").tobytes() for array in (self.values, self.deltas, self.seconds)]
        return b"".join([json.dumps(head).encode(), b"\n", *arrays])

    @classmethod
    def from_bytes(cls, data: bytes) -> Rows:
        """Inverse of `to_bytes`.

        Raises
        ------
        ValueError
            The bytes are something else.
        """
        head, _, body = data.partition(b"\n")
        content = json.loads(head)
        count, width = (int(size) for size in content["shape"])
        numbers = np.frombuffer(body, dtype="<f8").astype(np.float64)
        if numbers.size != count * (width + 2):
            raise ValueError(f"{numbers.size} numbers for {count} samples of width {width}")
        values, deltas, seconds = np.split(numbers, [count, count * (width + 1)])
        lost = {int(index): str(reason) for index, reason in content["lost"]}
        return cls(int(content["first"]), values, deltas.reshape(count, width), seconds, lost)


def delta_width(blocks: Sequence[Block]) -> int:
    """Number of real numbers that `encode_delta` needs."""
    return sum(1 if isinstance(block, RealScalar) else 2 * _entries(block) for block in blocks)


def encode_delta(blocks: Sequence[Block], values: Mapping[str, Any]) -> NDArray[np.float64]:
    """Delta as real numbers, shape (width,): one for a real scalar, real and imaginary parts of all entries else."""
    numbers: list[float] = []
    for block in blocks:
        if isinstance(block, RealScalar):
            numbers.append(float(values[block.name]))
            continue
        entries = np.asarray(values[block.name], dtype=complex).ravel()
        numbers += [*np.real(entries).tolist(), *np.imag(entries).tolist()]
    return np.array(numbers, dtype=np.float64)


def decode_delta(blocks: Sequence[Block], numbers: NDArray[np.float64]) -> dict[str, Any]:
    """Inverse of `encode_delta`.

    Examples
    --------
    >>> blocks = [RealScalar("k"), ComplexScalar("c")]
    >>> decode_delta(blocks, encode_delta(blocks, {"k": 0.5, "c": 0.1 - 0.2j}))
    {'k': 0.5, 'c': (0.1-0.2j)}
    """
    values: dict[str, Any] = {}
    start = 0
    for block in blocks:
        if isinstance(block, RealScalar):
            values[block.name] = float(numbers[start])
            start += 1
            continue
        count = _entries(block)
        entries = numbers[start : start + count] + 1j * numbers[start + count : start + 2 * count]
        start += 2 * count
        scalar = isinstance(block, ComplexScalar)
        values[block.name] = complex(entries[0]) if scalar else entries.reshape(block.rows, block.cols)
    return values


def _entries(block: Block) -> int:
    return 1 if isinstance(block, ComplexScalar) else block.rows * block.cols
