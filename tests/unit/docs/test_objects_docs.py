"""docs/objects.md: the code runs, what is printed beside it is right, and the table of drawings is that of the code."""

from __future__ import annotations

import re
from pathlib import Path

from robustlab.report.drawings import DRAWINGS

PAGE = Path(__file__).parents[3] / "docs" / "objects.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_page_runs_and_says_what_is_printed(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    (shown,) = blocks("text")
    for k, block in enumerate(blocks("python")):
        exec(block, names)
        printed = capsys.readouterr().out
        if k == 0:
            assert printed == shown
            continue
        said = [line.partition("  # ")[2] for line in block.splitlines() if line.startswith("print")]
        assert printed.splitlines() == said
    assert (tmp_path / "margin.png").stat().st_size > 10_000


def test_the_page_lists_every_drawing():
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("| object | drawings |") : text.index("The envelope of an uncertain model")]
    listed = set(re.findall(r"`([a-z]+)`", table))
    drawn = {kind for kinds in DRAWINGS.values() for kind in kinds}
    assert drawn <= listed
    options = set(re.findall(r"`([a-z]+)=`", table))
    assert {"omega", "t", "n", "seed", "output", "models", "record"} <= options
