"""The recipes that come with robustlab: beside the package in a checkout, inside it when installed from a wheel."""

from __future__ import annotations

from pathlib import Path

import robustlab
from robustlab.errors import InputError, did_you_mean

__all__ = ["recipe_path", "shipped_recipes"]


def _folder() -> Path:
    package = Path(robustlab.__file__).parent
    installed = package / "shipped" / "recipes"
    return installed if installed.is_dir() else package.parent / "recipes"


def shipped_recipes() -> list[str]:
    """Names of the recipes that come with robustlab."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


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
        return _folder() / f"{given}.toml"
    names = shipped_recipes()
    hint = did_you_mean(given, names) or "robustlab recipe new NAME starts a recipe of your own"
    raise InputError(
        given, "neither a file nor a recipe that comes with robustlab", f"a path, or one of {', '.join(names)}", hint
    )
