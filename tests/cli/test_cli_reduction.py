"""``robustlab model reduce | discretise`` and ``synth reduce | discretise``: files, results, exit codes."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import model, synth
from robustlab.cli.ending import main_guard


def run(app, *arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def files(tmp_path):
    P = rl.StateSpaceModel(
        [[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
    )  # fmt: skip
    K = rl.StateSpaceModel(
        [[-1.7, 0.0], [0.0, -90.0]], [[0.5], [0.01]], [[-0.4, 0.01]], [[0.0]], inputs=["y"], outputs=["u"]
    )
    rl.save(tmp_path / "p.h5", P)
    rl.save(tmp_path / "k.h5", rl.Controller(K))
    return str(tmp_path / "p.h5"), str(tmp_path / "k.h5"), str(tmp_path / "out.h5")


def test_a_reduced_model_with_its_error(files, capsys):
    _, k, out = files
    assert run(model.app, "reduce", k, "--order", "1", "--out", out, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["command"] == "model reduce"
    assert result["status"] == "certified"
    assert result["error"]["upper"] <= result["bound"] * (1 + 1e-5)
    gap = rl.load(k).K.dc_gain() - rl.load(out).dc_gain()
    assert abs(gap[0, 0]) <= result["error"]["upper"]
    assert run(model.app, "reduce", k, "--max-error", "0.01") == 0
    assert "verified upper bound" in capsys.readouterr().out


def test_the_other_ways_to_reduce_and_what_they_tell(files, tmp_path, capsys):
    p, out = str(tmp_path / "chain.h5"), files[2]
    G = rl.linearise(rl.plant("mass-spring-damper", m=[1.0] * 3, c=[0.2] * 3, k=[1.0] * 3)).select(["f1"], ["q1"])
    rl.save(p, G)
    assert run(model.app, "reduce", p, "--order", "2", "--method", "hankel", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["hankel_error"] == pytest.approx(rl.hankel_singular_values(G)[2], rel=1e-8)
    assert run(model.app, "reduce", p, "--order", "2", "--band", "0.2,0.6", "--out", out) == 0
    assert "error in the band" in capsys.readouterr().out
    difference = G - rl.load(out)
    inside = rl.peak_gain(difference, norm="linf", band=(0.2, 0.6))
    omega = np.linspace(0.2, 0.6, 2000)
    seen = np.abs(rl.frequency_response(difference, omega)).max()
    assert inside.upper * (1 - 1e-5) <= seen <= inside.upper
    assert run(model.app, "reduce", p, "--order", "2", "--method", "stochastic") == 3
    assert "--floor" in capsys.readouterr().err.replace("floor=", "--floor")
    assert run(model.app, "reduce", p, "--order", "2", "--method", "stochastic", "--floor", "0.1") == 0
    assert "relative error" in capsys.readouterr().out
    low = str(tmp_path / "low.h5")
    rl.save(low, rl.StateSpaceModel([[-0.5]], [[0.5]], [[1.0]], [[1e-3]]))
    assert run(model.app, "reduce", p, "--order", "2", "--input-weight", low) == 0
    assert "weighted error" in capsys.readouterr().out
    assert run(model.app, "reduce", p, "--order", "2", "--band", "0.2") == 2


def test_a_reduced_controller(files, capsys):
    p, k, out = files
    assert run(synth.app, "reduce", p, k, "--loss", "0.01", "--out", out, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["original_order"] == 2
    assert result["order"] < 2
    assert result["loss"] <= 0.01
    stored = rl.load(out)
    assert stored.K.n_states == result["order"]
    assert stored.gamma == pytest.approx(result["gamma"])
    by_name = ("--measurements", "y", "--controls", "u", "--order", "1")
    assert run(synth.app, "reduce", p, k, *by_name) == 0
    assert "loss by order" in capsys.readouterr().out
    assert run(synth.app, "reduce", p, k, "--measurements", "y") == 2


def test_a_digital_controller_and_its_loss_as_exit_code(files, capsys):
    p, k, out = files
    assert run(synth.app, "discretise", p, k, "--dt", "0.05", "--out", out, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["dt"] == 0.05
    assert result["status"] == "certified"
    assert result["loss"] < 0.1
    assert rl.load(out).K.dt == 0.05
    assert run(synth.app, "discretise", p, k, "--dt", "2", "--method", "tustin", "--loss", "0.0001") == 1
    assert run(synth.app, "discretise", p, k, "--dt", "0") == 3


def test_robust_performance_of_the_sampled_loop_of_an_uncertain_plant(tmp_path, capsys):
    M = rl.StateSpaceModel([[-1.0]], [[-0.3, 1.0, 1.0]], [[1.0]] * 3, [[0.0] * 3] * 3)
    p, k = str(tmp_path / "p.h5"), str(tmp_path / "k.h5")
    rl.save(p, rl.UncertainModel(M, [rl.RealScalar("pole")]))
    rl.save(k, rl.StateSpaceModel([], [], [], [[-3.0]]))
    assert run(synth.app, "discretise", p, k, "--dt", "0.05", "--method", "tustin", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    robust = result["robustness"]
    assert (robust["status"], robust["dt"]) == ("certified", 0.05)
    # A slow loop: mu is nearly that of x' = -(4 + 0.3 delta) x + d, 1.3 / 4; the norm is the nominal one, 1 / 4.
    assert robust["mu_upper"] == pytest.approx(1.3 / 4, rel=1e-2)
    assert result["gamma"] == pytest.approx(1 / 4, rel=1e-2)


def test_the_real_command(files):
    p, k, _ = files
    done = subprocess.run(
        [sys.executable, "-m", "robustlab.cli.main", "synth", "reduce", p, k],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("ReducedController (certified)\n  measure ")
    assert all(line.startswith("warning: ") and "no unit stated" in line for line in done.stderr.splitlines())


def test_an_unstable_loop_of_a_bare_plant_is_exit_code_4(tmp_path, capsys):
    """No disturbance, no performance output: the four-block gain of the loop is judged, and there is none."""
    g, k = tmp_path / "g.h5", tmp_path / "k.h5"
    rl.save(g, rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]]))
    rl.save(k, rl.StateSpaceModel([[-10.0]], [[1.0]], [[5.0]], [[0.0]]))
    assert run(synth.app, "reduce", str(g), str(k)) == 4
    assert "pole 1.43717+0j is unstable" in capsys.readouterr().err


def test_a_minimal_model(files, capsys):
    p, _, out = files
    rl.save(p, rl.StateSpaceModel([[0, 0], [0, -1]], [[0], [1]], [[1, 1]], [[0]]))
    assert run(model.app, "minimal", p, "--out", out, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["order"], result["error"]["upper"]) == (1, 0)
    assert result["removed"] == ["unstable mode 0 rad/s in x1: no input moves it"]
    assert rl.load(out).poles().tolist() == [-1]
