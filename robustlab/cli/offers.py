"""What the shell is offered for a parameter at TAB; where that is nothing, the shell offers files.

A TAB must not wait for numerical libraries, so nothing of them is imported here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

Offer = Callable[[str], list[str]]

# Words of choices whose modules load numpy; a test holds them to those modules.
PLANTS = {  # with a line on each
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
    """The words of a choice."""

    def offered(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return offered


def plant_or_file(incomplete: str) -> list[str]:
    """Names of the plants that come with robustlab, and files that hold a plant or a model."""
    return _names_and_files(PLANTS, _PLANT_FILES, incomplete)


def recipe_or_file(incomplete: str) -> list[str]:
    """Names of the recipes that come with robustlab, and recipes in files."""
    from robustlab.recipe.shipped import shipped_recipes

    return _names_and_files(shipped_recipes(), (".toml",), incomplete)


def listed(offered: Iterable[str]) -> list[tuple[str, str]]:
    """What stands for a missing argument, each with a line on it where it comes with robustlab."""
    from robustlab.recipe.shipped import shipped_titles

    names = list(offered)
    lines = {**PLANTS, **(shipped_titles() if not PLANTS.keys() & set(names) else {})}
    return [(name, lines.get(name, "")) for name in names]


def _names_and_files(names: Iterable[str], suffixes: tuple[str, ...], incomplete: str) -> list[str]:
    """Where no name begins so, nothing: the shell itself is better at files."""
    found = [name for name in names if name.startswith(incomplete)]
    if not found:
        return []
    here = (path.name + "/" * path.is_dir() for path in Path().iterdir() if not path.name.startswith("."))
    files = (name for name in here if name.startswith(incomplete) and name.endswith((*suffixes, "/")))
    return found + sorted(name for name in files if re.fullmatch(r"[\w.,+@%/-]+", name))  # bash would not quote more
