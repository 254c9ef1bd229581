"""The files around a recipe: those it names and may read, the recipes that ship with robustlab, one to start from."""

from __future__ import annotations

import re
from pathlib import Path

import robustlab
from robustlab.errors import EnvironmentFault, InputError, UsageError, did_you_mean
from robustlab.files.atomic import atomic_write
from robustlab.recipe.load import LoadedRecipe
from robustlab.recipe.steps.contract import Step
from robustlab.recipe.steps.models import LoadStep, PlantStep
from robustlab.recipe.steps.records import RecordStep

__all__ = ["STARTER", "find_files", "recipe_path", "shipped_recipes", "write_starter"]


def find_files(loaded: LoadedRecipe) -> dict[str, Path]:
    """Step name -> the file it reads, for every step that reads one; asked for before anything runs.

    A path is looked for beside the recipe, in the folder above it, and in the working directory; one given with
    ``--set`` in the working directory first. Models, and plants in a file of Python, must lie in the recipe's folder or
    the folder above it, unless ``--set`` says otherwise.

    Raises
    ------
    InputError
        A file that is not there (with the places looked at), is no regular file, or lies where a recipe may not reach.
    """
    found: dict[str, Path] = {}
    for name, step in loaded.recipe.step.items():
        key, given = _named_file(step)
        if given is None:
            continue
        typed = any(k.removeprefix("step.") == f"{name}.{key}" for k in loaded.overrides)
        about = step.about if isinstance(step, RecordStep) else ""
        path = _find(f"{loaded.path.name}: step.{name}.{key}", given, loaded.path.parent, typed, about)
        if not isinstance(step, RecordStep) and not typed:
            _check_inside(loaded.path, f"step.{name}.{key}", given, path)
        found[name] = path
    return found


def _named_file(step: Step) -> tuple[str, str | None]:
    """Key of the step that names a file, and the file; None without one."""
    if isinstance(step, PlantStep):
        from robustlab.dynamics.plant_file import plant_reference

        parts = plant_reference(step.plant)
        return "plant", parts and parts[0]
    return "path", step.path if isinstance(step, (LoadStep, RecordStep)) else None


def _find(where: str, given: str, folder: Path, typed: bool, about: str) -> Path:
    if "\0" in given:
        raise InputError(where, "a path with a NUL character", "a path")
    places = [folder, folder.parent, Path.cwd()]
    if typed:
        places = [places[2], places[0], places[1]]
    candidates = list(
        dict.fromkeys((place / given).resolve() for place in places)
    )  # an absolute path gives one candidate
    try:
        for path in candidates:
            if path.is_file():
                return path
            if path.exists():
                raise InputError(where, f"{path} is not a regular file", "a file")
    except OSError as error:  # a name too long, a folder that may not be read
        raise InputError(where, f"{given}: {error.strerror}", "a file") from None
    siblings = sorted({p.name for c in candidates if c.parent.is_dir() for p in c.parent.iterdir()})
    step = where.rpartition("step.")[2]
    hint = " or ".join(
        filter(None, (did_you_mean(Path(given).name, siblings), f"point to a copy with --set {step}=FILE"))
    )
    looked = ", ".join(str(path.parent) for path in candidates)
    raise InputError(where, f"{given}: no such file (looked in {looked})", None, hint, tuple(about.splitlines()))


def _check_inside(recipe: Path, key: str, given: str, path: Path) -> None:
    folder = recipe.parent
    roots = [folder, folder.parent] if folder.parent.parent != folder.parent else [folder]  # never the whole disk
    if any(path.is_relative_to(root) for root in roots):
        return
    raise InputError(
        recipe.name,
        f'{key} = "{given}" leaves the recipe folder',
        f"a file in {' or '.join(map(str, roots))}",
        f"to read it all the same, type --set {key.removeprefix('step.')}={given}",
    )


def _shipped_folder() -> Path:
    """Beside the package in a checkout, inside it when installed from a wheel."""
    package = Path(robustlab.__file__).parent
    installed = package / "shipped" / "recipes"
    return installed if installed.is_dir() else package.parent / "recipes"


def shipped_recipes() -> list[str]:
    """Names of the recipes that come with robustlab."""
    return sorted(path.stem for path in _shipped_folder().glob("*.toml"))


def recipe_path(given: str) -> Path:
    """The file that ``robustlab run`` means by ``given``: a path, or the name of a shipped recipe.

    Raises
    ------
    InputError
        Neither a file nor a shipped name.
    """
    path = Path(given)
    if path.is_file() or path.suffix or len(path.parts) > 1:
        return path  # a path: `load_recipe` says what is wrong with it
    if given in shipped_recipes():
        return _shipped_folder() / f"{given}.toml"
    names = shipped_recipes()
    hint = did_you_mean(given, names) or "robustlab recipe new NAME starts a recipe of your own"
    raise InputError(
        given, "neither a file nor a recipe that comes with robustlab", f"a path, or one of {', '.join(names)}", hint
    )


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


def write_starter(name: str) -> Path:
    """Write ``NAME.toml`` in the working directory.

    Raises
    ------
    UsageError
        A name that a recipe cannot have.
    EnvironmentFault
        The file exists already.
    """
    stem = name.removesuffix(".toml")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,59}", stem):
        raise UsageError(f"recipe new {name}", "not a name", "letters, digits, - and _, with a letter first")
    path = Path(f"{stem}.toml")
    if path.exists():
        raise EnvironmentFault(str(path), "exists already", "a new name")
    atomic_write(path, lambda temporary: temporary.write_text(STARTER.format(name=stem), encoding="utf-8"))
    return path
