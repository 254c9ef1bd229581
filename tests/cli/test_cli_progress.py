"""Progress of long commands: a bar on terminals, or nothing; stdout has the result alone."""

import json
import os
import subprocess
import sys

import pytest
from patience import PATIENCE
from shell import robustlab

from robustlab.budget import Budget, listening

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
    assert "0:00:0" in shown
    assert "\x1b[2K" in shown  # it is wiped again


def test_a_pipe_gets_lines_without_a_bar(slow):
    (slow / "slow.py").write_text(SLOW.replace("time.sleep(4.5)", ""))
    lines = robustlab("run", "slow.toml", "--json", code=0).err.splitlines()
    assert lines == ["[1/2] first (plant)", "[2/2] second (plant)"]
    assert robustlab("run", "slow.toml", "--json", "--progress", "none", code=0).err == ""


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


def test_a_budget_tells_all_that_is_spent_in_it_once():
    counts = []
    with listening(lambda done, whole: counts.append((done, whole))):
        budget = Budget(100)
        endless = Budget()
    part = budget.share(0.5)
    part.spend(20)
    endless.spend(7)
    Budget(50).spend(1)  # created without a listener
    assert counts == [(20, 100)]
