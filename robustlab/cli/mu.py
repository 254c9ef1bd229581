"""``robustlab mu``: stability margin, robust performance and worst-case gain of an uncertain model."""

from __future__ import annotations

import typer

from robustlab.cli.generated import add_commands

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None, add_completion=False)
add_commands(app, "mu", "robustness")
