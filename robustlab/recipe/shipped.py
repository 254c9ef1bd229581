"""The recipes that ship with robustlab, and one to start from."""

from __future__ import annotations

import os
import re
from pathlib import Path

import robustlab
from robustlab.errors import EnvironmentFault, UsageError

STARTER = """\
# A robustlab recipe: steps, run in the order written, and requirements that decide the exit code.
#   check it:  robustlab recipe check {name}.toml
#   run it:    robustlab run {name}.toml
#   change a value without editing:  robustlab run {name}.toml --set uncertain.tolerances.Kf=0.2
schema = "robustlab.recipe/1"
name = "{name}"
title = "A DC motor with uncertain friction"
description = "Does the no-load speed stay within what the data sheet says?"
seed = 0 # of all random numbers: same seed, same answer

# Each step has a name of your choice and does one thing (`robustlab recipe schema` lists all kinds and their keys).
[step.motor]
do = "plant"
plant = "dc-motor"
# parameters = {{ R = 2.1, J = [7.2e-6, 0.1] }}   # SI units; [value, relative tolerance]

# Steps refer to earlier ones by name.
[step.uncertain]
do = "uncertain"
of = "motor"
tolerances = {{ Kf = 0.35 }} # viscous friction +-35 %
outputs = ["omega"]

[step.speed]
do = "sample"
of = "uncertain"
n = 20
vertices = 2
input = {{ u = 42.0 }} # V, applied at t = 0
t_end = 0.05 # s
reference = [{{ output = "omega", value = 788.5, text = "data sheet" }}]

# A requirement names a number of a step and a condition: at_least, at_most, within = [low, high], equals (tolerance).
[[require]]
text = "The set of models covers the data sheet's no-load speed of 788.5 rad/s"
that = "speed.outputs.omega.final.upper"
at_least = 788.5
"""


def shipped_folder() -> Path:
    """Return the folder: next to the package in a checkout, inside it when installed from a wheel."""
    package = Path(robustlab.__file__).parent
    installed = package / "shipped" / "recipes"
    return installed if installed.is_dir() else package.parent / "recipes"


def shipped_recipes() -> list[str]:
    """Return the names of the shipped recipes."""
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def shipped_titles() -> dict[str, str]:
    """Return name -> title of the shipped recipes."""
    import tomllib

    files = {name: shipped_folder() / f"{name}.toml" for name in shipped_recipes()}
    return {name: str(tomllib.loads(file.read_text(encoding="utf-8")).get("title", "")) for name, file in files.items()}


def write_starter(name: str, force: bool = False) -> Path:
    """Write ``NAME.toml`` in the working directory, or in the folder before the name."""
    folder, stem = os.path.split(name.removesuffix(".toml"))  # a slash at the end is no name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,59}", stem):
        raise UsageError(f"recipe new {name}", "not a name", "letters, digits, - and _, with a letter first")
    path = Path(folder, f"{stem}.toml")
    if path.exists() and not force:
        raise EnvironmentFault(str(path), "exists already", "a new name, or --force to write over it")
    from robustlab.files.atomic import atomic_write

    content = STARTER.format(name=path.stem)
    atomic_write(path, lambda temporary: temporary.write_text(content, encoding="utf-8"))
    return path
