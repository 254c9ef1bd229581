"""``robustlab report compare`` and where runs write by default, through the real command."""

import copy
import json
from pathlib import Path

import pytest
from shell import robustlab

RECIPE = """\
schema = "robustlab.recipe/1"
name = "steady"
[step.motor]
do = "plant"
plant = "dc-motor"
[step.model]
do = "linearise"
of = "motor"
outputs = ["omega", "i"]
[step.speed]
do = "steady-state"
of = "model"
inputs = { u = 42.0 }
[[require]]
text = "the motor turns"
that = "speed.outputs.omega"
at_least = 1.0
"""


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "steady.toml").write_text(RECIPE)
    return tmp_path


def result(folder) -> dict:
    return json.loads((Path(folder) / "result.json").read_text(encoding="utf-8"))


# --- the default folder ----------------------------------------------------------------------------------------------


def test_other_settings_have_a_folder_of_their_own(recipe):
    assert robustlab("run", "steady.toml").code == 0
    first = (recipe / "out/steady/report.html").read_bytes()
    assert robustlab("run", "steady.toml", "--set", "seed=7").code == 0
    assert (recipe / "out/steady/report.html").read_bytes() == first
    assert result("out/steady-seed-7")["seed"] == 7
    assert robustlab("run", "steady.toml").code == 0
    assert {p.name for p in (recipe / "out").iterdir()} == {"steady", "steady-seed-7"}


# --- compare ---------------------------------------------------------------------------------------------------------

QUESTION = {"text": "fast", "that": "a.x", "condition": "at least 1", "limits": [1.0, None], "why_not": ""}
STEP = {
    "name": "a", "do": "plant", "title": "", "status": "certified", "trustworthy": True, "summary": "", "error": "",
    "text": "", "facts": [], "notes": [], "figures": [], "seconds": 0.1,
}  # fmt: skip


def made(folder, value, *, met=None, seed=0, **changes) -> str:
    """A run folder whose one number has this value."""
    question = {**QUESTION, "value": value, "met": value >= 1.0 if met is None else met}
    data = {
        "schema": "robustlab.result/1", "command": "run", "exit_code": 0, "seed": seed, "seconds": 1.0, "files": [],
        "requirements": [question], "steps": [{**copy.deepcopy(STEP), "numbers": {"x": value, "n": [1, 2]}}],
        "recipe": dict.fromkeys(("name", "title", "description", "text", "sha256", "file"), "r") | {"overrides": {}},
        "provenance": {"created": "", "inputs": {}, "versions": {"numpy": "2"}},
    } | changes  # fmt: skip
    Path(folder).mkdir()
    (Path(folder) / "result.json").write_text(json.dumps(data))
    return str(folder)


@pytest.mark.parametrize(
    ("first", "second", "code", "verdict", "why"),
    [
        (2.0, 2.0, 0, "same", "met"),
        (2.0, 2.01, 0, "same", "met"),  # within the tolerance of 1 %
        (2.0, 3.0, 0, "better", "met, with more room"),
        (2.0, 1.5, 1, "WORSE", "met, with less room"),
        (2.0, 0.5, 1, "WORSE", "was met, is not"),
        (0.5, 2.0, 0, "better", "now met"),
        (0.5, 0.4, 1, "WORSE", "not met, and further off"),
        (0.5, 0.7, 0, "better", "not met, but nearer"),
    ],
)
def test_a_requirement_side_by_side(tmp_path, first, second, code, verdict, why):
    runs = made(tmp_path / "one", first), made(tmp_path / "two", second)
    data = robustlab("report", "compare", *runs, "--json", code=code).json
    (found,) = data["requirements"]
    assert (found["verdict"], found["why"]) == (verdict, why)
    assert data["worse"] == code
    assert [c["what"] for c in data["numbers"]] == (["a.x"] if abs(first - second) > 0.01 * max(first, second) else [])


def test_the_text_lists_the_changes(tmp_path):
    runs = made(tmp_path / "one", 2.0), made(tmp_path / "two", 1.5, seed=7)
    lines = [line.split() for line in robustlab("report", "compare", *runs, code=1).out.splitlines()]
    assert ["WORSE", "fast", "2", "1.5", "at", "least", "1", "met,", "with", "less", "room"] in lines
    assert ["a.x", "2", "1.5"] in lines
    assert ["seed", "0", "7"] in lines
    assert ["1", "got", "worse:", "fast"] in lines


def test_a_met_requirement_that_vanishes_and_a_step_without_trust_are_worse(tmp_path):
    old = made(tmp_path / "one", 2.0)
    gone = robustlab("report", "compare", old, made(tmp_path / "two", 2.0, requirements=[]), code=1).out
    assert "was met and is no longer stated" in gone
    doubtful = {**STEP, "numbers": {}, "status": "failed", "trustworthy": False}
    assert "failed" in robustlab("report", "compare", old, made(tmp_path / "three", 2.0, steps=[doubtful]), code=1).out


def test_within_a_range_no_place_is_better(tmp_path):
    question = {**QUESTION, "condition": "between 1 and 3", "limits": [1.0, 3.0], "met": True}
    runs = [made(tmp_path / n, v, requirements=[{**question, "value": v}]) for n, v in (("one", 2.0), ("two", 2.9))]
    assert robustlab("report", "compare", *runs).code == 0


def test_two_real_runs(recipe):
    robustlab("run", "steady.toml", code=0)
    robustlab("run", "steady.toml", "--set", "speed.inputs.u=21.0", "--out", "half", code=0)
    out = robustlab("report", "compare", "out/steady", "half", code=1).out
    assert "met, with less room" in out
    assert "--set speed.inputs.u" in out
    robustlab("report", "compare", "half", "half", code=0)
