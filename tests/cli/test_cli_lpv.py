"""``robustlab lpv`` through the real command, and the steps of recipes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import shown_objects
from patience import PATIENCE

import robustlab as rl


def robustlab(*words: str, cwd=None) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "robustlab.cli.main", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, timeout=PATIENCE)


@pytest.fixture
def spring(tmp_path):
    ranges = {"k": (2.0, 1.6, 2.4)}
    rl.save(tmp_path / "spring.h5", rl.parametric([[0, 1], ["-k", -1.0]], [[0], [1]], [[1, 0]], [[0]], ranges))
    return tmp_path


def test_an_uncertain_model_is_built_and_bounded(spring):
    done = robustlab("lpv", "build", "spring.h5", "--points", "k=3", "--rate", "k=0.5", "--out", "lpv.h5", cwd=spring)
    assert done.returncode == 0, done.stderr
    model = rl.load(spring / "lpv.h5")
    assert model.parameters[0].points == (1.6, 2.0, 2.4)
    assert model.parameters[0].rate == 0.5
    done = robustlab("lpv", "gain", "lpv.h5", "--json", cwd=spring)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["status"] == "certified"
    assert told["upper"] == pytest.approx(rl.peak_gain(model).upper, rel=1e-6)


@pytest.mark.parametrize(
    ("points", "code", "text"),
    [
        (["k=nan"], 2, "no whole number"),
        (["k=2.5"], 2, "no whole number"),
        (["k=1"], 3, "2 or more"),
        (["k=3", "k=4"], 2, "'k' is given twice"),
    ],
)
def test_numbers_of_points_that_are_none(spring, points, code, text):
    done = robustlab("lpv", "build", "spring.h5", *(word for p in points for word in ("--points", p)), cwd=spring)
    assert done.returncode == code
    assert text in done.stderr


def test_a_gain_that_no_bound_has_ends_in_code_4_and_names_the_member(tmp_path):
    frozen = [rl.StateSpaceModel([[a]], [[1.0]], [[1.0]], [[0.0]]) for a in (-1.0, 0.5)]
    rl.save(tmp_path / "lpv.h5", rl.LPVModel({"a": [-1.0, 0.5]}, frozen))
    done = robustlab("lpv", "gain", "lpv.h5", cwd=tmp_path)
    assert done.returncode == 4
    assert "a = 0.5: pole 0.5+0j is unstable" in done.stdout + done.stderr


def test_a_controller_is_designed_stored_and_evaluated(tmp_path):
    rl.save(tmp_path / "plant.h5", shown_objects.scheduled_plant())
    done = robustlab("lpv", "hinf", "plant.h5", "--n-meas", "1", "--n-con", "1", "--out", "k.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "certified between the grid points" in done.stdout
    done = robustlab("lpv", "at", "k.h5", "a=-0.5", "--out", "frozen.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert rl.load(tmp_path / "frozen.h5").n_states == 1


def test_no_bound_is_exit_code_4_and_a_wrong_file_3(tmp_path):
    def oscillator(k):
        return rl.StateSpaceModel([[0, 1], [-2 - k, -1]], [[0], [1]], [[1, 0]], [[0]])

    rl.save(tmp_path / "wild.h5", rl.LPVModel({"k": [0.0, 9.0]}, [oscillator(0.0), oscillator(9.0)]))
    assert robustlab("lpv", "gain", "wild.h5", cwd=tmp_path).returncode == 4
    rl.save(tmp_path / "plain.h5", oscillator(0.0))
    done = robustlab("lpv", "gain", "plain.h5", cwd=tmp_path)
    assert done.returncode == 3
    assert "an LPV or an uncertain model" in done.stderr


def test_steps_of_a_recipe_prove_and_design(tmp_path):
    rl.save(tmp_path / "plant.h5", shown_objects.scheduled_plant())
    loop = shown_objects.scheduled().closed_loop
    rl.save(tmp_path / "loop.h5", loop)
    (tmp_path / "recipe.toml").write_text(
        """
schema = "robustlab.recipe/1"
name = "scheduled"

[step.plant]
do = "load"
path = "plant.h5"

[step.loop]
do = "load"
path = "loop.h5"

[step.gain]
do = "lpv-gain"
of = "loop"

[step.law]
do = "lpv-hinf"
of = "plant"
measurements = 1
controls = 1

[[require]]
text = "The scheduled loop"
that = "law.gamma"
at_most = 1.45

[[require]]
text = "The loop by itself"
that = "gain.upper"
at_most = 1.45
"""
    )
    done = robustlab("run", "recipe.toml", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "out" / "evidence" / "law.h5").exists()
