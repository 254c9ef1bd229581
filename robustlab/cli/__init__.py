"""The command line: one file per command group; it parses, calls and prints, and contains no mathematics."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    "main_guard": "ending",
    **dict.fromkeys(("GROUPS", "parser"), "groups"),
    **dict.fromkeys(("help_text", "run_command"), "main"),
    "PLANTS": "offers",
    "Display": "progress",
    "command_of": "generated",
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.cli.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.cli' has no attribute {name!r}")
