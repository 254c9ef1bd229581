"""docs/gain-scheduling.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "gain-scheduling.md"


def test_the_page_prints_what_it_says(capsys):
    parts = re.findall(r"```(python)?\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict = {}
    for k, (kind, code) in enumerate(parts):
        if kind == "python":
            exec(code, names)
            assert capsys.readouterr().out == parts[k + 1][1]


def test_the_figures_of_the_benchmark_are_those_of_its_results():
    page = PAGE.read_text(encoding="utf-8")
    results = (PAGE.parents[1] / "benchmarks" / "results" / "scheduling.txt").read_text(encoding="utf-8")
    for said, measured in (("2.527", "2.5269"), ("2.772", "2.7719"), ("1.5 %", "1.47%"), ("14 %", "13.62%")):
        assert said in page
        assert measured in results
