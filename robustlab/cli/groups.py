"""The groups of commands, and the parser of one: loaded when its own words are asked for, and not before."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from robustlab.cli.vocabulary import told

# Command -> (module that holds its `app`, one line of help).
GROUPS = {
    "plant": ("robustlab.cli.plant", "List plants, show one; start one of your own in a file."),
    "model": ("robustlab.cli.model", "Build, show, check, compare and convert models."),
    "uncertain": ("robustlab.cli.uncertain", "Build, show and sample uncertain models."),
    "worst-case": ("robustlab.cli.worst_case", "Search the worst member of an uncertain model."),
    "campaign": ("robustlab.cli.campaign", "Run samples and searches of any size, resumable."),
    "mu": ("robustlab.cli.mu", "Robust stability margin with proved mu bounds."),
    "synth": ("robustlab.cli.synth", "Design a controller and verify its loop."),
    "data": ("robustlab.cli.data", "Check and compare records; name what a model lacks."),
    "run": ("robustlab.cli.run", "Run a recipe: steps, requirements, report."),
    "recipe": ("robustlab.cli.recipe", "Check a recipe, list the kinds of steps, start a new one."),
    "report": ("robustlab.cli.report", "Write the report of a finished run again; compare two runs."),
    "verify": ("robustlab.cli.verify", "Have results proved once more, from their files alone."),
    "doctor": ("robustlab.cli.doctor", "Say whether this installation can work."),
}


# What was typed behind ``robustlab``, for commands that answer with the same command and more; set in `main`.
TYPED: list[str] = []


def parser(name: str) -> Any:
    """What reads the words after ``robustlab NAME``: typer's command, or its group of them."""
    from typer.main import get_command

    app = import_module(GROUPS[name][0]).app
    app.rich_markup_mode = None  # help as plain text: it is also what the documentation shows
    return told(get_command(app))
