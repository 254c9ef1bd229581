"""Completions of words at TAB, with typer's protocol and scripts; where there are none, the shell offers files.

The shell's script calls robustlab with the words so far in environment variables; only the group named there is loaded,
and no numerical library, so that TAB is fast.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from robustlab.cli.console import answer

Offer = Callable[[str], list[str]]

# Plants whose modules load numpy, with a line on each; a test compares the names with those modules.
PLANTS = {
    "dc-motor": "permanent-magnet DC motor of a published data sheet, linear",
    "brushless-motor": "brushless DC motor from data-sheet values, with its drive, linear",
    "servo-axis": "prismatic axis of the published EMPS benchmark, linear",
    "mass-spring-damper": "chain of masses, springs and dampers, as many as are given, linear",
    "two-mass": "motor and load on a flexible shaft, linear",
    "linear-actuator": "DC motor with a belt that drives a cart, linear",
    "stewart-platform": "platform on six legs, nonlinear; presets thesis and physical, with motors or without",
}
_PLANT_FILES = (".h5", ".mat", ".py", ".fmu")


def one_of(*words: str) -> Offer:

    def offered(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return offered


def plant_or_file(incomplete: str) -> list[str]:
    return _names_and_files(PLANTS, _PLANT_FILES, incomplete)


def recipe_or_file(incomplete: str) -> list[str]:
    from robustlab.recipe.builtin_recipes import shipped_recipes

    return _names_and_files(shipped_recipes(), (".toml",), incomplete)


def _names_and_files(names: Iterable[str], suffixes: tuple[str, ...], incomplete: str) -> list[str]:
    """Return names and files; nothing where no name matches, so that the shell completes files."""
    found = [name for name in names if name.startswith(incomplete)]
    if not found:
        return []
    here = (path.name + "/" * path.is_dir() for path in Path().iterdir() if not path.name.startswith("."))
    files = (name for name in here if name.startswith(incomplete) and name.endswith((*suffixes, "/")))
    return found + sorted(name for name in files if re.fullmatch(r"[\w.,+@%/-]+", name))  # bash would not quote more


def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Declare the options of the top level for completion; `main` reads them."""


def run_top(groups: Mapping[str, tuple[str, str]], parser: Callable[[str], Any], *words: str) -> int:
    """Print the completions of the word at the cursor, or run ``--install-completion`` or ``--show-completion``."""

    class Commands(TyperGroup):
        """The table of groups for typer; a group's parser is made when its words are completed."""

        def list_commands(self, ctx: Any) -> list[str]:
            return list(groups)

        def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
            return TyperCommand(cmd_name, short_help=groups[cmd_name][1]) if cmd_name in groups else None

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            name, *rest = args
            return (name, parser(name), rest) if name in groups else super().resolve_command(ctx, args)

    top = typer.Typer(cls=Commands)
    top.callback()(_options)
    return answer(lambda: get_command(top).main([*words], prog_name="robustlab"))
