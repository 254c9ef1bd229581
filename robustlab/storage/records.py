"""Records in a file: of format 1, and of any file that holds columns over a clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robustlab.errors import InputError
from robustlab.files.records import CLOCK_NAMES, RecordOptions, read_record
from robustlab.files.records import decode_record as decode_columns
from robustlab.files.records import encode_record as encode_columns
from robustlab.files.signature import Limits
from robustlab.files.tree import Tree
from robustlab.record import Record
from robustlab.storage.matrices import Problems


def encode_record(tree: Tree, record: Record) -> None:
    """Dataset ``t``, one dataset for each signal in groups ``inputs`` and ``outputs``."""
    keywords = {key: getattr(record, key) for key in ("t", "inputs", "outputs", "units", "name", "meaning")}
    encode_columns(tree, keywords)


def decode_record(tree: Tree, _problems: Problems, _transpose: bool = False) -> Record:
    """Inverse of `encode_record`. Raises InputError: with all that is missing or does not fit."""
    return _record(decode_columns(tree, tree.file), tree.file)


def record_from(path: str | Path, group: str | None, limits: Limits | None, isolate: bool) -> Record:
    """The record in a file without header; see `robustlab.files.records.read_record`."""
    return _record(read_record(path, RecordOptions(group), limits, isolate), str(path))


def looks_like_a_record(tree: Tree) -> bool:
    """True where the root holds a clock, or groups ``inputs`` or ``outputs``."""
    return any(name in tree.datasets for name in CLOCK_NAMES) or bool({"inputs", "outputs"} & set(tree.groups))


def _record(keywords: dict[str, Any], where: str) -> Record:
    name = keywords.pop("name")
    try:
        return Record(**keywords, name=name)
    except InputError as error:
        raise InputError(
            where, f"{error.where.removeprefix(name).lstrip(': ')} {error.found}".strip(), error.expected, error.hint
        ) from None
