"""Progress of long commands: a bar on terminals, JSON lines, or nothing; stdout has the result alone."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_files import write_models
from patience import PATIENCE
from shell import robustlab

from robustlab.budget import Budget, listening
from robustlab.cli import Display

pty = pytest.importorskip("pty")

# A plant whose file takes long: what a slow computation looks like from outside, on any machine.
SLOW = "import time\nimport robustlab as rl\ntime.sleep(4.5)\naxis = rl.plant('servo-axis')\n"
RECIPE = """\
schema = "robustlab.recipe/1"
name = "slow"
[step.first]
do = "plant"
plant = "servo-axis"
[step.second]
do = "plant"
plant = "slow.py:axis"
"""


@pytest.fixture
def slow(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "slow.toml").write_text(RECIPE)
    return tmp_path


def on_a_terminal(folder):
    """stdout, and what a terminal that stderr is shows."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"}
    words = [sys.executable, "-m", "robustlab.cli.main", "run", "slow.toml", "--json"]
    with subprocess.Popen(words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        while part := _read(ours):
            shown += part
        os.close(ours)
        out = process.stdout.read()
        assert process.wait(timeout=PATIENCE) == 0
    return json.loads(out), shown.decode()


def _read(terminal):
    try:
        return os.read(terminal, 65536)
    except OSError:  # the other end was closed
        return b""


@pytest.mark.slow
def test_a_terminal_shows_the_step_the_time_passed_and_the_time_to_go(slow):
    result, shown = on_a_terminal(slow)
    assert result["command"] == "run"
    assert "run: [2/2] second (plant)" in shown
    assert " s, about " in shown
    assert " to go" in shown
    assert "\x1b[2K" in shown  # it is wiped again


def test_a_pipe_gets_lines_without_a_bar(slow):
    (slow / "slow.py").write_text(SLOW.replace("time.sleep(4.5)", ""))
    lines = robustlab("run", "slow.toml", "--json", code=0).err.splitlines()
    assert lines == ["[1/2] first (plant)", "[2/2] second (plant)"]
    assert robustlab("run", "slow.toml", "--json", "--progress", "none", code=0).err == ""


def test_json_lines_report_the_progress(slow):
    ending = robustlab("run", "slow.toml", "--json", "--progress", "json", code=0)
    assert ending.json["command"] == "run"
    lines = [json.loads(line) for line in ending.err.splitlines()]
    assert {line["schema"] for line in lines} == {"robustlab.progress/1"}
    states = [line["progress"] for line in lines]
    assert all(set(s) == KEYS for s in states)
    assert next(s["text"] for s in states if s["text"]) == "[1/2] first (plant)"
    assert {s["command"] for s in states} == {"run"}
    assert [s["elapsed_s"] for s in states] == sorted(s["elapsed_s"] for s in states)
    waiting = [s for s in states if s["done"] == 1 and s["remaining_s"] is not None]
    assert len(waiting) >= 2  # at the step, and at least once while it sleeps
    for s in waiting:  # half of it is done: as much to go as has passed
        assert s["remaining_s"] == pytest.approx(s["elapsed_s"], abs=0.002)  # of one look at the clock
    assert [s["ended"] for s in states] == [False] * (len(states) - 1) + [True]


@pytest.fixture
def models(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)


def states_of(err):
    return [json.loads(line)["progress"] for line in err.splitlines() if line.startswith("{")]


def test_a_search_tells_the_work_it_may_take_at_most(models):
    last = states_of(robustlab("mu", "speed.h5", "--progress", "json", "--json", code=0).err)[-1]
    assert last["ended"]
    assert last["at_most"]
    assert 0 < last["done"] <= last["total"]
    assert robustlab("mu", "speed.h5", code=0).err == ""


# Commands that are done in a second, whatever they are given, or write a line of their own (a platform's equations).
QUICK = {
    *("plant list", "plant new", "plant show", "model show", "model convert"),
    *("recipe check", "recipe new", "recipe steps", "recipe schema", "report write", "report compare", "doctor"),
}


def test_every_command_that_can_take_long_shows_its_progress():
    from robustlab.cli import GROUPS, parser

    def walk(found, words=()):
        if not hasattr(found, "commands"):
            yield " ".join(words), {name for parameter in found.params for name in parameter.opts}
        else:
            for name, inner in found.commands.items():
                yield from walk(inner, (*words, name))

    silent = {name for group in GROUPS for name, o in walk(parser(group), (group,)) if "--progress" not in o}
    assert silent == QUICK


@pytest.mark.parametrize(
    "words",
    [
        "model classical-margins lag.h5",
        "model check lag.h5",
        "model reduce lag.h5 --order 0",
        "mu pole.h5 --frequency 1",
        "synth ncf lag.h5",
        "uncertain sample pole.h5",
    ],
)
def test_json_lines_of_commands_without_progress_texts(models, words):
    last = states_of(robustlab(*words.split(), "--progress", "json", code=0).err)[-1]
    assert last["ended"]
    assert words.startswith(last["command"])


@pytest.mark.slow
def test_figures_of_a_design_are_drawn_while_progress_is_shown(models):
    """The last line of progress comes after them."""
    words = ("synth", "ncf", "lag.h5", "--figure", "f.svg", "--out", "new.h5", "--progress", "json")
    *lines, last = robustlab(*words, code=0).err.splitlines()
    assert json.loads(last)["progress"]["ended"]
    assert "written: f.svg" in lines
    states = states_of("\n".join(lines))
    assert states[-1]["text"] == "figures"
    assert not any(state["ended"] for state in states)


KEYS = {"command", "text", "elapsed_s", "done", "total", "remaining_s", "at_most", "part", "ended"}


def test_the_page_names_every_key_of_a_line():
    page = (Path(__file__).parents[2] / "docs" / "progress.md").read_text(encoding="utf-8")
    assert set(Display("run", "none").state()) == KEYS
    keys = page.partition("| key |")[2].partition("What is counted")[0]
    assert set(re.findall(r"(?m)^\| `(\w+)` \|", keys)) == KEYS
    assert "robustlab.progress/1" in page


def test_parts_of_a_search_are_counted_and_timed_one_by_one(monkeypatch):
    now = [50.0]
    monkeypatch.setattr("robustlab.cli.progress.time.monotonic", lambda: now[0])
    display = Display("data discover", "none")
    assert display.state()["done"] is display.state()["total"] is display.state()["remaining_s"] is None
    display.part(1, 9, "first")
    now[0] += 8.0
    display.part(5, 9, "first")  # four took 8 s, four are left
    state = display.state()
    assert (state["done"], state["total"], state["elapsed_s"], state["remaining_s"]) == (5, 9, 8.0, 8.0)
    assert state["part"]
    display.part(1, 21, "second")
    assert display.state()["remaining_s"] is None
    now[0] += 10.0
    display.part(11, 21, "second")
    assert display.state()["remaining_s"] == 10.0
    assert display._times() == "18 s, about 10 s to go in this part"
    display.part(0, 0, "what remains")
    assert display.state()["total"] is display.state()["remaining_s"] is None


def test_a_budget_tells_all_that_is_spent_in_it_once():
    counts = []
    with listening(lambda done, whole: counts.append((done, whole))):
        budget = Budget(100)
        endless = Budget()
    part = budget.share(0.5)
    part.spend(20)
    budget.apart(30).spend(25)  # counted when it was taken
    endless.spend(7)
    Budget(50).spend(1)  # made when nobody listened
    assert counts == [(20, 100), (50, 100)]


def test_what_earlier_runs_did_is_no_measure_of_speed(monkeypatch):
    now = [50.0]
    monkeypatch.setattr("robustlab.cli.progress.time.monotonic", lambda: now[0])
    display = Display("campaign resume", "none", 100)
    display.resumed(80)
    assert display._remaining() is None
    now[0] += 7.0
    display.step(90)  # ten in this time, ten to go
    assert display._remaining() == 7.0
