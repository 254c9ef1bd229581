"""The files around a recipe: those it names and may read, and the recipe itself."""

from __future__ import annotations

from pathlib import Path

from robustlab.errors import InputError, did_you_mean
from robustlab.recipe.load import LoadedRecipe
from robustlab.recipe.shipped import shipped_folder, shipped_recipes
from robustlab.recipe.steps.contract import Step
from robustlab.recipe.steps.models import LoadStep, PlantStep
from robustlab.recipe.steps.records import FrequencyResponseStep, RecordStep

__all__ = ["find_files", "recipe_path"]


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
        is_measured = isinstance(step, (RecordStep, FrequencyResponseStep))
        about = step.about if is_measured else ""
        path = _find(f"{loaded.path.name}: step.{name}.{key}", given, loaded.path.parent, typed, about)
        if not is_measured and not typed:
            _check_inside(loaded.path, f"step.{name}.{key}", given, path)
        found[name] = path
    return found


def _named_file(step: Step) -> tuple[str, str | None]:
    """Key of the step that names a file, and the file; None without one."""
    if isinstance(step, PlantStep):
        from robustlab.dynamics.plant_file import plant_reference, unit_reference

        if unit_reference(step.plant):
            return "plant", step.plant
        parts = plant_reference(step.plant)
        return "plant", parts and parts[0]
    return "path", step.path if isinstance(step, (LoadStep, RecordStep, FrequencyResponseStep)) else None


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
        return shipped_folder() / f"{given}.toml"
    names = shipped_recipes()
    hint = did_you_mean(given, names) or "robustlab recipe new NAME starts a recipe of your own"
    raise InputError(
        given, "neither a file nor a recipe that comes with robustlab", f"a path, or one of {', '.join(names)}", hint
    )
