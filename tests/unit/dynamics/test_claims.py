"""Simulated records are called simulated in the recipes."""

import tomllib
from pathlib import Path

import h5py
import pytest

ROOT = Path(__file__).parents[3]
RECIPES = sorted((ROOT / "recipes").glob("*.toml"))


def head_of(path):
    """Return the first line or title of a data file."""
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            return file.attrs["title"]
    return path.read_text(encoding="utf-8")[:20]


@pytest.mark.parametrize("path", RECIPES, ids=lambda p: p.stem)
def test_simulated_records_are_called_simulated(path):
    recipe = tomllib.loads(path.read_text(encoding="utf-8"))
    for name, step in recipe["step"].items():
        if step["do"] == "record" and step["path"].startswith("data/"):
            head = head_of(ROOT / "recipes" / step["path"])
            assert step.get("simulated", False) is ("SIMULATED" in head), name
            assert "Simulated, not measured" in step["about"]
        elif step["do"] == "record":
            assert "simulated" not in step, name
