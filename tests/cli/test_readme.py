"""The commands in README and docs/commands.md run and print the output shown there."""

import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE
from shell import robustlab

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"), re.S)
    for line in block.splitlines()
    if not line.startswith("#")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with what the commands refer to; they run in the order printed, later ones on files of earlier ones."""
    place = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "models", place / "models")
    shutil.copytree(ROOT / "recipes", place / "recipes")
    (place / "out").mkdir()
    return place


def _run(folder, *arguments):
    words = [sys.executable, *arguments]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)


# The naming from the record that comes along takes a minute, the second run of first-light 20 s; smaller ones run in
# test_cli_data_discover.py and test_cli_run.py.
MARKED = [pytest.param(c, marks=pytest.mark.slow) if "data discover" in c or "Kf=0.3" in c else c for c in COMMANDS]


@pytest.mark.parametrize("command", MARKED)
def test_command(folder, monkeypatch, command):
    monkeypatch.chdir(folder)
    words = command.split()
    assert words[0] == "robustlab"
    # The command marked with exit code 1 ends with an unmet requirement.
    assert robustlab(*words[1:], code=1 if "Kf=0.3" in command else 0).out.strip()


def test_python(folder):
    """Each comment states the printed value."""
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    done = _run(folder, "-c", code)
    assert done.returncode == 0, done.stderr
    printed = done.stdout.splitlines()
    shown = re.findall(r"print\(.*\)  # (.*)", code)
    assert [printed[0], printed[1], printed[3]] == [shown[0], shown[1], shown[3]]
    assert set(re.findall(r"'(\w+)':", printed[2])) == {"R", "Km", "Kf"}


def test_the_front_page_is_short():
    lines = README.splitlines()
    assert len(lines) <= 110
    assert max(map(len, lines)) <= 160
    assert len(README.split()) <= 900


def test_links_have_targets():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_demo_prints_what_the_readme_shows(folder):
    """Each line, its numbers but for the last digit: processors differ in it; the last one but for the time it took."""
    done = _run(folder, "-m", "robustlab.cli.main", "run", "first-light", "--out", "out/demo")
    assert done.returncode == 0, done.stderr
    (shown,) = re.findall(r"```text\n(.*?)```", README, re.S)
    printed = done.stdout.splitlines()
    for line in filter(None, shown.splitlines()):
        assert any(_same(line, one) or one.startswith(f"{line} in ") for one in printed), line


def _same(line: str, other: str) -> bool:
    """Whether two lines are the same but for numbers that differ by less than a thousandth."""
    number = r"\d+\.\d+"
    if " ".join(re.sub(number, "#", line).split()) != " ".join(re.sub(number, "#", other).split()):
        return False
    pairs = zip(re.findall(number, line), re.findall(number, other), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=1e-3) for a, b in pairs)
