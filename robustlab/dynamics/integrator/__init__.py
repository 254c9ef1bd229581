"""Modules of compiled kernels, loaded on first use; a message announces their first compilation on a machine."""

from __future__ import annotations

import sys
import threading
from importlib import import_module
from pathlib import Path
from types import ModuleType

# Cached kernels load within this time in s; else they are being compiled.
PATIENCE = 6.0


def compiled(name: str, text: str) -> ModuleType:
    """Import the kernels ``robustlab.dynamics.NAME``, compiled again where the integrator in them is newer."""
    from robustlab.dynamics.integrator import steps

    newest = max(Path(leaf).stat().st_mtime for leaf in (str(steps.__file__), steps.TABLE))
    folder, _, stem = name.rpartition(".")
    for index in (Path(__file__).parents[1] / folder / "__pycache__").glob(f"{stem}.*.nbi"):
        if index.stat().st_mtime < newest:
            index.unlink(missing_ok=True)
    timer = threading.Timer(PATIENCE, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        return import_module(f"robustlab.dynamics.{name}")
    finally:
        timer.cancel()
