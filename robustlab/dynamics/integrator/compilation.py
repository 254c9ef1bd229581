"""Modules of compiled kernels, loaded on first use; a message announces their first compilation on a machine."""

from __future__ import annotations

import sys
import threading
from importlib import import_module
from pathlib import Path
from types import ModuleType

# Cached kernels load within this time in s; else they are being compiled.
PATIENCE = 6.0


def compiled(module: Path, name: str, leaves: tuple[str | Path, ...], text: str) -> ModuleType:
    """Import the module of kernels in the file ``module`` with the dotted ``name``."""
    newest = max(Path(leaf).stat().st_mtime for leaf in (*leaves, Path(__file__).with_name("steps.py")))
    for index in (module.parent / "__pycache__").glob(f"{module.stem}.*.nbi"):
        if index.stat().st_mtime < newest:
            index.unlink(missing_ok=True)
    timer = threading.Timer(PATIENCE, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        return import_module(name)
    finally:
        timer.cancel()
