"""docs/tutorials, the pages of the plants: every block runs, in its order, and prints what the page shows."""

from __future__ import annotations

import itertools
import re
import shlex
import shutil
from pathlib import Path

import pytest

from robustlab.cli.ending import main_guard
from robustlab.cli.main import run

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "tutorials"
# Tutorials whose header names a kernel are executed where the site is built.
PAGES = sorted(page.stem for page in FOLDER.glob("*.md") if not page.read_text(encoding="utf-8").startswith("---"))


def squeezed(text):
    return " ".join(text.split())


def test_there_is_a_page_for_each_plant_and_the_readme_names_all():
    assert sorted(path.stem.replace("_", "-") for path in (ROOT / "models" / "plants").glob("*.py")) == PAGES
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"(docs/tutorials/{page}.md)" in readme for page in PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_the_page_runs_in_order_and_prints_what_it_shows(page, tmp_path, monkeypatch, capsys):
    """What code prints is shown whole, in the block after it; of a command, lines of what it prints."""
    shutil.copytree(ROOT / "models" / "plants", tmp_path / "models" / "plants")
    monkeypatch.chdir(tmp_path)
    text = (FOLDER / f"{page}.md").read_text(encoding="utf-8")
    blocks = [*re.findall(r"```(\w+)\n(.*?)```", text, flags=re.DOTALL), ("", "")]
    assert len(blocks) > 6
    names = {}
    for (kind, block), (following, shown) in itertools.pairwise(blocks):
        shown = shown if following == "text" else ""
        if kind == "python":
            exec(block, names)
            assert capsys.readouterr().out == shown
        elif kind == "sh":
            printed = ""
            for command in block.splitlines():
                program, *words = shlex.split(command)
                assert program == "robustlab"
                code = main_guard(lambda words=words: run(words))
                out, err = capsys.readouterr()
                assert code == 0, (command, err)
                printed += squeezed(out) + " "
            assert all(squeezed(line) in printed for line in shown.splitlines()), printed
        else:
            assert kind == "text"


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", (FOLDER / f"{page}.md").read_text(encoding="utf-8")):
        assert (FOLDER / target).exists(), target
