"""``robustlab model margins`` and ``robustlab model gap``, through the command."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.model import app


@pytest.fixture
def run(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    P = rl.StateSpaceModel([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)), outputs=["p", "q"])
    gain = rl.StateSpaceModel([], [], [], [[1, -2], [0, 1]])
    rl.save("P.h5", P)
    rl.save("K.h5", gain)
    rl.save("controller.h5", rl.Controller(rl.StateSpaceModel([], [], [], -gain.D)))
    rl.save("lag.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[2.0]], [[0.0]]))
    rl.save("fast.h5", rl.StateSpaceModel([[-1.2]], [[1.0]], [[2.0]], [[0.0]]))
    rl.save("unstable.h5", rl.StateSpaceModel([[3.0]], [[1.0]], [[2.0]], [[0.0]]))
    rl.save("sampled.h5", rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    M = rl.StateSpaceModel([[-1, 0], [1, -0.5]], [[-0.3, 1], [0, 0]], [[1, 0], [0, 4]], np.zeros((2, 2)))
    rl.save("uncertain.h5", rl.UncertainModel(M, [rl.RealScalar("pole", parameter=rl.ParameterRange(1.0, 0.3, "1/s"))]))

    def call(*arguments, code=0):
        assert main_guard(lambda: app(list(arguments), standalone_mode=False)) == code
        out, err = capfd.readouterr()
        return out if code == 0 else err

    return call


def test_margins_as_text(run):
    text = run("margins", "P.h5", "--controller", "K.h5")
    assert "the plant's outputs" in text
    assert "u = -K y" in text
    assert "all at once" in text
    assert "0.6834 .. 1.463" in text
    assert "certified" in text


def test_margins_as_json_and_file(run):
    data = json.loads(run("margins", "lag.h5", "--json", "--out", "m.h5"))
    assert data["schema"] == "robustlab.result/1"
    assert data["command"] == "model margins"
    assert data["simultaneous"]["upper"] == pytest.approx(2.0)
    assert rl.load("m.h5").type == "DiskMargins"


def test_a_stored_controller_is_positive_feedback(run):
    text = run("margins", "P.h5", "--controller", "controller.h5")
    assert "u = K y" in text
    assert "0.6834 .. 1.463" in text
    assert "unstable" in run("margins", "P.h5", "--controller", "controller.h5", "--feedback", "negative", code=4)


def test_an_uncertain_plant_gives_its_worst_member(run):
    text = run("margins", "uncertain.h5", "--out", "w.h5")
    assert "worst-case disk margin" in text
    assert "1/s" in text
    stored = rl.load("w.h5")
    assert stored.type == "WorstCaseDiskMargin"
    assert 0 < stored.data["lower"] <= stored.data["upper"] <= stored.data["nominal"]["upper"]


def test_bad_inputs_and_exit_codes(run):
    assert "nominal closed loop unstable" in run("margins", "unstable.h5", code=4)
    assert "one of input, output, both" in run("margins", "lag.h5", "--at", "here", code=2)
    assert "negative or positive" in run("margins", "lag.h5", "--feedback", "minus", code=2)
    assert "1 x 1" in run("margins", "lag.h5", "-k", "K.h5", code=3)


def test_the_real_command(tmp_path):
    rl.save(tmp_path / "a.h5", rl.StateSpaceModel([[0.001]], [[1.0]], [[1.0]], [[0.0]]))
    rl.save(tmp_path / "b.h5", rl.StateSpaceModel([[-0.001]], [[1.0]], [[1.0]], [[0.0]]))
    words = [sys.executable, "-m", "robustlab.cli.main", "model", "diff", "a.h5", "b.h5"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "0.001" in done.stdout


def test_classical_margins_print_every_crossing(run):
    rl.save("L.h5", rl.StateSpaceModel([[0, 1, 0], [0, 0, 1], [0, -2, -3]], [[0], [0], [1]], [[3, 0, 0]], [[0]]))
    out = run("margins", "L.h5", "--classical")
    assert "0.3608 s" in out
    assert "1.41421 rad/s" in out
    told = json.loads(run("margins", "L.h5", "--classical", "--json"))
    assert told["channels"]["y1"]["gain_margin"][1] == pytest.approx(2)
    assert "unstable" in run("margins", "unstable.h5", "--classical", "--feedback", "positive")
    assert "--classical" in run("margins", "uncertain.h5", "--classical", code=2)
