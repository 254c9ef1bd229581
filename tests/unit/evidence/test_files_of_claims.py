"""Claims in files, as JSON, on the command line and in recipes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.verify import app
from robustlab.recipe.load import load_recipe
from robustlab.recipe.run import run_recipe
from robustlab.verification.reading import claims_in_file

OSCILLATOR = rl.tf([1.0], [1.0, 0.2, 1.0])


def call(*arguments: str) -> int:
    return main_guard(lambda: app(list(arguments), standalone_mode=False))


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "norm.h5"
    rl.save(path, rl.peak_gain(OSCILLATOR))
    return path


def test_a_file_says_what_the_result_says(saved):
    claims = claims_in_file(saved)
    assert [c.kind for c in claims] == ["norm"]
    assert (claims[0].numbers["A"] == OSCILLATOR.A).all()
    assert rl.verify(saved).proved
    assert rl.verify(str(saved)).claims[0].bound == pytest.approx(rl.peak_gain(OSCILLATOR).upper, rel=2e-6)


def test_exit_codes(saved, tmp_path, capsys):
    assert call(str(saved)) == 0
    assert "proved independently" in capsys.readouterr().out
    with h5py.File(saved, "r+") as file:
        gamma = file["claims/0/gamma"]
        gamma[...] = 0.99 * gamma[()]
        del file.attrs["content_sha256"]
    assert call(str(saved)) == 1  # a frequency with a larger gain refutes it
    assert "REFUTED" in capsys.readouterr().out
    with h5py.File(saved, "r+") as file:
        del file["claims/0/B"]
    assert call(str(saved)) == 4
    assert "missing" in capsys.readouterr().out
    rl.save(tmp_path / "zeros.h5", rl.zeros(OSCILLATOR))
    assert call(str(tmp_path / "zeros.h5")) == 3
    assert "no claims" in capsys.readouterr().err
    assert call(str(tmp_path / "nowhere.h5")) == 3


def test_json_says_each_claim(saved, capsys):
    assert call(str(saved), "--json") == 0
    (told,) = json.loads(capsys.readouterr().out)["files"].values()
    assert told["proved"] is True
    assert told["claims"][0]["outcome"] == "proved"


def test_numbers_are_exported_to_the_bit(saved, tmp_path):
    target = tmp_path / "claims.json"
    assert call(str(saved), "--export", str(target)) == 0
    data = json.loads(target.read_text())
    assert data["schema"] == "robustlab.claims/1"
    A = data["claims"][0]["numbers"]["A"]
    values = np.array([float.fromhex(x) for x in A["real"]]).reshape(A["shape"])
    assert (values == OSCILLATOR.A).all()


def test_the_second_checker_agrees(saved, tmp_path):
    target = tmp_path / "claims.json"
    assert call(str(saved), "--export", str(target)) == 0
    program = Path(__file__).parents[3] / "examples" / "check_norm.py"
    assert len(program.read_text().splitlines()) <= 60
    told = subprocess.run([sys.executable, str(program), str(target)], capture_output=True, text=True, check=True)
    assert told.stdout.startswith("proved")
    data = json.loads(target.read_text())
    gamma = data["claims"][0]["numbers"]["gamma"]
    gamma["real"] = [(0.999 * float.fromhex(gamma["real"][0])).hex()]
    target.write_text(json.dumps(data))
    told = subprocess.run([sys.executable, str(program), str(target)], capture_output=True, text=True, check=False)
    assert told.returncode == 1
    assert told.stdout.startswith("not proved")


RECIPE = """
schema = "robustlab.recipe/1"
name = "small"
verify = true

[step.lag]
do = "load"
path = "lag.h5"

[step.margin]
do = "robust-stability"
of = "lag"

[[require]]
that = "margin.verified"
equals = true
text = "The margin is proved independently"
"""


def test_a_recipe_verifies_what_it_wrote(tmp_path):
    M = rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    rl.save(tmp_path / "lag.h5", rl.UncertainModel(M, [rl.RealScalar("pole")]))
    (tmp_path / "small.toml").write_text(RECIPE)
    run_recipe(load_recipe(tmp_path / "small.toml"), tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["exit_code"] == 0
    margin = next(s for s in result["steps"] if s["name"] == "margin")
    assert margin["numbers"]["verified"] is True
    assert any(f["label"] == "Proved independently" for f in margin["facts"])
    assert call(str(tmp_path / "out")) == 0
