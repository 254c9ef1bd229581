"""``robustlab synth``: controllers from files, by every method; what makes them smaller or digital."""

from __future__ import annotations

import typer

from robustlab.cli.generated import add_commands

app = typer.Typer(
    help="Design a controller and verify it in the loop rebuilt from it.", no_args_is_help=True, add_completion=False
)
add_commands(app, "synth", "designs", "digital")
