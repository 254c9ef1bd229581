"""Where a run writes when nobody says where: a folder for each recipe and each choice of settings, and ``latest``."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from robustlab.errors import InputError
from robustlab.recipe.load import LoadedRecipe
from robustlab.recipe.run import read_result, recipe_origin

LATEST = "latest"
LONGEST_SLUG = 40  # characters; longer settings are told by their hash


def default_folder(loaded: LoadedRecipe, root: str | Path = "out") -> Path:
    """The folder of this recipe with these settings below ``root``.

    ``NAME`` where it is free or holds an earlier run of the same recipe file with the same settings; else ``NAME`` and
    the settings, as in ``first-light-seed-7``; else ``NAME`` and a hash. So no other recipe's and no other setting's
    report is overwritten, and the same command comes back to the same folder.
    """
    name, root = loaded.recipe.name, Path(root)
    changes = sorted(loaded.overrides.items())
    mark = hashlib.sha256(repr((recipe_origin(loaded), changes)).encode()).hexdigest()[:8]
    slug = "-".join(re.sub(r"[^A-Za-z0-9.]+", "-", f"{key}-{value}").strip("-.") for key, value in changes)
    names = [name]
    if slug and len(slug) <= LONGEST_SLUG:
        names.append(f"{name}-{slug}")
    for candidate in names:
        folder = root / candidate
        earlier = _earlier(folder)
        if not folder.is_symlink() and (earlier is None or _same(earlier, loaded)):
            return folder
    return root / f"{name}-{mark}"


def replaced(folder: Path, loaded: LoadedRecipe) -> str:
    """What a run into ``folder`` replaces, in words; empty where nothing, or the same recipe with the same settings."""
    earlier = _earlier(folder)
    if not earlier:
        return ""
    recipe = earlier["recipe"]
    if _same(earlier, loaded) and recipe["sha256"] == hashlib.sha256(loaded.text.encode()).hexdigest():
        return ""
    settings = ", ".join(f"{key}={value}" for key, value in recipe["overrides"].items()) or "no changed settings"
    what = "an earlier text of the recipe" if _same(earlier, loaded) else f"recipe {recipe['name']} with {settings}"
    return f"{folder} held the report of {what}; this run replaced it"


def point_latest(folder: Path) -> None:
    """Make the link ``latest`` beside ``folder`` point to it; a file or folder of that name, or a system without
    links, is left as it is.
    """
    link = folder.parent / LATEST
    if folder.name == LATEST or (link.exists() and not link.is_symlink()):
        return
    fresh = folder.parent / f".{LATEST}-{os.getpid()}"
    with suppress(OSError, NotImplementedError):  # a convenience: the run itself is written
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(folder.name, target_is_directory=True)
        fresh.replace(link)


def _earlier(folder: Path) -> Mapping[str, Any] | None:
    """The result that lies there; None without one; an empty table where it is not readable, and so somebody else's."""
    if not (folder / "result.json").exists():
        return None
    try:
        return read_result(folder)
    except InputError:
        return {}


def _same(earlier: Mapping[str, Any], loaded: LoadedRecipe) -> bool:
    recipe = earlier.get("recipe", {})
    origin = recipe.get("origin", "")
    return recipe.get("overrides") == loaded.overrides and origin in ("", recipe_origin(loaded))
