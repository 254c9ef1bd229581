"""``robustlab effects``: what a model may lack, as `robustlab data discover` looks for it."""

from __future__ import annotations

import typer

from robustlab.cli.console import emit
from robustlab.cli.options import JsonOption
from robustlab.shown import text_table as table

app = typer.Typer(help="List the effects that a model may lack.", no_args_is_help=True, add_completion=False)


@app.callback()
def _group() -> None:
    """A group, though it has one command."""


@app.command("list")
def list_effects(as_json: JsonOption = False) -> None:
    """List the effects of the catalogue: their ids, where they sit, what they are.

    Example: robustlab effects list
    """
    from robustlab.dynamics.effects.catalogue import catalogue

    known = catalogue()
    rows = [(name, e.site_kind, e.title) for name, e in known.items()]
    effects = [
        {"id": name, "title": e.title, "site": e.site_kind, "equation": e.equation, "refines": e.refines}
        for name, e in known.items()
    ]
    emit("effects list", {"effects": effects}, table(rows, ("effect", "sits at", "what it is")), as_json)
