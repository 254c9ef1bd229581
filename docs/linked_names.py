"""``rl.name`` in a text becomes a link to its page of the reference; one that robustlab does not have is a warning."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.transforms import SphinxTransform
from sphinx.util.logging import getLogger

import robustlab as rl


class LinkedNames(SphinxTransform):
    """Wrap code that begins with a public name, ``rl.mu(M, blocks)`` say, into a reference to it."""

    default_priority = 700

    def apply(self, **_: Any) -> None:
        """Look at every piece of inline code of a page."""
        for node in list(self.document.findall(nodes.literal)):
            match = re.match(r"rl\.(\w+)", node.astext())
            if match is None or isinstance(node.parent, (nodes.reference, pending_xref)):
                continue
            name = match.group(1)
            if name not in rl.__all__:
                getLogger(__name__).warning("no public name: rl.%s", name, location=node)
                continue
            target = {"refdomain": "py", "reftype": "obj", "reftarget": f"robustlab.{name}", "refexplicit": True}
            link = pending_xref("", refdoc=self.env.docname, refwarn=False, **target)
            node.replace_self(link)
            link += node


def setup(app: Any) -> None:
    """Register the transform."""
    app.add_transform(LinkedNames)
