"""docs/your-own-machine.md: its files, its code and every command of it, in the order of the page."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run
from robustlab.dynamics.plant_file import TEMPLATE

DOCS = Path(__file__).parents[3] / "docs"
TEXT = (DOCS / "your-own-machine.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(sh|python|text)\n(.*?)```", TEXT, flags=re.DOTALL)


def squeezed(text):
    return " ".join(text.split())


def follow(folder, capsys, *, search):
    """Do what the page says, in its order; ``search``: the naming too, which takes most of the time."""
    names, printed = {}, ""
    for kind, block in BLOCKS:
        first = block.partition("\n")[0]
        if kind == "sh":
            printed = None if "data discover" in block and not search else ""
            for command in block.splitlines() if printed is not None else ():
                program, *words = shlex.split(command)
                assert program == "robustlab"
                code = main_guard(lambda words=words: run(words))
                out, err = capsys.readouterr()
                assert code == 0, (command, err)
                printed += out
        elif kind == "text":
            for line in block.splitlines() if printed is not None else ():
                assert squeezed(line) in squeezed(printed), line
        elif first == "# stage.py":
            (folder / "stage.py").write_text(block)
        elif first == "# mymachine.py":
            told = {squeezed(line) for line in TEMPLATE.format(stem="mymachine", file="mymachine.py").splitlines()}
            assert {squeezed(line) for line in block.splitlines()[1:]} - told == {"..."}
        else:
            exec(block, names)
            out = capsys.readouterr().out.splitlines()
            said = [line.partition("  # ")[2] for line in block.splitlines() if line.startswith("print")]
            assert out == said


@pytest.mark.slow
def test_the_page_runs_in_order_with_the_search(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    follow(tmp_path, capsys, search=True)
    assert (tmp_path / "found/report.html").is_file()
    (friction,) = json.loads((tmp_path / "found/result.json").read_text())["effects"]
    assert friction["parameters"][0]["value"] == pytest.approx(6.0, rel=0.01)
    (tmp_path / "mymachine.py").unlink()
    assert rl.trim(rl.load("found/updated-plant.h5"), F=0.0).u[0] == 0.0


def test_the_page_runs_in_order_and_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    follow(tmp_path, capsys, search=False)
    # k x + h x^3 = F - m g sin(slope) for F = 0 and 30 N: what the page prints, by the roots of the polynomial.
    weight = 12.0 * 9.81 * np.sin(0.35)
    hung, pushed = (next(r.real for r in np.roots([2e5, 0, 800, weight - F]) if not r.imag) for F in (0.0, 30.0))
    assert f"{1e3 * (pushed - hung):.1f} mm, linear {1e3 * 30 / (800 + 6e5 * hung**2):.1f} mm" in TEXT


def test_the_messages_of_the_table_are_those_that_are_told(tmp_path, monkeypatch, capsys):
    """Each row by the fault that it is about, in the files of the page."""
    monkeypatch.chdir(tmp_path)
    template = TEMPLATE.format(stem="mymachine", file="mymachine.py")
    (stage,) = [block for kind, block in BLOCKS if block.startswith("# stage.py")]
    faults = {
        "is no Python": ("mymachine.py:axis", template.replace('"kg", tol', '"kg" tol')),
        "NameError": ("mymachine.py:axis", template.replace("[[m]]", "[[mass]]")),
        "needs casadi": ("mymachine.py:axis", template),
        "no plant 'axle'": ("mymachine.py:axle", template),
        "returned None": ("mymachine.py:axis", template.replace("return p.plant(**given)", "p.plant(**given)")),
        "no role": ("mymachine.py:axis", template.replace(' role="inertia",', "")),
        "not affine": ("stage.py:stage", stage.replace('p["m"]', '1 / (p["m"] + 1)')),
    }
    rows = re.findall(r"(?m)^\| `([a-z]+\.py[,:][^`]+)` \|", TEXT)
    assert len(rows) == len(faults)
    for (word, (plant, text)), row in zip(faults.items(), rows, strict=True):
        assert word in row
        Path(plant.partition(":")[0]).write_text(text)
        with monkeypatch.context() as patch:
            if word == "needs casadi":
                patch.setitem(sys.modules, "casadi", None)  # as if it were not installed
            code = main_guard(lambda plant=plant: run(["model", "build", plant, "--out", "m.h5"]))
        assert code == (5 if word == "needs casadi" else 3)
        assert not Path("m.h5").exists()
        told = capsys.readouterr().err
        line, shown = (re.sub(r"line \d+", "line N", text) for text in (told, row.removesuffix(" ...")))
        assert line.startswith(f"error: {shown}"), told


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (DOCS / target).exists(), target
