"""Where the files that a recipe names are looked for, and which it may read."""

from __future__ import annotations

from pathlib import Path

from robustlab.errors import InputError, did_you_mean
from robustlab.recipe.load import LoadedRecipe
from robustlab.recipe.schema import LoadStep, RecordStep

__all__ = ["find_files"]


def find_files(loaded: LoadedRecipe) -> dict[str, Path]:
    """Step name -> the file it reads, for every step that reads one; asked for before anything runs.

    A path is looked for beside the recipe, in the folder above it, and in the working directory; one given with
    ``--set`` in the working directory first. Models must lie in the recipe's folder or the folder above it, unless
    ``--set`` says otherwise.

    Raises
    ------
    InputError
        A file that is not there (with the places looked at), is no regular file, or lies where a recipe may not reach.
    """
    found: dict[str, Path] = {}
    for name, step in loaded.recipe.step.items():
        if isinstance(step, (LoadStep, RecordStep)) and step.path is not None:
            typed = any(key.removeprefix("step.") == f"{name}.path" for key in loaded.overrides)
            about = step.about if isinstance(step, RecordStep) else ""
            path = _find(f"{loaded.path.name}: step.{name}.path", step.path, loaded.path.parent, typed, about)
            if isinstance(step, LoadStep) and not typed:
                _check_inside(loaded.path, f"step.{name}.path", step.path, path)
            found[name] = path
    return found


def _find(where: str, given: str, folder: Path, typed: bool, about: str) -> Path:
    if "\0" in given:
        raise InputError(where, "a path with a NUL character", "a path")
    places = [folder, folder.parent, Path.cwd()]
    if typed:
        places = [places[2], places[0], places[1]]
    candidates = list(
        dict.fromkeys((place / given).resolve() for place in places)
    )  # an absolute path gives one candidate
    for path in candidates:
        if path.is_file():
            return path
        if path.exists():
            raise InputError(where, f"{path} is not a regular file", "a file")
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
