# pyright: reportMissingParameterType=false
"""How compiled functions are made: `leaf` inside others, `entry` with its signatures and its code kept on disk.

No fast arithmetic, not even contraction to fused multiply-adds: a leaf stands in the code of several entries, optimised
differently, and which of these copies is called depends on whether an entry was just compiled or read from disk. With
IEEE arithmetic as written all copies give the same bits, the first run on a machine those of every later one; it costs
6 to 10 % of the time.
"""

from __future__ import annotations

from typing import Any

from numba import njit

__all__ = ["entry", "leaf"]

_options: dict[str, Any] = {"error_model": "numpy", "nogil": True}
leaf = njit(**_options)


def entry(*signatures):
    """Compile for the given signatures, and keep the code on disk."""
    return njit(list(signatures), cache=True, **_options)
