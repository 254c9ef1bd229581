"""Options that only some types of systems have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robustlab.errors import InputError


def options_of(
    question: str, kind: str, given: Mapping[str, Any], names: Mapping[str, str], hint: str | None = None
) -> dict[str, Any]:
    """Return the given options (not None) under the names of the type's own method; reject others."""
    chosen = {name: value for name, value in given.items() if value is not None}
    for name, value in chosen.items():
        if name not in names:
            known = f"of {', '.join(given)}: {', '.join(names) or 'none'}"
            raise InputError(f"{question}: {name}", f"{value!r} for {kind}", known, hint)
    return {names[name]: value for name, value in chosen.items()}
