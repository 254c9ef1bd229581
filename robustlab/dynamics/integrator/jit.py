# pyright: reportMissingParameterType=false
"""How compiled functions are made: `leaf` inside others, `entry` with its signatures and its code kept on disk."""

from __future__ import annotations

from typing import Any

from numba import njit

__all__ = ["entry", "leaf"]

_options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "fastmath": {"contract"}}
leaf = njit(**_options)


def entry(*signatures):
    """Compile for the given signatures, and keep the code on disk."""
    return njit(list(signatures), cache=True, **_options)
