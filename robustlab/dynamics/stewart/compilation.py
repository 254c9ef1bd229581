"""The compiled kernels, loaded on first use; the first time on a machine they are compiled, which is said on stderr."""

from __future__ import annotations

import sys
import threading
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

__all__ = ["kernels", "motion_kernels"]

# Kernels kept on disk load within this time; what takes longer is being compiled.
PATIENCE = 6.0


@cache
def kernels() -> ModuleType:
    """Module of the compiled kinematics and dynamics."""
    return _load("kernels")


@cache
def motion_kernels() -> ModuleType:
    """Module of the compiled integrators."""
    from robustlab.dynamics.stewart.dop853 import TABLE

    folder = Path(__file__).parent
    # The compiler looks only at a function's own file for changes; these functions are built from those of kernels.py,
    # and hold the coefficients of scipy's file.
    leaves = max(Path(file).stat().st_mtime for file in (folder / "kernels.py", TABLE))
    for index in (folder / "__pycache__").glob("motion_kernels.*.nbi"):
        if index.stat().st_mtime < leaves:
            index.unlink(missing_ok=True)
    return _load("motion_kernels")


def _load(name: str) -> ModuleType:
    text = "stewart-platform: compiling the equations of motion (once on this machine, a minute or two) ..."
    timer = threading.Timer(PATIENCE, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        return import_module(f"robustlab.dynamics.stewart.{name}")
    finally:
        timer.cancel()
