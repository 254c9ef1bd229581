"""``robustlab synth ncf | dk | tune`` and their steps in a recipe: through the real commands."""

from __future__ import annotations

import json

import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run as whole
from robustlab.cli.synth import app

LAG = rl.StateSpaceModel([[-1.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], inputs=["u"], outputs=["y"])


def run(*arguments: object) -> int:
    return main_guard(lambda: app([str(a) for a in arguments], standalone_mode=False))


@pytest.fixture
def lag(tmp_path):
    path = tmp_path / "lag.h5"
    rl.save(path, LAG)
    return path


RECIPE = """\
schema = "robustlab.recipe/1"
name = "regulators"
[step.chain]
do = "plant"
plant = "mass-spring-damper"
choices = { m = [1.0], c = [0.2], k = [1.0] }
[step.model]
do = "linearise"
of = "chain"
outputs = ["q"]
"""


def steps_of(recipe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE + recipe)
    assert whole(["run", "r.toml", "--out", "o"]) == 0
    return {s["name"]: s for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}


def test_ncf_with_a_reference_model(lag, tmp_path, monkeypatch, capsys):
    wanted = rl.StateSpaceModel([[-2.0]], [[2.0]], [[1.0]], [[0.0]])
    rl.save(tmp_path / "t.h5", wanted)
    out = tmp_path / "k.h5"
    given = ["--w1", "4", "--reference-model", tmp_path / "t.h5", "--rho", "2", "--follow", "y", "--out", out, "--json"]
    assert run("ncf", lag, *given) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "certified"
    assert found["steady_error"] < 1e-9
    assert rl.load(out).K.input_names == ("y reference taken", "y measured")
    chain = (
        '[step.other]\ndo = "plant"\nplant = "mass-spring-damper"\nchoices = { m = [1.0], c = [1.6], k = [1.0] }\n'
        '[step.wanted]\ndo = "linearise"\nof = "other"\noutputs = ["q"]\n'
        '[step.k]\ndo = "ncf"\nof = "model"\nW1 = 4.0\nreference_model = "wanted"\nrho = 2.0\n'
    )
    numbers = steps_of(chain, tmp_path, monkeypatch)["k"]["numbers"]
    assert numbers["steady_error"] < 1e-9
    assert numbers["rho"] == 2.0


def test_dk_with_a_structure(tmp_path, monkeypatch, capsys):
    M = rl.StateSpaceModel(
        [[-1.0]], [[0.4, 1, 0, 1]], [[0], [1], [0], [1]], [[0, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]],
        inputs=["w_gain", "w", "n", "u"], outputs=["z_gain", "z", "effort", "y"],
    )  # fmt: skip
    path = tmp_path / "uncertain.h5"
    rl.save(path, rl.UncertainModel(M, [rl.ComplexScalar("gain")]))
    named = [
        "--measurements",
        "y",
        "--controls",
        "u",
        "--disturbance-inputs",
        "w,n",
        "--performance-outputs",
        "z,effort",
    ]
    assert run("dk", path, *named, "--structure", "pi", "--starts", "1", "--out", tmp_path / "k.h5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "certified"
    assert set(found["parameters"]) == {"Kp[1]", "Ki[1]"}
    assert rl.load(tmp_path / "k.h5").K.n_states == 1
    assert run("dk", path, *named, "--structure", "fuzzy") == 3
    assert "fuzzy" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(
        'schema = "robustlab.recipe/1"\nname = "r"\n[step.set]\ndo = "load"\npath = "uncertain.h5"\n'
        '[step.k]\ndo = "dk"\nof = "set"\nmeasurements = 1\ncontrols = 1\nstructure = "static"\nstarts = 1\n'
    )
    assert whole(["run", "r.toml", "--out", "o"]) == 0


def test_tune_with_goals(lag, tmp_path, monkeypatch, capsys):
    out = tmp_path / "k.h5"
    given = ["--structure", "pi", "--starts", "1", "--goal", "tracking:response_time=1,error=0.02,outputs=y"]
    given += ["--hard", "margin:disk=0.8,at=input", "--pole-limit", "damping=0.5"]
    assert run("tune", lag, lag, *given, "--out", out, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "certified"
    assert [goal["hard"] for goal in found["goals"]] == [False, True]
    assert len(found["goals"][0]["values"]) == 2
    assert rl.disk_margin(LAG, rl.load(out).K, at="input").simultaneous.lower >= 0.8 * (1 - 1e-4)
    steps = steps_of(
        '[step.k]\ndo = "tune"\nof = "model"\nalso = ["model"]\nstructure = "pi"\nstarts = 0\ndecay = 0.01\n'
        'goals = [{ goal = "tracking", response_time = 20.0, error = 0.02 },\n'
        '{ goal = "margin", disk = 0.3, hard = true }]\n',
        tmp_path, monkeypatch,
    )  # fmt: skip
    assert steps["k"]["numbers"]["missed"] == 0


def test_a_hard_goal_out_of_reach_is_no_success(tmp_path, capsys):
    rl.save(tmp_path / "p.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[2.0]], [[-1.0]]))
    hard = ["--hard", "sensitivity:peak=1.5,bandwidth=5,error=0.1"]
    assert run("tune", tmp_path / "p.h5", "--structure", "pi", "--starts", "0", *hard) == 4
    assert "no controller of any structure" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (["--goal", "traking:response_time=1"], 3, "did you mean"),
        (["--goal", "tracking:fast"], 2, "key=value"),
        (["--pole-limit", "damp=1"], 2, "damping"),
        (["--pole-limit", "damping=1"], 3, "at least one goal"),
    ],
)
def test_wrong_goals_are_said(lag, capsys, options, code, text):
    assert run("tune", lag, *options) == code
    assert text in capsys.readouterr().err
