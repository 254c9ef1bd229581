"""docs/measured.md is what its script writes from the raw results, and leaves none of them out."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
RESULTS = ROOT / "benchmarks" / "results"


def test_the_page_is_what_the_results_say():
    command = [sys.executable, str(ROOT / "benchmarks" / "measured.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_file_of_results_is_on_the_page_or_said_to_be_left_out():
    script = (ROOT / "benchmarks" / "measured.py").read_text(encoding="utf-8")
    left_out = re.findall(r'"(\w+\.txt)": "', script)
    linked = re.findall(r"\(\.\./benchmarks/results/(\w+\.txt)\)", PAGE)
    assert {path.name for path in RESULTS.glob("*.txt")} == {*linked, *left_out}
    assert not set(linked) & set(left_out)


def test_every_row_has_its_date_and_misses_are_marked():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and "benchmarks/results" in line]
    assert len(rows) > 25
    assert all(re.search(r"\| 20\d\d-\d\d-\d\d \|", row) for row in rows)
    assert PAGE.count("**missed**") > 15
    assert "{" not in PAGE
