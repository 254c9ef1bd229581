"""``robustlab synth``: results, files, and exit codes."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.synth import app


def run(*arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def problem(tmp_path):
    path = tmp_path / "p.h5"
    P = rl.StateSpaceModel(
        [[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
    )  # fmt: skip
    rl.save(path, P)
    return path


def test_hinf_by_number_writes_a_controller_that_holds_its_gamma(problem, tmp_path, capsys):
    out = tmp_path / "k.h5"
    assert (
        run(
            "hinf",
            str(problem),
            "--measurements",
            "1",
            "--controls",
            "1",
            "--gamma-rel",
            "1",
            "--out",
            str(out),
            "--json",
        )
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert result["schema"] == "robustlab.result/1"
    assert result["gamma"] == pytest.approx(np.sqrt(3) - 1, rel=1e-3)
    assert result["status"] == "certified"
    stored = rl.load(out)
    loop = rl.load(problem)
    from robustlab.statespace import lower_lft

    assert rl.peak_gain(lower_lft(loop, stored.K)).lower <= stored.gamma
    assert stored.gamma == pytest.approx(result["gamma"])


@pytest.mark.parametrize("command", [["hinf"], ["h2"], ["dk", "--blocks", "1,0"], ["fixed"]])
def test_a_time_limit_that_strikes_is_told(problem, capsys, command):
    channels = ["--measurements", "1", "--controls", "1"]
    assert run(*command, str(problem), *channels, "--time-limit", "1e-9") == 4
    printed = capsys.readouterr()
    assert "not repeatable" in printed.out + printed.err


def test_effort_is_a_positive_number(problem, capsys):
    assert run("hinf", str(problem), "--measurements", "1", "--controls", "1", "--effort", "0") == 3
    assert "effort is 0" in capsys.readouterr().err
    assert run("hinf", str(problem), "--measurements", "1", "--controls", "1", "--effort", "0.5") == 0


def test_hinf_by_name_and_text(problem, capsys):
    assert run("hinf", str(problem), "--measurements", "y", "--controls", "u") == 0
    text = capsys.readouterr().out
    for word in ("gamma", "certified", "fastest controller pole", "rightmost pole", "what limits it"):
        assert word in text


def test_mixsyn_from_specifications_leaves_out_untouched_states_with_a_note(tmp_path, capsys):
    path = tmp_path / "motor.h5"
    G = rl.StateSpaceModel([[0, 1], [0, -10]], [[0], [10]], np.eye(2), np.zeros((2, 1)), outputs=["phi", "omega"])
    rl.save(path, G)
    arguments = ["--outputs", "omega", "--w1", "bandwidth=20,error=0.01", "--w2", "0.1", "--w3", "bandwidth=500"]
    assert run("mixsyn", str(path), *arguments, "--json") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["closed_loop_abscissa"] < 0
    assert "left out" in captured.err


def test_no_stabilising_controller_is_exit_code_4(tmp_path, capsys):
    path = tmp_path / "bad.h5"
    rl.save(path, rl.StateSpaceModel([[1.0]], [[1, 0]], [[1], [1]], np.eye(2)))
    assert run("hinf", str(path), "--measurements", "1", "--controls", "1") == 4
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "cannot be moved by the controls" in captured.err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["hinf", "P", "--measurements", "1"], 2, "channels"),
        (["hinf", "P", "--measurements", "1", "--controls", "1", "--controls", "u"], 2, "channels"),
        (["hinf", "P", "--measurements", "9", "--controls", "1"], 3, "n_meas"),
        (["hinf", "P", "--measurements", "yy", "--controls", "u"], 3, "did you mean"),
        (["hinf", "nowhere.h5", "--measurements", "1", "--controls", "1"], 3, "nowhere.h5"),
        (["mixsyn", "P", "--w1", "bandwith=1"], 2, "did you mean bandwidth"),
        (["mixsyn", "P", "--w1", "peak=2"], 2, "bandwidth is missing"),
        (["mixsyn", "P", "--w1", "bandwidth=fast"], 2, "a number in rad/s"),
        (["mixsyn", "P", "--w1", "bandwidth=-1"], 3, "positive"),
        (["mixsyn", "P"], 2, "no weight, expected at least one of W1, W2, W3"),
    ],
)
def test_wrong_calls(problem, capsys, arguments, code, text):
    assert run(*(str(problem) if a == "P" else a for a in arguments)) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert text in captured.err
