"""Frequency-response data and given frequencies, from the shell: files, `mu`, margins, a recipe."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main
from robustlab.cli.ending import main_guard

OMEGA = np.array([0.5, 1.0, 4.0])
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
G = rl.frequency_response(LAG, OMEGA)[:, 0, 0]


@pytest.fixture
def run(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    data = rl.frequency_data(G, OMEGA, radius=0.1 * abs(G), inputs=["u"], outputs=["y"])
    rl.save("data.h5", data)
    rl.save("loop.h5", data.feedback(3.0))
    rl.save("set.h5", rl.unstructured(LAG, 0.1, "output-multiplicative").feedback(3.0))

    def call(*arguments, code=0):
        assert main_guard(lambda: main.run(list(arguments))) == code
        out, err = capfd.readouterr()
        return out if code == 0 else err

    return call


def test_mu_of_data_says_where_it_holds(run):
    told = run("mu", "loop.h5")
    assert "at the 3 given frequencies only; nothing is claimed between them" in told
    assert "taken for granted" in told
    found = json.loads(run("mu", "loop.h5", "--json"))
    expected = abs(1 + 3 * G) / (0.3 * abs(G))
    assert found["lower"] == pytest.approx(expected.tolist(), rel=1e-6)
    gain = json.loads(run("mu", "loop.h5", "--gain", "--json"))
    assert gain["upper"][0] > abs(G[0] / (1 + 3 * G[0]))
    run("mu", "loop.h5", "--figure", "margin", "--out", "margin.h5")
    assert rl.load("margin.h5").status is rl.Status.CERTIFIED


def test_a_set_at_given_frequencies(run):
    found = json.loads(run("mu", "set.h5", "--frequency", "0.5,1,4", "--json"))
    assert found["lower"] == pytest.approx((abs(1 + 3 * G) / (0.3 * abs(G))).tolist(), rel=1e-6)
    assert "--certify" in run("mu", "set.h5", "--frequency", "1", "--certify", code=2)
    assert "numbers" in run("mu", "set.h5", "--frequency", "one", code=2)


def test_margins_of_data(run):
    found = json.loads(run("model", "show", "data.h5", "--json"))
    assert found["kind"] == "frequency-data"
    rl.save("plain.h5", rl.frequency_data(3.0 * G, OMEGA))
    told = json.loads(run("model", "margins", "plain.h5", "--json"))
    S = 1 / (1 + 3 * G)
    assert told["simultaneous"]["lower"] == pytest.approx((1 / abs(S - 0.5)).tolist(), rel=1e-6)


def test_a_recipe_bounds_measured_data(run, tmp_path):
    rl.save("k.h5", rl.StateSpaceModel([], [], [], [[3.0]], inputs=["y"], outputs=["u"]))
    text = f"""schema = "robustlab.recipe/1"
name = "measured"

[step.data]
do = "load"
path = "{tmp_path}/data.h5"

[step.k]
do = "load"
path = "{tmp_path}/k.h5"

[step.margin]
do = "robustness-at"
of = "data"
controller = "k"

[[require]]
text = "Every measured frequency keeps a margin"
that = "margin.lower"
at_least = 10.0
"""
    (tmp_path / "r.toml").write_text(text)
    command = [sys.executable, "-m", "robustlab.cli.main", "run", "r.toml", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "nothing is claimed between them" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
