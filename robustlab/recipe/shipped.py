"""The recipes that ship with robustlab."""

from __future__ import annotations

from pathlib import Path

import robustlab


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
