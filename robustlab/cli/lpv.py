"""``robustlab lpv``: models that depend on measured parameters, their induced gain, scheduled controllers."""

from __future__ import annotations

import typer

from robustlab.cli.generated import add_commands

app = typer.Typer(
    help="Gain scheduling: LPV models, their induced gain, scheduled controllers.", no_args_is_help=True,
    add_completion=False,
)  # fmt: skip
add_commands(app, "lpv", "scheduling")
