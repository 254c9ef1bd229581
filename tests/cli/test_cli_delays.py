"""Delays on the command line: exact ones into a file and out of it, what is checked, covered and drawn."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main
from robustlab.cli.ending import main_guard

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("y", "m")])
OMEGA = np.geomspace(0.01, 100, 50)


@pytest.fixture
def run(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    rl.save("lag.h5", LAG)

    def call(*arguments, code=0):
        assert main_guard(lambda: main.run(list(arguments))) == code
        out, err = capfd.readouterr()
        return out if code == 0 else err

    call.folder = tmp_path
    return call


def test_a_delayed_model_goes_into_a_file_and_comes_back(run):
    said = run("model", "delay", "lag.h5", "--input", "u=0.01", "--output", "y=0.02s", "--out", "late.h5")
    assert "0.01 s, 0.02 s" in said
    late = rl.load(run.folder / "late.h5")
    assert isinstance(late, rl.DelayedModel)
    assert late.delays.tolist() == [0.01, 0.02]
    assert late.inputs == LAG.inputs
    expected = rl.frequency_response(LAG, OMEGA)[:, 0, 0] * np.exp(-0.03j * OMEGA)
    assert np.abs(rl.frequency_response(late, OMEGA)[:, 0, 0] - expected).max() < 1e-14
    shown = run("model", "show", "late.h5")
    assert "delayed, content hash verified" in shown
    assert "delays: 0.01, 0.02 s" in shown
    run("model", "plot", "late.h5", "--kind", "step", "--figure", "late-step")
    assert (run.folder / "late-step.svg").exists()


def test_check_proves_or_refutes(run):
    for gain, word in ((1.5, "yes: proved on the whole axis"), (3.0, "no: proved by a root")):
        loop = (gain * LAG @ rl.delay(1.0)).feedback()  # the limit is 2.26
        rl.save(run.folder / "loop.h5", loop)
        assert word in run("model", "check", "loop.h5")
    found = json.loads(run("model", "check", "loop.h5", "--json"))
    assert found["stable"] is False
    assert found["root"]["re"] > 0
    through = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]])).feedback(
        0.6 * rl.delay(1.0) + 0.5 * rl.delay(2.0)
    )
    rl.save(run.folder / "echo.h5", through)
    run("model", "check", "echo.h5", code=4)


def test_margins_of_a_loop_with_its_delay(run):
    rl.save("loop.h5", 2.0 * LAG @ rl.delay(0.5))
    found = json.loads(run("model", "margins", "loop.h5", "--json"))
    expected = rl.disk_margin(2.0 * LAG @ rl.delay(0.5))
    assert found["lower"] == pytest.approx(expected.lower)
    assert "disk margin" in run("model", "margins", "loop.h5")


def test_a_set_that_holds_the_delays(run):
    run("uncertain", "delays", "lag.h5", "--input", "u=0.1:0.3", "--output", "y=0.2", "--out", "set.h5")
    found = rl.load(run.folder / "set.h5")
    expected = rl.with_delays(LAG, {"u": (0.1, 0.3)}, {"y": 0.2})
    assert [b.name for b in found.blocks] == [b.name for b in expected.blocks]
    assert np.abs(found.M.A - expected.M.A).max() == 0.0


def test_rational_delays_and_weights(run):
    run("model", "delay", "lag.h5", "--input", "u=0.5", "--pade", "4", "--out", "rational.h5")
    assert rl.load(run.folder / "rational.h5").n_states == 5
    run("uncertain", "neglected", "--delay", "0.2", "--order", "3", "--out", "w.h5")
    assert np.array_equal(rl.load(run.folder / "w.h5").A, rl.neglected_dynamics(delay=0.2, order=3).A)
    assert "1 states" in run("uncertain", "neglected", "--lag", "0.2")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("model", "delay", "lag.h5", "--input", "v=1"), 3, "one of u"),
        (("model", "delay", "lag.h5", "--input", "u=-1"), 3, "0 s or more"),
        (("model", "delay", "lag.h5", "--input", "1"), 2, "NAME=VALUE"),
        (("uncertain", "neglected"), 2, "one of them"),
        (("uncertain", "neglected", "--delay", "1", "--order", "2"), 3, "1 or 3"),
        (("uncertain", "delays", "lag.h5", "--input", "u=0.3:0.1"), 3, "range"),
    ],
)
def test_what_is_wrong_is_said(run, arguments, code, said):
    assert said in run(*arguments, code=code)


def test_a_file_with_a_delay_that_is_none_is_refused(run):
    import h5py

    run("model", "delay", "lag.h5", "--input", "u=0.01", "--out", "late.h5")
    with h5py.File(run.folder / "late.h5", "r+") as file:
        file["delays"][0] = -1.0
    assert "content" in run("model", "show", "late.h5", code=3)
    assert "0 s or more" in run("model", "show", "late.h5", "--no-verify", code=3)
    with h5py.File(run.folder / "late.h5", "r+") as file:
        del file["delays"]
    assert "missing /delays" in run("model", "show", "late.h5", "--no-verify", code=3)


def test_margins_of_several_loops_with_delays(run):
    plant = rl.StateSpaceModel(-np.diag([1.0, 2.0]), [[1, 0.3], [-0.2, 1]], np.eye(2), np.zeros((2, 2)))
    rl.save("late.h5", rl.with_delays(plant, inputs={0: 0.3, 1: 0.1}))
    rl.save("k.h5", rl.StateSpaceModel([], [], [], 2.0 * np.eye(2)))
    found = json.loads(run("model", "margins", "late.h5", "-k", "k.h5", "--json"))
    expected = rl.disk_margin(rl.load("late.h5"), rl.load("k.h5"))
    assert found["simultaneous"]["lower"] == pytest.approx(expected.simultaneous.lower)
    classical = json.loads(run("model", "margins", "late.h5", "-k", "k.h5", "--classical", "--json"))
    single = rl.classical_margins(rl.load("late.h5"), rl.load("k.h5")).channels["y1"]
    assert classical["channels"]["y1"]["phase_margin"] == pytest.approx(single.phase_margin)
    at = json.loads(run("model", "margins", "late.h5", "-k", "k.h5", "--frequency", "1,3", "--json"))
    assert len(at["simultaneous"]["lower_at"]) == 2


def test_a_late_model_is_discretised_exactly(run):
    run("model", "delay", "lag.h5", "--input", "u=0.25", "--out", "late.h5")
    run("model", "discretise", "late.h5", "--dt", "0.1", "--method", "zoh", "--out", "digital.h5")
    t = np.arange(30) * 0.1
    u = np.sin(7 * t)
    exact = rl.simulate(rl.load("late.h5"), t, u)["y"]
    assert np.abs(rl.simulate(rl.load("digital.h5"), t, u)["y"] - exact).max() < 1e-14
    assert "zoh" in run("model", "discretise", "late.h5", "--dt", "0.1", code=3)
