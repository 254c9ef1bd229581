"""From a record to a better controller: the steps on a small problem, and the recipe as shipped."""

from pathlib import Path

import numpy as np
import pytest
from recipe_runs import numbers, run_text

import robustlab as rl
from robustlab.recipe import load_recipe, recipe_path

ROOT = Path(__file__).parents[2]

SMALL = """
schema = "robustlab.recipe/1"
name = "small"
title = "A servo axis with dry friction"
description = "Friction is known here; the recipe flagship names it from the record."
[step.plain]
do = "plant"
plant = "servo-axis"
parameters = { M = [95.0, 0.05], Fv = [200.0, 0.1] }
[step.run]
do = "record"
path = "run.csv"
simulated = true
inputs = ["u"]
outputs = ["q"]
[step.held]
do = "record"
path = "held.csv"
simulated = true
inputs = ["u"]
outputs = ["q"]
[step.wide]
do = "data-cover"
of = "plain"
records = ["run"]
held_out = ["held"]
noise = { q = 1e-5 }
at_rest = true
[step.task]
do = "tracking-problem"
of = "wide"
controlled = ["q"]
measured = ["q", "v"]
W1 = { error = 0.1, corner = 1.0, steady = 0.01 }
W2 = { limit = 10.0, bandwidth = 300.0 }
reference = 0.02
reference_bandwidth = 3.0
disturbance = 0.05
noise = { "*" = 1e-5 }
[step.before]
do = "hinf"
of = "task"
[step.proved]
do = "robust-performance"
of = "task"
controllers = ["before"]
gain = false
points = 6
effort = 0.1
[step.runs]
do = "simulate-control"
of = "plain"
controllers = ["before"]
controlled = ["q"]
measured = ["q", "v"]
amplitude = 0.02
omega = 3.0
rise_time = 0.5
t_end = 2.0
points = 201
step = 1e-3
effects = { "coulomb-friction@v" = { Fc = 20.0 }, "input-dead-zone@u" = { d = 0.1 } }
"""


def write_records(folder):
    t = np.arange(300) * 5e-3
    axis = rl.plant("servo-axis", M=95.0, Fv=200.0)
    rough = rl.with_effects(axis, {"coulomb-friction": {"Fc": 20.0}})
    for name, level in (("run", 2.0), ("held", 1.8)):
        u = level * np.where(t < 0.5, 1.0, np.where(t < 1.1, -0.9, 0.8))
        q = rl.simulate(rough, t, u)["q"]
        lines = [f"{a:.4f},{b:.4f},{c:.9f}" for a, b, c in zip(t, u, q, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["t [s],u [V],q [m]", *lines]) + "\n", encoding="utf-8")


def run_small(folder, text=SMALL):
    write_records(folder)
    return run_text(folder, text)


@pytest.mark.slow
def test_cover_and_design(tmp_path):
    result = run_small(tmp_path)
    assert [s["error"] for s in result.data["steps"] if s["error"]] == []
    wide = numbers(result, "wide")
    # 20 N of the 70 N that the first level is: more than that share was lost, less than all.
    assert 0.25 < wide["needed_lower"] <= wide["needed"] < 1.0
    assert wide["radius"] == pytest.approx(1.1 * wide["needed"])
    assert wide["loads"] == {}
    assert numbers(result, "proved")["controllers"]["before"]["mu_upper"] > 0


@pytest.mark.slow
def test_a_simulated_record_is_called_simulated(tmp_path):
    """The report marks the record and results compared with it; a record without this key is measured."""
    head = SMALL[: SMALL.index("[step.wide]")].replace("simulated = true\n", "", 1)
    compare = '[step.gap]\ndo = "compare"\nof = "plain"\nrecord = "held"\n'
    steps = {s["name"]: s for s in run_small(tmp_path, head + compare).data["steps"]}
    assert "(measured)" in steps["run"]["summary"]
    assert "(simulated)" in steps["held"]["summary"]
    assert "Record held is simulated, not measured." in steps["gap"]["notes"]


@pytest.mark.parametrize("keep", [1, 2])
def test_decimation_averages_the_input(tmp_path, keep):
    """The model is true; every other sample of its input alone would be off by half a volt of one."""
    t = np.arange(300) * 5e-3
    u = np.where(t < 0.7, 1.0, -1.0) + 0.5 * (-1.0) ** np.arange(300)
    q = rl.simulate(rl.plant("servo-axis", M=95.0, Fv=200.0), t, u)["q"]
    lines = [f"{a:.4f},{b:.4f},{c:.9f}" for a, b, c in zip(t, u, q, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["t [s],u [V],q [m]", *lines]) + "\n", encoding="utf-8")
    head = SMALL[: SMALL.index("[step.held]")]
    cover = '[step.wide]\ndo = "data-cover"\nof = "plain"\nrecords = ["run"]\nnoise = { q = 1e-4 }\nat_rest = true\n'
    result = run_text(tmp_path, f"{head}{cover}decimate = {keep}\n")
    assert numbers(result, "wide")["needed"] < 0.05


def test_before_and_after_have_the_same_requirement():
    steps = load_recipe(recipe_path("flagship")).recipe.step
    before, after = (steps[f"task_{word}"].model_dump(exclude={"of", "title", "loads"}) for word in ("before", "after"))
    assert before == after
    before, after = (steps[word].model_dump(exclude={"of", "title", "start"}) for word in ("before", "after"))
    assert before == after
