"""docs/models.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "models.md"


def test_the_page_runs_and_says_what_is_printed(capsys):
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(block, names)
        printed = capsys.readouterr().out.replace("\n ", " ").splitlines()
        said = [line.partition("  # ")[2] for line in block.splitlines() if line.startswith("print")]
        assert printed == said
