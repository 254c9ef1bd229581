"""``robustlab model`` on good files; bad ones are in tests/faults."""

import json

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.model import app


@pytest.fixture
def run(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments, code=0):
        assert main_guard(lambda: app(list(arguments), standalone_mode=False)) == code
        out, err = capfd.readouterr()
        return out if code == 0 else err

    return call


def test_build_show_check_diff_convert(run):
    run("build", "dc-motor", "--out", "m.h5")
    run("build", "dc-motor", "--set", "R=4.14", "--out", "n.h5")
    assert "inputs: u [V]" in run("show", "m.h5")
    assert "content hash verified" in run("show", "m.h5")
    text = run("check", "m.h5")
    assert "controllable: rank 3 of 3" in text
    lines = run("diff", "m.h5", "n.h5").splitlines()
    assert [line.split("  ")[0] for line in lines if "[" in line] == ["A[i, i]"]
    assert "1 of 24 entries" in lines[1]
    assert "0 of 24 entries" in run("diff", "m.h5", "m.h5")
    run("convert", "m.h5", "m.mat")
    run("convert", "m.mat", "back.h5")
    assert "0 of 24 entries" in run("diff", "m.h5", "back.h5", "--rtol", "0")


def test_doubled_resistance_doubles_its_entry(run):
    """A[i, i] = -R / L."""
    for name, value in (("m.h5", "2"), ("n.h5", "4")):
        run("build", "dc-motor", "--set", f"R={value}", "--out", name)
    found = json.loads(run("diff", "m.h5", "n.h5", "--json"))
    assert found["command"] == "model diff"
    (change,) = found["changes"]
    assert change["second"] == pytest.approx(2 * change["first"], rel=1e-12)


def test_check_tells_unstable_and_hidden_modes(run):
    rl.save("p.h5", rl.StateSpaceModel(np.diag([1.0, -2.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]]))
    found = json.loads(run("check", "p.h5", "--json"))
    assert not found["stable"]
    assert found["spectral_abscissa"] == 1.0
    assert found["controllability"]["rank"] == 1
    assert "NOT stable" in run("check", "p.h5")


def test_pair_files(run):
    with h5py.File("p.h5", "w") as file:
        for group, pole in (("nominal", -1.0), ("perturbed", -2.0)):
            for name, value in zip("ABCD", (pole, 1.0, 1.0, 0.0), strict=True):
                file[f"{group}/{name}"] = [[value]]
    assert "perturbed: StateSpaceModel" in run("show", "p.h5")
    assert "1 of 4 entries" in run("diff", "p.h5")
    assert "--group nominal" in run("convert", "p.h5", "q.h5", code=2)
    run("convert", "p.h5", "q.h5", "--group", "perturbed")
    assert rl.load("q.h5").A[0, 0] == -2.0


def test_show_json_carries_the_model(run):
    run("build", "servo-axis", "--out", "m.h5")
    found = json.loads(run("show", "m.h5", "--json"))
    assert (found["schema"], found["kind"], found["verified"]) == ("robustlab.result/1", "state-space", True)
    assert np.array(found["content"]["A"]).shape == (2, 2)
    assert found["provenance"]["created_by"] == "model build"


def test_usage(run):
    assert "NAME=VALUE" in run("build", "dc-motor", "--set", "R:2", "--out", "m.h5", code=2)
    assert "did you mean dc-motor?" in run("build", "dc-moter", "--out", "m.h5", code=3)
    run("build", "dc-motor", "--out", "m.h5")
    assert "extension" in run("convert", "m.h5", "m.txt", code=2)
    assert "no such folder" in run("convert", "m.h5", "nowhere/m.h5", code=5)


def test_build_a_platform_at_a_pose(run):
    """Gravity pulls harder on a nut where the legs lean more: the unstable poles grow as the platform goes down."""
    run("build", "stewart-platform", "--set", "preset=physical", "--out", "home.h5")
    run("build", "stewart-platform", "--set", "preset=physical", "--pose", "0,0,0.1062,0,0,0", "--out", "low.h5")
    home, low = rl.load("home.h5"), rl.load("low.h5")
    assert low.spectral_abscissa() > home.spectral_abscissa() > 0
    assert home.n_states == 12
    assert "6 numbers" in run("build", "stewart-platform", "--pose", "0,0,0.1", "--out", "x.h5", code=2)
    run("build", "stewart-platform", "--pose", "0,0,9,0,0,0", "--out", "x.h5", code=3)
    run("build", "stewart-platform", "--set", "preset=nosuch", "--out", "x.h5", code=3)


def test_c_code_with_limits_says_signs_and_how_it_recovers(run, tmp_path):
    K = rl.StateSpaceModel([[1.0]], [[0.01]], [[4.0]], [[2.0]], 0.01, [("e q", "m")], [("u", "V")])
    rl.save("k.h5", rl.Controller(K.renamed([("q", "m")]), takes="r - y"))
    run("convert", "k.h5", "k.c", "--saturation", "u=-12:12", "--anti-windup", "0.05")
    text = (tmp_path / "k.c").read_text()
    for words in ("(q wanted) - (q measured)", "[m]", "held in [-12.0, 12.0]", "exp(-t / 0.05 s)"):
        assert words in text
    assert "saturation" in run("convert", "k.h5", "other.c", "--anti-windup", "0.05", code=2)
