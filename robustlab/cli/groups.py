"""The groups of commands, and their parsers, each loaded on use."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

# Command -> (module:app of commands written by hand, and the modules of operations with its commands; a line of help).
GROUPS: dict[str, tuple[str, str]] = {
    "plant": ("plant:PLANT", "List plants, show one; start one of your own in a file."),
    "model": ("plant:MODEL designs models robustness", "Build, show, check, compare and convert models."),
    "uncertain": ("models members", "Build, show and sample uncertain models."),
    "worst-case": ("members", "Search the worst member of an uncertain model."),
    "violation-probability": ("members", "How probable random members violate a limit."),
    "campaign": ("members", "Run samples and searches of any size, resumable."),
    "mu": ("robustness", "Robust stability margin with proved mu bounds."),
    "worst-gain": ("robustness", "Proved worst-case gain of an uncertain model."),
    "performance-margin": ("robustness", "Robust performance margin of a set."),
    "synth": ("designs", "Design a controller and verify its loop."),
    "data": ("data:app", "Check and compare records; name what a model lacks."),
    "run": ("run:RUN", "Run a recipe: steps, requirements, report."),
    "recipe": ("run:RECIPE", "Check a recipe, list kinds of steps, start a new one."),
    "report": ("run:REPORT", "Write a finished run's report again; compare two runs."),
    "verify": ("run:VERIFY", "Have results proved once more, from their files alone."),
    "doctor": ("doctor:app", "Say whether this installation can work."),
}


@cache
def parser(name: str) -> Any:
    """Return typer's command or group that parses the words after ``robustlab NAME``."""
    import typer
    from typer.main import get_command

    made, title = GROUPS[name]
    app, families = typer.Typer(help=title, no_args_is_help=True, add_completion=False), made.split()
    if ":" in made:
        module, _, app_name = families.pop(0).partition(":")
        app = getattr(import_module(f"robustlab.cli.{module}"), app_name)
    if families:
        from robustlab.cli.generated import add_commands

        add_commands(app, name, *families)
    app.rich_markup_mode = None  # plain text, as in the documentation
    return get_command(app)
