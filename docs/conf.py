"""The site: ``make docs`` builds it into out/docs, every warning an error, every tutorial executed."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

import linked_names  # noqa: E402
import mathml  # noqa: E402
import reference_pages  # noqa: E402

# Tutorials type commands: the ones of this installation. One BLAS thread, as the command line sets it.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"  # the kernel's debugger warns about frozen modules otherwise

# Kernels get a profile of their own, so that the one of who builds the site changes nothing.
os.environ["IPYTHONDIR"] = tempfile.mkdtemp(prefix="robustlab-docs-")
_profile = Path(os.environ["IPYTHONDIR"], "profile_default", "ipython_kernel_config.py")
_profile.parent.mkdir()
_profile.write_text(
    """\
c.IPKernelApp.log_level = "ERROR"
c.IPKernelApp.matplotlib = "inline"
c.InlineBackend.figure_formats = {"svg"}
c.HistoryManager.enabled = False
"""
)

project = "robustlab"
author = "The robustlab authors"
html_title = "robustlab"

extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc"]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

html_theme = "furo"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"top_of_page_buttons": []}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
html_use_index = False  # the search is better, and an index of long names does not fit a telephone

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

# Pages with a kernel in their header are notebooks and run, each in an empty folder; a cell that fails ends the build.
# All other pages are plain Markdown: what they print is checked by the tests of the repository.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 240
nb_execution_show_tb = True
nb_merge_streams = True


default_role = "py:obj"
autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Mask", "NDArray")}  # not what they stand for
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True  # tunings are shown by their name
python_maximum_signature_line_length = 80
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False


def plain_aliases(_app: object, _what: str, _name: str, _obj: object, _options: object, *texts: str | None) -> Any:
    """Signatures with aliases by their names: what autodoc leaves of them in a union is its own way to hold them."""
    return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in texts)


def setup(app: Any) -> None:
    """Write the reference pages from the code before the sources are read."""
    app.connect("builder-inited", lambda _: reference_pages.write(DOCS / "reference"))
    app.connect("autodoc-process-signature", plain_aliases)
    linked_names.setup(app)
    mathml.setup(app)
