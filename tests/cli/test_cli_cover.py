"""``uncertain build --cover``, ``--discovery`` and ``model convert`` to C, JSON: what they print, write and return."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.model import app as model_app
from robustlab.cli.uncertain import app as uncertain_app


@pytest.fixture
def call(capsys):
    groups = {"uncertain": uncertain_app, "model": model_app}

    def run(group, *arguments):
        code = main_guard(lambda: groups[group](args=list(map(str, arguments)), standalone_mode=False))
        done = capsys.readouterr()
        return code, done.out, done.err

    return run


@pytest.fixture
def lags(tmp_path):
    files = []
    for i, (gain, time) in enumerate([(1.0, 1.0), (1.2, 1.3), (0.9, 0.8)]):
        files += ["--cover", str(tmp_path / f"unit{i}.h5")]
        rl.save(files[-1], rl.StateSpaceModel([[-1 / time]], [[gain / time]], [[1.0]], [[0.0]]))
    return files


def test_a_cover_is_built_and_stored(call, lags, tmp_path):
    out = tmp_path / "cover.h5"
    code, text, _ = call("uncertain", "build", *lags, "--form", "pca", "--out", out)
    assert code == 0
    assert "pca cover of 3 models around the middle" in text
    assert "ratio at most" in text
    assert [b.name for b in rl.load(out).blocks] == ["direction1", "direction2"]


def test_a_cover_in_json_with_its_evidence(call, lags, tmp_path):
    k = tmp_path / "k.h5"
    rl.save(k, rl.Controller(rl.StateSpaceModel([], [], [], [[-2.0]])))
    code, text, _ = call("uncertain", "build", *lags, "--form", "additive", "--controller", k, "--json")
    data = json.loads(text)
    assert code == 0
    assert data["status"] == "certified"
    assert max(data["sizes"]) <= 1
    assert data["fit"]["order"] <= 4
    assert data["fit"]["lowest"] >= 0
    assert 1 <= data["conservatism"]["ratio"] < 1.5


def test_a_controller_that_does_not_say_its_sign_is_asked_about_and_can_be_told(call, lags, tmp_path):
    """The way out that the error names was no option of this command."""
    k = tmp_path / "k.h5"
    rl.save(k, rl.StateSpaceModel([], [], [], [[0.3]]))
    words = ("uncertain", "build", *lags, "--form", "additive", "--controller", k)
    code, _, err = call(*words)
    assert (code, "both signs leave the loop stable" in err) == (3, True)
    code, text, _ = call(*words, "--feedback", "negative")
    assert (code, text.splitlines()[0]) == (0, "loop  u = -K y, as asked")
    assert call("uncertain", "build", *lags, "--feedback", "negative")[0] == 2


def test_bad_covers(call, lags):
    assert call("uncertain", "build", *lags[:2])[0] == 3
    code, _, err = call("uncertain", "build", *lags, "--form", "pcb")
    assert code == 2
    assert "did you mean pca" in err
    code, _, err = call("uncertain", "build", *lags, "--form", "inverse-additive")
    assert code == 4
    assert "still grows" in err
    code, _, err = call("uncertain", "build", *lags, "--plant", "dc-motor")
    assert code == 2
    assert "one of them" in err


def test_an_updated_plant_becomes_blocks(call, tmp_path):
    folder = tmp_path / "found"
    folder.mkdir()
    plant = rl.with_effects(
        rl.plant("servo-axis", M=(95.0, 0.1)),
        {"coulomb-friction": {"Fc": (20.0, 1.0)}, "quantisation@q": {"lsb": 1e-4}},
    )
    rl.save(folder / "updated-plant.h5", plant)
    out = tmp_path / "u.h5"
    code, text, _ = call("uncertain", "build", "--discovery", folder, "--amplitude", "v=0.05", "--out", out)
    assert code == 0
    assert "coulomb-friction@v: Coulomb (dry) friction at v as a sector" in text
    assert "at most 5e-05 m" in next(line for line in text.splitlines() if "input noise q: quantisation" in line)
    assert "coulomb-friction@v: Coulomb" in call("uncertain", "show", out)[1]
    code, _, err = call("uncertain", "build", "--discovery", folder, "--dry", "gain")
    assert code == 2
    assert "--amplitude" in err
    assert call("uncertain", "build", "--discovery", tmp_path / "nothing")[0] == 3


def test_a_controller_as_c_and_json(call, tmp_path):
    k = tmp_path / "k.h5"
    model = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[-2.0]], 0.01, [("q", "m")], [("u", "V")])
    rl.save(k, rl.Controller(model, 1.1, rl.Status.CERTIFIED, "hinf"))
    c = tmp_path / "axis.c"
    code, text, _ = call("model", "convert", k, c, "--prefix", "axis", "--saturation", "u=-12:12")
    assert code == 0
    assert "axis.c" in text
    source = c.read_text()
    assert "u [V], held in [-12.0, 12.0]" in source
    assert "hinf" in source
    assert "sha256" in source
    assert call("model", "convert", k, tmp_path / "k.mat")[0] == 0
    assert rl.load(tmp_path / "k.mat").D.tolist() == [[-2.0]]
    rl.save(k, rl.Controller(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], np.zeros((1, 1)))))
    code, _, err = call("model", "convert", k, c)
    assert code == 3
    assert "discretise" in err
    assert c.read_text() == source  # the previous file is kept
