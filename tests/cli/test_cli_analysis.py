"""``mu``, ``model margins`` and ``worst-case``: exit codes, keys, files."""

import pytest
from command_files import write_models
from shell import robustlab

import robustlab as rl


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


def test_a_margin_as_json_file_and_figures(folder):
    found = robustlab("mu", "pole.h5", "--json", "--out", "m.h5", "--figure", "m.svg", code=0).json
    assert (found["schema"], found["command"]) == ("robustlab.result/1", "mu")
    assert found["upper"] == pytest.approx(5.0)
    stored = rl.load("m.h5")
    assert (stored.type, stored.status) == ("Margin", rl.Status.CERTIFIED)
    assert stored.data["upper"] == found["upper"]
    assert (folder / "m.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
    assert {p.name for p in folder.glob("*.png")} == {"m.png", "m-shares.png", "m-replay.png"}


@pytest.mark.parametrize("limit", ["--time-limit", "--effort"])
def test_no_time_ends_in_exit_code_4(limit):
    out = robustlab("mu", "pole.h5", limit, "1e-9", code=4).out
    assert ("not repeatable" in out) == (limit == "--time-limit")
    assert ("timeout" if limit == "--time-limit" else "inconclusive") in out


def test_worst_gain_with_its_figure(folder):
    """1 / (s + 1 + 0.2 delta): 1.25 at delta = -1."""
    found = robustlab("worst-gain", "pole.h5", "--json", "--figure", "gain.svg", code=0).json
    assert (found["type"], found["lower"]) == ("WorstCaseGain", pytest.approx(1.25, rel=1e-9))
    assert (folder / "gain.png").stat().st_size > 5000


def test_a_destabilising_friction_below_zero_is_called_impossible():
    notes = robustlab("mu", "speed.h5", "--json", code=0).json["notes"]
    assert any("physically impossible (it is never negative)" in note for note in notes)


def test_margins_as_json_and_files():
    found = robustlab("model", "margins", "lag.h5", "--json", "--out", "m.h5", code=0).json
    assert (found["schema"], found["command"]) == ("robustlab.result/1", "model margins")
    assert rl.load("m.h5").type == "DiskMargins"


def test_a_stored_controller_is_positive_feedback():
    """The gain that closes the loop by u = -K y, stored as the controller -K."""
    rl.save("controller.h5", rl.Controller(rl.StateSpaceModel([], [], [], -rl.load("gain.h5").D)))
    words = ("model", "margins", "two-by-two.h5", "--json", "--controller")
    found = robustlab(*words, "controller.h5", code=0).json
    plain = robustlab(*words, "gain.h5", code=0).json
    assert found["feedback"] == "positive"
    assert found["simultaneous"]["upper"] == pytest.approx(plain["simultaneous"]["upper"], rel=1e-6)
    robustlab(*words, "controller.h5", "--feedback", "negative", code=4)


def test_classical_margins():
    rl.save("L.h5", rl.StateSpaceModel([[0, 1, 0], [0, 0, 1], [0, -2, -3]], [[0], [0], [1]], [[3, 0, 0]], [[0]]))
    found = robustlab("model", "classical-margins", "L.h5", "--json", code=0).json
    assert found["channels"]["y1"]["gain_margin"][1] == pytest.approx(2)
    assert "unstable" in robustlab("model", "classical-margins", "unstable.h5", "--feedback", "positive").out


def test_worst_case_as_json_and_file():
    words = ("worst-case", "speed.h5", "--metric", "hinf", "--out", "w.h5", "--json")
    found = robustlab(*words, code=0).json
    assert found["status"] == "converged"
    assert found["delta"]["Kf"] == -1.0
    assert rl.load("w.h5").data["value"] == found["value"]
    assert "not repeatable" in robustlab("worst-case", "speed.h5", "--metric", "hinf", "--time-limit", "0", code=4).out


@pytest.mark.parametrize("metric", ["rms", "settling-time", "h2", "damping"])
def test_other_metrics(metric):
    words = ("worst-case", "speed.h5", "--metric", metric, "--inputs", "u", "--t-end", "0.1", "-n", "8")
    assert robustlab(*words, code=0).out.splitlines()[1].startswith(f"  {metric} ")


def test_probability_of_a_violation(folder):
    robustlab("uncertain", "plant", "dc-motor", "--tolerance", "Kf=0.35", "--out", "kf.h5", code=0)
    drive = ("--outputs", "omega", "--input-value", "u=42", "--t-end", "0.1", "--seed", "3")
    written = ("-n", "500", "--figure", "f/", "--out", "p.h5", "--json")
    found = robustlab("violation-probability", "kf.h5", "--limit", "9.3 rad/s", *written, *drive, code=0).json
    assert found["lower"] < found["probability"] < found["upper"] < 0.1
    assert len(list((folder / "f").iterdir())) == 4
    assert rl.load("p.h5").data["violations"] == found["violations"]
    robustlab("violation-probability", "kf.h5", "--limit", "12", "--probability", "0.05", *drive, code=0)
    robustlab("violation-probability", "kf.h5", "--limit", "2 rad/s", "--probability", "0.05", *drive, code=1)
