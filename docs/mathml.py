"""Equations as MathML, made when the site is built: no script, nothing from elsewhere, readable for screen readers."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.logging import getLogger

# TeX takes one sign for an argument without braces; the converter takes the whole number, and 12 over what follows.
UNBRACED = re.compile(r"(\\[dt]?frac)\s*([0-9a-zA-Z])\s*([0-9a-zA-Z]|\\[a-zA-Z]+)")


def _mathml(node: Any, display: bool) -> str:
    try:
        return tex2mathml(UNBRACED.sub(r"\1{\2}{\3}", node.astext()), as_block=display)
    except MathError as error:  # a warning ends a build with -W, and this one says where
        getLogger(__name__).warning("%s in: %s", error, node.astext(), location=node)
        return ""


def inline(self: Any, node: nodes.math) -> None:
    """``$...$`` within a line."""
    self.body.append(_mathml(node, display=False))
    raise nodes.SkipNode


def display(self: Any, node: nodes.math_block) -> None:
    """``$$...$$`` on lines of its own; a wide one scrolls by itself."""
    label = f' id="{node["ids"][0]}"' if node["ids"] else ""
    self.body.append(f'<div class="equation"{label}>{_mathml(node, display=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Register the renderer; ``html_math_renderer = "mathml"`` chooses it."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
