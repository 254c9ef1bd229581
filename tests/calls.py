"""How many functions are called: a measure of work that no load of the machine changes."""

from __future__ import annotations

import sys
from collections.abc import Callable

__all__ = ["calls"]


def calls(function: Callable[[], object]) -> int:
    """Calls of Python's and of compiled functions that Python makes while ``function`` runs."""
    count = 0

    def listen(_frame: object, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(listen)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count
