"""The redesign on an updated machine, by the real command: a saved plant with friction, its loads, the referee."""

import json
from pathlib import Path

import pytest
from shell import robustlab

import robustlab as rl

ROOT = Path(__file__).parents[2]

RECIPE = """
schema = "robustlab.recipe/1"
name = "redesign"
[step.updated]
do = "load"
path = "updated.h5"
[step.set]
do = "cover-models"
of = "updated"
poses = [[0.0, 0.0, 0.1262, 0.0, 0.0, 0.0], [0.0, 0.0, 0.1112, 0.0, 0.0, 0.0]]
form = "pca"
tolerance = 1e-3
conservatism = false
[step.task]
do = "tracking-problem"
of = "set"
controlled = ["phi_*"]
measured = ["phi_*"]
W1 = { error = 0.05, corner = 1.0, steady = 0.01 }
W2 = { limit = 0.0977, bandwidth = 1000.0, roll_off = 10.0 }
reference = 0.3927
reference_bandwidth = 3.14159265
disturbance = 1e-3
loads = { "load *" = 1.0 }
noise = { "*_ref" = 1e-5, "phi_*" = 3e-4 }
[step.K]
do = "hinf"
of = "task"
gamma_rel = 1.1
[step.referee]
do = "follow-trajectory"
of = "updated"
at = [0.0, 0.0, 0.1122, 0.0, 0.0, 0.0]
controllers = ["K"]
scale = 0.05
rise_time = 0.3
t_end = 2.6
after = 2.3
points = 261
[[require]]
text = "follows"
that = "referee.controllers.K.worst_error"
at_most = 0.02
"""


@pytest.fixture(scope="module")
def rough():
    machine = rl.plant("stewart-platform", preset="physical", platform_mass=10.0)
    return rl.with_effects(machine, {"coulomb-friction@phidot_6": {"Fc": (0.05, 1e-3)}})


@pytest.mark.slow
def test_a_saved_machine_with_friction_is_designed_for_and_followed(tmp_path, rough):
    rl.save(tmp_path / "updated.h5", rough)
    (tmp_path / "redesign.toml").write_text(RECIPE, encoding="utf-8")
    robustlab("run", tmp_path / "redesign.toml", "--out", tmp_path / "out", code=0)
    steps = {s["name"]: s for s in json.loads((tmp_path / "out" / "result.json").read_text())["steps"]}
    assert steps["set"]["numbers"]["loads"] == {"load phidot_6: coulomb-friction": pytest.approx(0.052)}
    row = steps["referee"]["numbers"]["controllers"]["K"]
    assert row["spectral_abscissa"] < 0
    assert row["within_limits"]
    assert "largest_voltage" not in row
    assert set(row["nut_errors"]) == {f"phi_{i}" for i in range(1, 7)}
    assert any("takes torques, with Coulomb" in f["value"] for f in steps["referee"]["facts"])
    # more than what holds the tool and what friction takes at the motor's shaft
    assert row["largest_torque"] > 0.05 / rough.values["ratio"]


def test_a_machine_that_cannot_be_followed_is_refused(tmp_path):
    text = RECIPE[: RECIPE.index("[step.set]")].replace("[step.updated]", "[step.K]").replace("updated.h5", "K.h5")
    text += '[step.axis]\ndo = "plant"\nplant = "servo-axis"\n' + RECIPE[RECIPE.index("[step.referee]") :]
    rl.save(tmp_path / "K.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    (tmp_path / "wrong.toml").write_text(text.replace('of = "updated"', 'of = "axis"'), encoding="utf-8")
    ending = robustlab("run", tmp_path / "wrong.toml", "--out", tmp_path / "out", code=3)
    assert "no Stewart platform" in ending.err + ending.out
