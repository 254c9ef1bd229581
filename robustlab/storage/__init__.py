"""Storage: format 1 and plain files to models, records and results, and back."""

from __future__ import annotations

from robustlab.storage.interchange import Loaded, check_pair, load, load_pair, read, save

__all__ = ["Loaded", "check_pair", "load", "load_pair", "read", "save"]
