"""Pages whose code is followed by what it prints: the code runs, and that is what it prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize("name", ["cover", "delays", "gain-scheduling", "watch"])
def test_the_page_prints_what_it_says(name, capsys):
    page = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    parts = re.findall(r"```(python)?\n(.*?)```", page, flags=re.DOTALL)
    names: dict = {}
    assert any(kind == "python" for kind, _ in parts)
    for k, (kind, code) in enumerate(parts):
        if kind == "python":
            exec(code, names)
            assert capsys.readouterr().out == parts[k + 1][1]


def test_the_figures_of_gain_scheduling_are_those_of_its_benchmark():
    page = (DOCS / "gain-scheduling.md").read_text(encoding="utf-8")
    results = (DOCS.parent / "benchmarks" / "results" / "scheduling.txt").read_text(encoding="utf-8")
    for said, measured in (("2.514", "2.5139"), ("2.769", "2.7693"), ("1.5 %", "1.47%"), ("14 %", "13.62%")):
        assert said in page
        assert measured in results
