"""docs/from_data_to_controller.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "from_data_to_controller.md"


def test_the_page_runs_and_its_numbers_are_right(capsys):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(block, {})
    said = [line.partition("#")[2].strip() for line in block.splitlines() if line.startswith("print")]
    for printed, expected in zip(capsys.readouterr().out.splitlines(), said, strict=True):
        assert expected.startswith(printed)
