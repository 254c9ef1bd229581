"""Parse untrusted JSON and TOML into plain data of limited depth, safe for recursion."""

from __future__ import annotations

import json
import tomllib
from typing import Any, Literal

from robustlab.errors import InputError
from robustlab.files.signature import Limits, size_text

MAX_DEPTH = 64  # lists and tables in each other
WORD = {"json": "JSON", "toml": "TOML"}


def parse_document(kind: Literal["json", "toml"], raw: bytes, where: str) -> Any:
    """Return tables, lists, texts, numbers, booleans (and dates of TOML) of a file's bytes; ``where``: its name."""
    if len(raw) > Limits.document:
        raise InputError(where, f"{size_text(len(raw))} of {WORD[kind]}", f"at most {size_text(Limits.document)}")
    try:
        text = raw.decode("utf-8-sig" if kind == "json" else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(where, f"byte {error.start} is not UTF-8", f"{WORD[kind]} in UTF-8") from None
    try:
        data = (
            tomllib.loads(text) if kind == "toml" else json.loads(text, object_pairs_hook=_once, parse_constant=_none)
        )
        _check(data, 0)
    except json.JSONDecodeError as error:
        raise InputError(where, f"not valid JSON: {error.msg} (line {error.lineno}, column {error.colno})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"not valid TOML: {error}") from None
    except RecursionError:
        found = f"not readable as {WORD[kind]}: nested too deeply"
        raise InputError(where, found, f"at most {MAX_DEPTH} levels") from None
    except ValueError as error:  # huge whole numbers, half a surrogate pair, errors raised below
        raise InputError(where, f"not readable as {WORD[kind]}: {str(error)[:100]}") from None
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))
        raise ValueError(f"key {twice!r:.80} is written twice")
    return table


def _none(word: str) -> float:
    raise ValueError(f"{word} is among the numbers")


def _check(value: Any, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise RecursionError
    if isinstance(value, dict):
        for key, item in value.items():
            key.encode()
            _check(item, depth + 1)
    elif isinstance(value, list):
        for item in value:
            _check(item, depth + 1)
    elif isinstance(value, str):
        value.encode()
    elif type(value) is int and not -(2**63) <= value < 2**63:
        raise ValueError("a whole number beyond 64 bits")
