"""docs/iqc.md: the code runs, what is printed beside it is right, and its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "iqc.md").read_text(encoding="utf-8")


def test_the_page_runs_and_its_numbers_are_right(capsys):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
        exec(block, names)
    assert names["found"].upper == pytest.approx(6.6426, rel=1e-4)
    assert names["margin"].margin == pytest.approx(1.744, rel=2e-3)
    assert names["seen"].as_constants.upper == pytest.approx(0.0610, rel=2e-3)
    assert names["seen"].proved.upper == pytest.approx(0.0880, rel=2e-3)
    printed = capsys.readouterr().out.split()
    varying = [float(text) for text in printed[2:6]]
    assert varying == pytest.approx([2.7747, 2.9107, 3.4019, 5.5527], rel=1e-3)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", PAGE):
        assert (ROOT / "docs" / target).exists(), target
