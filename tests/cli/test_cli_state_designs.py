"""``model zeros``, resampling and their recipe steps: closed forms through the real command."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main, model
from robustlab.cli.ending import main_guard


def run(app, *arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def lag(tmp_path, monkeypatch):
    """x' = -x + u, y = x."""
    monkeypatch.chdir(tmp_path)
    rl.save("lag.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"], ["x"]))
    return "lag.h5"


def test_zeros_with_their_kinds(lag, capsys):
    # (s - 1) / ((s + 2)(s + 3)), and a mode at -5 that no input moves.
    A = [[0, 1, 0], [-6, -5, 0], [0, 0, -5]]
    rl.save("z.h5", rl.StateSpaceModel(A, [[0], [1], [0]], [[-1, 1, 1]], [[0]]))
    assert run(model.app, "zeros", "z.h5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(found["kinds"]) == ["input-decoupling", "transmission"]
    assert run(model.app, "zeros", "z.h5") == 0
    text = capsys.readouterr().out
    assert re.search(r"^1  +transmission ", text, re.MULTILINE)
    assert re.search(r"^-5  +input-decoupling ", text, re.MULTILINE)
    assert run(model.app, "zeros", lag) == 0
    assert "none" in capsys.readouterr().out


def test_zeros_of_a_chain_with_large_gains_and_one_that_rounding_decides(lag, capsys):
    A = -1e-3 * np.eye(4) + 1e3 * np.eye(4, k=1)
    rl.save("chain.h5", rl.StateSpaceModel(A, [[0], [1], [0], [1]], [[1, 1, 1, 1]], [[0]]))
    assert run(model.app, "zeros", "chain.h5") == 0
    text = capsys.readouterr().out
    assert re.search(r"^-1000  +transmission ", text, re.MULTILINE)
    assert "707.107" in text
    rng = np.random.default_rng(4)
    C = rng.normal(size=(3, 2)) @ rng.normal(size=(2, 4))
    rl.save("three.h5", rl.StateSpaceModel(rng.normal(size=(4, 4)), rng.normal(size=(4, 3)), C, np.zeros((3, 3))))
    assert run(model.app, "zeros", "three.h5") == 4
    assert "the normal rank is 3, and 2 to within rounding of the entries" in capsys.readouterr().out


RECIPE = """\
schema = "robustlab.recipe/1"
name = "states"
[step.lag]
do = "load"
path = "lag.h5"
[step.sampled]
do = "resample"
of = "lag"
dt = 0.1
[step.slower]
do = "resample"
of = "sampled"
dt = 0.3
[step.back]
do = "resample"
of = "slower"
dt = 0.0
[step.none]
do = "zeros"
of = "lag"
"""


def test_the_same_as_steps_of_a_recipe(lag, tmp_path):
    (tmp_path / "r.toml").write_text(RECIPE)
    assert main.run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}
    assert steps["none"]["numbers"]["count"] == 0
    poles = {name: [p["re"] for p in steps[name]["numbers"]["poles"]] for name in ("sampled", "slower", "back")}
    assert poles["sampled"] == pytest.approx([np.exp(-0.1)], rel=1e-12)
    assert poles["slower"] == pytest.approx([np.exp(-0.3)], rel=1e-12)
    assert poles["back"] == pytest.approx([-1.0], rel=1e-9)
    assert steps["back"]["status"] == "converged"
    assert steps["back"]["numbers"]["dt"] == 0
