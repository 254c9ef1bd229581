"""docs/delays.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "delays.md"


def test_the_page_prints_what_it_says(capsys):
    parts = re.findall(r"```(python)?\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict = {}
    for k, (kind, code) in enumerate(parts):
        if kind == "python":
            exec(code, names)
            assert capsys.readouterr().out == parts[k + 1][1]
