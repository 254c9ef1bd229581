"""``robustlab worst-case``: search the worst member of an uncertain model, or judge how probable a violation is."""

from __future__ import annotations

import typer

from robustlab.cli.generated import add_commands

app = typer.Typer(help="Search the worst member of an uncertain model.", add_completion=False)
add_commands(app, "worst-case", "members")
