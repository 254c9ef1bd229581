"""``robustlab mu``."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.mu import app


def call(*arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def model_file(tmp_path):
    M = rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    path = tmp_path / "lag.h5"
    rl.save(path, rl.UncertainModel(M, [rl.RealScalar("pole", parameter=rl.ParameterRange(1.0, 0.2, "1/s"))]))
    return str(path)


def test_prints_margin_delta_and_parameter(model_file, capsys):
    assert call(model_file, "--intervals") == 0
    out = capsys.readouterr().out
    assert "certified" in out
    assert "pole   -5" in out
    assert "1/s" in out
    assert "proved intervals" in out


def test_json_is_one_object(model_file, capsys):
    assert call(model_file, "--json") == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "robustlab.result/1"
    assert data["command"] == "mu"
    assert data["upper"] == pytest.approx(5.0)
    assert data["lower"] == pytest.approx(5.0, rel=3e-3)


def test_result_file_and_figure(model_file, tmp_path, capsys):
    out, figure = tmp_path / "margin.h5", tmp_path / "margin.svg"
    assert call(model_file, "--out", str(out), "--figure", str(figure)) == 0
    capsys.readouterr()
    stored = rl.load(out)
    assert stored.type == "Margin"
    assert stored.status is rl.Status.CERTIFIED
    assert stored.data["upper"] == pytest.approx(5.0)
    assert figure.read_text(encoding="utf-8").lstrip().startswith("<?xml")


def test_no_time_ends_in_exit_code_4(model_file, capsys):
    assert call(model_file, "--time-limit", "1e-9") == 4
    captured = capsys.readouterr()
    assert "timeout" in captured.out
    assert "grid only" in captured.out
    assert "not repeatable" in captured.out
    assert call(model_file, "--effort", "1e-9") == 4
    assert "inconclusive" in (text := capsys.readouterr().out)
    assert "work budget used up; a larger effort may prove more" in text


def test_a_model_without_uncertainty_is_bad_input(tmp_path, capsys):
    path = tmp_path / "plain.h5"
    rl.save(path, rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert call(str(path)) == 3
    assert "an uncertain model" in capsys.readouterr().err


def test_unstable_nominal_is_exit_code_4(tmp_path, capsys):
    path = tmp_path / "unstable.h5"
    M = rl.StateSpaceModel([[1.2]], [[1.0]], [[1.0]], [[0.0]])
    rl.save(path, rl.UncertainModel(M, [rl.RealScalar("a")]))
    assert call(str(path)) == 4
    assert "nominal closed loop unstable (pole 1.2+0j)" in capsys.readouterr().err


def test_missing_file_is_exit_code_3(tmp_path, capsys):
    assert call(str(tmp_path / "absent.h5")) == 3
    assert "absent.h5" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", [["--accuracy", "0"], ["--time-limit", "-1"], ["--accuracy", "nan"], ["--effort", "0"]]
)
def test_options_out_of_range(model_file, option, capsys):
    assert call(model_file, *option) == 3
    assert {"--time-limit": "time_limit"}.get(option[0], option[0][2:]) in capsys.readouterr().err


def test_worst_gain_with_its_figure(model_file, tmp_path, capsys):
    """1 / (s + 1 + 0.2 delta): 1.25 at delta = -1."""
    assert call(model_file, "--gain", "--json", "--figure", str(tmp_path / "gain.svg")) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["type"] == "WorstCaseGain"
    assert data["lower"] == pytest.approx(1.25, rel=1e-9)
    assert data["upper"] == pytest.approx(1.25, rel=1e-3)
    assert data["physical"]["pole"][0] == pytest.approx(0.8)
    assert (tmp_path / "gain.png").stat().st_size > 5000
    assert call(model_file, "--gain") == 0
    text = capsys.readouterr().out
    assert text.startswith("WorstCaseGain (certified)\n")
    assert "largest gain" in text
    assert "1.25 (attained)" in text
    assert "pole   -1     0.8" in text


def test_performance_shares_and_replay(model_file, tmp_path, capsys):
    assert call(model_file, "--performance") == 0
    assert "robust performance margin" in capsys.readouterr().out
    assert call(model_file, "--figure", str(tmp_path / "m.svg")) == 0
    out = capsys.readouterr().out
    assert "tighten first" in out
    assert "pole: each percent of its range" in out
    assert {p.name for p in tmp_path.glob("*.png")} == {"m.png", "m-shares.png", "m-replay.png"}


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["--gain", "--performance"], "--gain and --performance"),
        (["--inputs", "u"], "with --gain or --performance or --level only"),
    ],
)
def test_options_that_do_not_go_together(model_file, capsys, arguments, found):
    assert call(model_file, *arguments) == 2
    assert found in capsys.readouterr().err


def test_a_destabilising_friction_below_zero_is_called_impossible(tmp_path, capsys):
    path = tmp_path / "motor.h5"
    rl.save(path, rl.plant("dc-motor", Kf=(4.8e-5, 0.35)).uncertain(outputs=["omega"]))
    assert call(str(path)) == 0
    assert "Kf = -0.00130" in (text := capsys.readouterr().out)
    assert "physically impossible (it is never negative)" in text
    assert call(str(path), "--json") == 0
    assert any("physically impossible" in note for note in json.loads(capsys.readouterr().out)["notes"])


def test_level_asks_how_much_of_the_set_keeps_it(model_file, capsys):
    """1 / (s + 1 + 0.2 delta): the gain of the set times k is 1 / (1 - 0.2 k), below 2 up to k = 2.5."""
    assert call(model_file, "--level", "2", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["lower"] <= 2.5 * (1 + 1e-6)
    assert told["upper"] >= 2.5 * (1 - 1e-6)
    assert call(model_file, "--level", "2") == 0
    assert "robust gain margin" in capsys.readouterr().out
    assert call(model_file, "--level", "2", "--gain") == 2
    assert call(model_file, "--level", "-4") == 3
