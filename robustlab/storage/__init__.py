"""Storage: format 1 and plain files to models, records and results, and back.

`interchange` decides which object a file holds, `codecs` knows what reads and writes each kind; `matrices` has what
they share. `pairs` compares two models, `controller_export` writes controllers for other programs, `expression_files`
reads parametric models.
"""

from robustlab.storage.interchange import Loaded, load, load_pair, read, save

__all__ = ["Loaded", "load", "load_pair", "read", "save"]
