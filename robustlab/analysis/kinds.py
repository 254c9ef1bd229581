"""Options of a question that only some kinds of systems know."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robustlab.errors import InputError


def options_of(
    question: str, kind: str, given: Mapping[str, Any], names: Mapping[str, str], hint: str | None = None
) -> dict[str, Any]:
    """What was given, under the names that the kind's own method has for it; None is what was left out."""
    chosen = {name: value for name, value in given.items() if value is not None}
    for name, value in chosen.items():
        if name not in names:
            known = f"of {', '.join(given)}: {', '.join(names) or 'none'}"
            raise InputError(f"{question}: {name}", f"{value!r} for {kind}", known, hint)
    return {names[name]: value for name, value in chosen.items()}
