"""``robustlab iqc``: proved gain with nonlinear, time-varying and uncertain blocks."""

from __future__ import annotations

import typer

from robustlab.cli.generated import add_commands

app = typer.Typer(
    help="Proved gain with nonlinear and time-varying blocks.", no_args_is_help=True, add_completion=False
)
add_commands(app, "iqc", "robustness")
