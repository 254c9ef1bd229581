"""The groups of commands, and their parsers, each loaded on use."""

from __future__ import annotations

from importlib import import_module
from typing import Any

# Command -> (module of its app, called `app` or as named; or modules of operations; one line of help).
GROUPS: dict[str, tuple[str | tuple[str, ...], str]] = {
    "plant": ("robustlab.cli.plant", "List plants, show one; start one of your own in a file."),
    "model": ("robustlab.cli.model", "Build, show, check, compare and convert models."),
    "uncertain": (("models", "members"), "Build, show and sample uncertain models."),
    "worst-case": (("members",), "Search the worst member of an uncertain model."),
    "violation-probability": (("members",), "How probable random members violate a limit."),
    "campaign": (("members",), "Run samples and searches of any size, resumable."),
    "mu": (("robustness",), "Robust stability margin with proved mu bounds."),
    "worst-gain": (("robustness",), "Proved worst-case gain of an uncertain model."),
    "performance-margin": (("robustness",), "Robust performance margin of a set."),
    "synth": (("designs",), "Design a controller and verify its loop."),
    "data": ("robustlab.cli.data", "Check and compare records; name what a model lacks."),
    "run": ("robustlab.cli.run:RUN", "Run a recipe: steps, requirements, report."),
    "recipe": ("robustlab.cli.run:RECIPE", "Check a recipe, list kinds of steps, start a new one."),
    "report": ("robustlab.cli.run:REPORT", "Write a finished run's report again; compare two runs."),
    "verify": ("robustlab.cli.run:VERIFY", "Have results proved once more, from their files alone."),
    "doctor": ("robustlab.cli.doctor", "Say whether this installation can work."),
}


def parser(name: str) -> Any:
    """Return typer's command or group that parses the words after ``robustlab NAME``."""
    from typer.main import get_command

    made, title = GROUPS[name]
    if isinstance(made, str):
        module, _, app_name = made.partition(":")
        app = getattr(import_module(module), app_name or "app")
    else:
        import typer

        from robustlab.cli.generated import add_commands

        app = typer.Typer(help=title, no_args_is_help=True, add_completion=False)
        add_commands(app, name, *made)
    app.rich_markup_mode = None  # plain text, as in the documentation
    return get_command(app)
