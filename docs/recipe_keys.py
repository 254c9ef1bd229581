"""Describe the keys of steps and tables of the JSON Schema, for the reference."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Key:
    """A key of a table."""

    name: str
    takes: str  # what it takes; ``code`` is marked so
    needed: bool
    default: Any
    meaning: str

    def needed_or_default(self) -> list[str]:
        """Return "required", the default in words, or an empty text."""
        if self.needed:
            return ["**required**"]
        shown = self.default not in (None, "", [], {})
        return [f"default ``{json.dumps(self.default, ensure_ascii=False)}``"] if shown else []


def keys_of(part: Mapping[str, Any], parts: Mapping[str, Any]) -> list[Key]:
    """Return the keys of a table of the schema, without ``do``."""
    needed = part.get("required", [])
    return [
        Key(name, _takes(key, parts), name in needed, key.get("default"), _meaning(key))
        for name, key in part["properties"].items()
        if name != "do"
    ]


def _meaning(key: Mapping[str, Any]) -> str:
    inner = [*key.get("anyOf", []), *([key["items"]] if "items" in key else [])]
    return key.get("description") or next((found for part in inner if (found := _meaning(part))), "")


def _takes(key: Mapping[str, Any], parts: Mapping[str, Any]) -> str:
    if "$ref" in key:
        part = parts[key["$ref"].rpartition("/")[2]]
        return "table of " + ", ".join(f"``{name}``" for name in part["properties"])
    if choices := key.get("anyOf") or key.get("oneOf"):
        return " or ".join(_takes(choice, parts) for choice in choices if choice.get("type") != "null")
    if "const" in key:
        return f"``{json.dumps(key['const'])}``"
    if "enum" in key:
        return "one of " + ", ".join(f"``{json.dumps(value)}``" for value in key["enum"])
    if "patternProperties" in key:
        return "a table ``[step.NAME]`` for each step"
    if key["type"] == "array":
        return f"list of {_count(key)}({_takes(key['items'], parts)})"
    if key["type"] == "object":
        return f"table: name = {_takes(key['additionalProperties'], parts)}"
    return {"number": "number", "integer": "whole number", "string": "text", "boolean": "``true`` or ``false``"}[
        key["type"]
    ] + _limits(key)


def _count(key: Mapping[str, Any]) -> str:
    low, high = key.get("minItems"), key.get("maxItems")
    return f"{low} " if low == high is not None else f"{low} or more " if low else ""


def _limits(key: Mapping[str, Any]) -> str:
    words = {"exclusiveMinimum": "above", "minimum": "from", "maximum": "to", "exclusiveMaximum": "below"}
    limits = [f"{word} {key[name]:g}" for name, word in words.items() if name in key]
    return " " + " ".join(limits) if limits else ""
