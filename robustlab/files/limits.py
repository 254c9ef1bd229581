"""Sizes that a file from outside may have."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Limits", "size_text"]

MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """What is read at most; everything is checked against the declared sizes before any of it is read.

    Attributes
    ----------
    file, dataset, total
        Bytes of the file, of one dataset in memory, of all datasets in memory.
    document
        Bytes of a document of JSON.
    objects, depth
        Number of groups and datasets, and how deep groups may be nested.
    name
        Characters of a name.
    seconds
        Time the reader process may take.
    """

    file: int = 2048 * MIB
    dataset: int = 256 * MIB
    total: int = 512 * MIB
    document: int = 32 * MIB
    objects: int = 10_000
    depth: int = 16
    name: int = 200
    seconds: float = 30.0


def size_text(n: int) -> str:
    """A number of bytes as people write it.

    Examples
    --------
    >>> size_text(8 * 10**12), size_text(256 << 20)
    ('8 TB', '256 MiB')
    """
    if n >= 1 << 10 and n % (1 << 20) == 0 and n < 1 << 30:
        return f"{n >> 20} MiB"
    if n >= 1 << 30 and n % (1 << 30) == 0 and n < 1 << 40:
        return f"{n >> 30} GiB"
    for unit, scale in (("EB", 1e18), ("PB", 1e15), ("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n >= scale:
            return f"{n / scale:.4g} {unit}"
    return f"{n} bytes"
