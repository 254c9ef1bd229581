"""Storage: format 1 and plain files to models, records and results, and back."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    **dict.fromkeys(("Loaded", "load", "load_pair", "read", "save"), "interchange"),
    "c_source": "controller_export",
    "load_parametric": "expression_files",
    "Problems": "matrices",
    "check_pair": "pairs",
    **dict.fromkeys(("decode_plant", "encode_plant"), "plants"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.storage.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.storage' has no attribute {name!r}")
