"""The recipes that ship with robustlab, and one to start from."""

from __future__ import annotations

import os
import re
from pathlib import Path

import robustlab
from robustlab.errors import EnvironmentFault, UsageError

STARTER = Path(__file__).with_name("starter.toml")  # NAME: the recipe's name


def shipped_folder() -> Path:
    """Return the folder: next to the package in a checkout, inside it when installed from a wheel."""
    package = Path(robustlab.__file__).parent
    installed = package / "shipped" / "recipes"
    return installed if installed.is_dir() else package.parent / "recipes"


def shipped_recipes() -> list[str]:
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def shipped_titles() -> dict[str, str]:
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

    content = STARTER.read_text(encoding="utf-8").replace("NAME", path.stem)
    atomic_write(path, lambda temporary: temporary.write_text(content, encoding="utf-8"))
    return path
