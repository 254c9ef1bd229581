"""Documents of JSON and TOML from outside: parsed in the reader process, checked there, and handed on as plain data.

A parser can be made to hang, to nest beyond its stack or to grow by its input, so the parser runs in the child (see
`robustlab.files.isolation`), under limits of time and memory that follow from the size of the text.
"""

from __future__ import annotations

import json
import math
import tomllib
from typing import Any, Literal

from robustlab.errors import InputError
from robustlab.files.signature import Limits, size_text

Kind = Literal["json", "toml"]

MAX_DEPTH = 64  # lists and tables in each other; what follows walks them by recursion
WORD = {"json": "JSON", "toml": "TOML"}


def read_document(kind: Kind, raw: bytes, where: str, limits: Limits | None = None) -> Any:
    """The document in the bytes of a file, parsed in the reader process.

    ``kind``: ``json`` or ``toml``.
    ``raw``: the bytes of the file, UTF-8.
    ``where``: what messages call the file.
    Raises InputError: as `parse_document`; more than ``limits.document`` bytes; a parser that crashed, hung or ran out
    of memory. EnvironmentFault: the reader process could not be started.
    """
    from robustlab.files.isolation import document_isolated  # not needed where the child parses

    limits = limits or Limits()
    if len(raw) > limits.document:
        raise InputError(where, f"{size_text(len(raw))} of {WORD[kind]}", f"at most {size_text(limits.document)}")
    return document_isolated(kind, raw, where, limits)


def parse_document(kind: Kind, raw: bytes, where: str) -> Any:
    """Tables, lists, texts, numbers, yes/no (and in TOML dates) from the text of a document.

    Whole numbers of JSON beyond 64 bits become floats, as other programs read them, and infinite beyond float64;
    TOML has none of either.

    Raises InputError: not UTF-8, not JSON or TOML; JSON with NaN, a key written twice, half a surrogate pair; whole
    numbers of TOML beyond 64 bits, any of thousands of digits; nested deeper than `MAX_DEPTH`.
    """
    try:
        text = raw.decode("utf-8-sig" if kind == "json" else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(where, f"byte {error.start} is not UTF-8", f"{WORD[kind]} in UTF-8") from None
    try:
        data = _json(text, where) if kind == "json" else tomllib.loads(text)
    except InputError:  # a ValueError as well
        raise
    except json.JSONDecodeError as error:
        raise InputError(where, f"not valid JSON: {error.msg} (line {error.lineno}, column {error.colno})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"not valid TOML: {error}") from None
    except RecursionError:
        raise _too_deep(kind, where) from None
    except MemoryError:
        raise InputError(where, "needs more memory than the reader may use") from None
    except ValueError as error:  # whole numbers of thousands of digits, times that no clock shows
        found = "a number too long, of thousands of digits" if "digit" in str(error) else str(error)
        raise InputError(where, f"not readable as {WORD[kind]}: {found}") from None
    return _checked(data, kind, where)


def _json(text: str, where: str) -> Any:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            seen: set[str] = set()
            twice = next(name for name, _ in pairs if name in seen or seen.add(name))
            raise InputError(where, f"key {twice!r:.80} is written twice", "each key once")
        return table

    def refused(word: str) -> float:
        raise InputError(where, f"{word} is among the numbers", "finite numbers")

    return json.loads(text, object_pairs_hook=once, parse_constant=refused)


def _checked(data: Any, kind: Kind, where: str) -> Any:
    """The data with whole numbers in range; no recursion, for it is not known yet how deep it is."""
    root = [data]
    pending: list[tuple[Any, int]] = [(root, 0)]
    while pending:
        node, depth = pending.pop()
        if depth > MAX_DEPTH:
            raise _too_deep(kind, where)
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            if isinstance(key, str):
                _check_text(key, where)
            if isinstance(value, (dict, list)):
                pending.append((value, depth + 1))
            elif isinstance(value, str):
                _check_text(value, where)
            elif type(value) is int and not -(2**63) <= value < 2**63:
                node[key] = _large(value, key, kind, where)
    return root[0]


def _too_deep(kind: Kind, where: str) -> InputError:
    return InputError(where, f"not readable as {WORD[kind]}: nested too deeply", f"at most {MAX_DEPTH} levels")


def _large(value: int, key: str | int, kind: Kind, where: str) -> float:
    if kind == "toml":
        at = f"{key!r:.80}: " if isinstance(key, str) else f"entry {key}: "
        raise InputError(where, f"{at}a whole number beyond 64 bits", "a smaller number, or one with a point")
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _check_text(text: str, where: str) -> None:
    if not text.isascii() and any("\ud800" <= ch <= "\udfff" for ch in text):
        raise InputError(where, f"half a surrogate pair in {text!r:.60}", "text that can be written as UTF-8")
