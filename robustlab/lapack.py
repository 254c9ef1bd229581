"""LAPACK routines without the checks and copies of their usual fronts, for loops of thousands of small problems."""

from __future__ import annotations

from functools import cache
from typing import Any

__all__ = ["lapack"]


@cache
def lapack() -> Any:
    """The module of raw LAPACK routines; callers check that what they hand over is finite."""
    from scipy.linalg import lapack as routines

    return routines
