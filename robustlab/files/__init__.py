"""Files from outside: untrusted HDF5, MATLAB and text files into plain arrays, and atomic writing."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    **dict.fromkeys(("Limits", "content_of", "size_text"), "signature"),
    "ReaderServer": "isolation",
    **dict.fromkeys(("read_response", "read_table"), "text_table"),
    **dict.fromkeys(("read_tree", "write_tree"), "hdf5"),
    **dict.fromkeys(
        ("Dataset", "KINDS", "Tree", "Unread", "content_sha256", "link_name", "signal_name", "stamp"), "tree"
    ),
    "atomic_write": "atomic",
    **dict.fromkeys(("MAX_DEPTH", "parse_document"), "document"),
    **dict.fromkeys(("RecordOptions", "choose"), "records"),
    **dict.fromkeys(("Channel", "Source"), "record_source"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.files.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.files' has no attribute {name!r}")
