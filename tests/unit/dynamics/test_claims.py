"""What the shipped texts claim: whose tolerances they are, and what is simulated and not measured."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

import h5py
import pytest

ROOT = Path(__file__).parents[3]
TEXTS = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "recipes/*.toml", "recipes/data/*.py", "robustlab/**/*.py", "benchmarks/*.py")
    for path in ROOT.glob(pattern)
    if path.name != "CHANGELOG.md"  # it tells what was false once
)
RECIPES = sorted((ROOT / "recipes").glob("*.toml"))

# The thesis prints tolerances of Kf and of masses and inertias alone: these words are said of no others.
FALSE_TOLERANCES = (
    r"printed tolerances",
    r"tolerances? of (the )?(chapter|section) 10",
    r"chapter 10's tolerances",
    r"tolerances? of the thesis",
    r"No tolerance that the thesis prints",
    r"motor (parameters )?(as in|of) section 10\.1\b",
)
# No machine of ours was ever moved by a controller: what a recipe simulates is called so.
FALSE_MACHINES = (r"machine itself", r"[Tt]rue machine keeps", r"on the machine as it is", r"same way on a real")


@cache
def plain(path: Path) -> str:
    return " ".join(path.read_text(encoding="utf-8").split())


@pytest.mark.parametrize("claim", [*FALSE_TOLERANCES, *FALSE_MACHINES])
def test_no_text_makes_a_false_claim(claim):
    assert [str(path.relative_to(ROOT)) for path in TEXTS if re.search(claim, plain(path))] == []


def test_tolerances_that_are_ours_are_called_so():
    """Of R, L, Km, Kb and J wherever a recipe or a page states all of them for the thesis' motor."""
    stated = re.compile(r"\bR = 0\.10|\bR = \[2\.07, 0\.10\]|Km=\(0\.052, 0\.05\), Kb=")
    shipped = [path for path in TEXTS if path.suffix in (".toml", ".md") or path.parent.name == "data"]
    found = [path for path in shipped if stated.search(plain(path))]
    assert {path.name for path in found} >= {"chapter-11.toml", "flagship.toml"}
    for path in found:
        assert re.search(r"assum", plain(path)), path.name


def head_of(path):
    """What a file of data begins with: its first line, or its title."""
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
