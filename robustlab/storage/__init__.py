"""Storage: format 1 and plain files to models, records and results, and back.

`interchange` decides which object a file holds; `matrices`, `models` and `plants` know some kinds each.
`controller_export` writes controllers for other programs; `expression_files` reads parametric models.
"""

from robustlab.storage.interchange import Loaded, load, load_pair, read, save
from robustlab.storage.models import check_pair

__all__ = ["Loaded", "check_pair", "load", "load_pair", "read", "save"]
