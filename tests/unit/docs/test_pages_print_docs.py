"""Pages whose code is followed by what it prints: the code runs, and that is what it prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[3] / "docs"
NUMBER = re.compile(r"\d+(?:\.(\d+))?(?:e[-+]?\d+)?")


def differing(printed: str, said: str) -> list[tuple[str, str]]:
    """Numbers that differ by more than one unit of their last digit: what lies between two is rounded either way."""
    if NUMBER.sub("#", printed) != NUMBER.sub("#", said):
        return [(printed, said)]
    pairs = zip(NUMBER.finditer(printed), NUMBER.finditer(said), strict=True)
    return [
        (a[0], b[0])
        for a, b in pairs
        if a[0] != b[0] and ("e" in a[0] + b[0] or abs(float(a[0]) - float(b[0])) > 1.001 * 10.0 ** -len(b[1] or ""))
    ]


def test_a_page_that_says_something_else_is_seen():
    assert differing("Fc = 20.0 N (19.6 .. 20.3)\n", "Fc = 20.0 N (19.7 .. 20.3)\n") == []
    assert differing("Fc = 20.0 N (19.6)", "Fc = 20.0 N (19.8)") == [("19.6", "19.8")]
    assert differing("6 s, 3e-05", "6 s, 4e-05") == [("3e-05", "4e-05")]
    assert differing("named at 8 s", "unknown at 8 s") != []


@pytest.mark.parametrize("name", ["cover", "delays", "gain-scheduling", "watch"])
def test_the_page_prints_what_it_says(name, capsys):
    page = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    parts = re.findall(r"```(python)?\n(.*?)```", page, flags=re.DOTALL)
    names: dict = {}
    assert any(kind == "python" for kind, _ in parts)
    for k, (kind, code) in enumerate(parts):
        if kind == "python":
            exec(code, names)
            assert differing(capsys.readouterr().out, parts[k + 1][1]) == []
