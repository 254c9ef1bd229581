"""One declaration of a capability: what a command and a step of recipes offer of a function of Python."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    **dict.fromkeys(("ALL", "COMMANDS", "Door", "STEPS", "every_door", "reading_option"), "declaration"),
    **dict.fromkeys(("Choice", "Numbers", "Table", "Thing", "Whole"), "kinds"),
    "METRICS": "members",
    "COVERS": "sets",
    **dict.fromkeys(("Positive", "ToModel"), "vocabulary"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.doors.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.doors' has no attribute {name!r}")
