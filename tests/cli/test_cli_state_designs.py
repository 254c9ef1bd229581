"""``synth lqr | lqi | kalman``, ``model zeros`` and their recipe steps: closed forms through the real command."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main, model, synth
from robustlab.cli.ending import main_guard


def run(app, *arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def lag(tmp_path, monkeypatch):
    """x' = -x + u, y = x."""
    monkeypatch.chdir(tmp_path)
    rl.save("lag.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"], ["x"]))
    return "lag.h5"


def test_lqi_of_a_lag_in_closed_form(lag, capsys):
    # With weight 1 on the integrated error and on u: K = sqrt(3) - 1, K_i = -1.
    assert run(synth.app, "lqi", lag, "--integral", "y=1", "--out", "k.h5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["command"] == "synth lqi"
    np.testing.assert_allclose(found["K"], [[np.sqrt(3) - 1]], rtol=1e-9)
    np.testing.assert_allclose(found["K_i"], [[-1.0]], rtol=1e-9)
    K = rl.load("k.h5").K
    assert K.input_names == ("y reference", "y measured", "x")
    # Weights q on x and r on u: the regulator of (x, x_i), by scipy.
    from scipy.linalg import solve_continuous_are

    A, B, Q, R = np.array([[-1.0, 0], [-1, 0]]), np.array([[1.0], [0]]), np.diag([3.0, 4.0]), np.array([[0.5]])
    X = solve_continuous_are(A, B, Q, R)
    assert (
        run(synth.app, "lqi", lag, "--integral", "y=4", "--state-weight", "x=3", "--control-weight", "u=0.5", "--json")
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose([*found["K"][0], *found["K_i"][0]], (B.T @ X)[0] / 0.5, rtol=1e-9)


def test_lqr_of_a_lag_in_closed_form(lag, capsys):
    # K = -1 + sqrt(1 + q / r)
    assert run(synth.app, "lqr", lag, "--state-weight", "x=3", "--out", "k.h5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["command"] == "synth lqr"
    np.testing.assert_allclose(found["K"], [[1.0]], rtol=1e-12)
    kept = rl.load("k.h5").K
    assert (kept.input_names, kept.output_names) == (("x",), ("u",))
    np.testing.assert_allclose(kept.D, [[-1.0]], rtol=1e-12)  # u = K x, as every controller
    assert run(synth.app, "lqr", lag, "--state-weight", "x=2", "--control-weight", "u=0.25", "--json") == 0
    np.testing.assert_allclose(json.loads(capsys.readouterr().out)["K"], [[2.0]], rtol=1e-12)


def test_kalman_of_a_lag_in_closed_form(lag, capsys):
    # -2 P + w - P^2 / v = 0; the noise on u enters through B = 1, so it is noise on x as well.
    for noise in (["x=3"], ["u=3"], ["u=1", "x=2"]):
        options = [word for text in noise for word in ("--process-noise", text)]
        assert run(synth.app, "kalman", lag, *options, "--measurement-noise", "y=1", "--out", "f.h5", "--json") == 0
        found = json.loads(capsys.readouterr().out)
        np.testing.assert_allclose(found["L"], [[1.0]], rtol=1e-9)
        np.testing.assert_allclose(found["P"], [[1.0]], rtol=1e-9)
        np.testing.assert_allclose(rl.load("f.h5").A, [[-2.0]], rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["lqr"], 2, "no state, expected weights on states"),
        (["lqr", "--state-weight", "q=1"], 3, "weight on state 'q': no such signal"),
        (["lqr", "--state-weight", "x=1", "--control-weight", "u=0"], 3, "control u costs nothing"),
        (["lqi"], 2, "no output, expected integral"),
        (["lqi", "--integral", "y"], 2, "NAME=VALUE"),
        (["lqi", "--integral", "z=1"], 3, "no such signal"),
        (["lqi", "--integral", "y=1", "--control-weight", "v=1"], 3, "weight on control 'v': no such signal"),
        (["lqi", "--integral", "y=1", "--state-weight", "x=-1"], 3, "not negative"),
        (["lqi", "--integral", "y=1", "--control-weight", "u=0"], 3, "control u costs nothing"),
        (["kalman", "--process-noise", "x=1"], 3, "measurement"),
        (["kalman", "--process-noise", "q=1", "--measurement-noise", "y=1"], 3, "one of x, u"),
    ],
)
def test_what_is_missing_is_named(lag, capsys, arguments, code, message):
    assert run(synth.app, arguments[0], lag, *arguments[1:]) == code
    assert message in capsys.readouterr().err.replace("\n", " ")


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
[step.held]
do = "lqi"
of = "lag"
integral = { y = 1.0 }
[step.fed]
do = "lqr"
of = "lag"
states = { x = 3.0 }
[step.filter]
do = "kalman"
of = "lag"
process = { u = 3.0 }
measurement = { y = 1.0 }
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
[step.files]
do = "save"
of = "held"
file = "k.h5"
[[require]]
that = "held.steady_error"
text = "No error in steady state."
at_most = 1e-9
[[require]]
that = "filter.deviations.x"
text = "As the Riccati equation says."
at_most = 1.000001
"""


def test_the_same_as_steps_of_a_recipe(lag, tmp_path):
    (tmp_path / "r.toml").write_text(RECIPE)
    assert main.run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}
    np.testing.assert_allclose(steps["held"]["numbers"]["K"], [[np.sqrt(3) - 1]], rtol=1e-9)
    assert steps["held"]["status"] == steps["filter"]["status"] == "converged"
    np.testing.assert_allclose(steps["filter"]["numbers"]["L"], [[1.0]], rtol=1e-9)
    np.testing.assert_allclose(steps["fed"]["numbers"]["K"], [[1.0]], rtol=1e-12)
    assert steps["none"]["numbers"]["count"] == 0
    assert rl.load(tmp_path / "o" / "k.h5").K.n_outputs == 1
    assert rl.load(tmp_path / "o" / "evidence" / "filter.h5").status is rl.Status.CONVERGED
    poles = {name: [p["re"] for p in steps[name]["numbers"]["poles"]] for name in ("sampled", "slower", "back")}
    assert poles["sampled"] == pytest.approx([np.exp(-0.1)], rel=1e-12)
    assert poles["slower"] == pytest.approx([np.exp(-0.3)], rel=1e-12)
    assert poles["back"] == pytest.approx([-1.0], rel=1e-9)
    assert steps["back"]["status"] == "converged"
    assert steps["back"]["numbers"]["dt"] == 0
