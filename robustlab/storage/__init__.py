"""Storage: format 1 and plain files to models, records and results, and back."""

from robustlab.storage.interchange import Loaded, load, load_pair, read, save
from robustlab.storage.model_pairs import check_pair

__all__ = ["Loaded", "check_pair", "load", "load_pair", "read", "save"]
