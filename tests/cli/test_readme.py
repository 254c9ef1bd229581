"""What the README tells a new user to type works, as printed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    line.split("#")[0].strip()
    for line in re.search(r"## The command line\n\n```sh\n(.*?)```", README, re.S).group(1).splitlines()
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with what the commands refer to; they run in the order printed, later ones on files of earlier ones."""
    place = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "models", place / "models")
    shutil.copytree(ROOT / "recipes", place / "recipes")
    return place


def _run(folder, *arguments):
    words = [sys.executable, *arguments]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)


# The naming from the README's own record takes a minute; smaller ones run in test_cli_data_discover.py.
MARKED = [pytest.param(c, marks=pytest.mark.slow) if "data discover" in c else c for c in COMMANDS]


@pytest.mark.parametrize("command", MARKED)
def test_command(folder, command):
    words = command.split()
    assert words[0] == "robustlab"
    done = _run(folder, "-m", "robustlab.cli.main", *words[1:])
    # The one that says so ends with a requirement that is not met.
    assert done.returncode == (1 if "Kf=0.3" in command else 0), done.stderr
    assert done.stdout.strip()


def test_python(folder):
    code = re.search(r"```python\n(.*?)```", README, re.S).group(1)
    done = _run(folder, "-c", code)
    assert done.returncode == 0, done.stderr
    design, worst, margin = done.stdout.splitlines()
    assert design.startswith("certified 0.588")
    assert worst.endswith("sampled: a lower bound of the true worst case")
    assert margin.endswith("certified")


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_demo_prints_what_the_readme_shows():
    """The requirements of the recipe are those of the README's table."""
    import tomllib

    recipe = tomllib.loads((ROOT / "recipes" / "first-light.toml").read_text(encoding="utf-8"))
    for requirement in recipe["require"]:
        assert requirement["text"] in README
