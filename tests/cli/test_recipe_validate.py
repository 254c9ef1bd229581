"""The recipe step ``validate``: its numbers, its part of the report, and its outcome without a number."""

import numpy as np
import pytest
from recipe_runs import entry, run_text

import robustlab as rl

RECIPE = """
schema = "robustlab.recipe/1"
name = "held-out"

[step.plant]
do = "plant"
plant = "mass-spring-damper"
choices = {{ m = [2.0], c = [1.5], k = [8.0] }}

[step.set]
do = "uncertain"
of = "plant"
tolerances = {{ c = 0.25, k = 0.25 }}

[step.run]
do = "record"
path = "{path}"

[step.held]
do = "validate"
of = "set"
record = "run"
noise = {{ q = {bound} }}
at_rest = true
precision = 0.05

[[require]]
that = "held.gamma"
text = "The set explains the held-out record"
at_most = 1.0
"""


def run(folder, delta, noise=1.0):
    t = np.arange(70) * 0.1
    f = np.sign(np.sin(0.7 * t) + 0.4)
    model = rl.plant("mass-spring-damper", m=2.0, c=(1.5, 0.25), k=(8.0, 0.25)).uncertain()
    q = rl.simulate(model.evaluate(dict(zip(("c", "k"), delta, strict=True))), t, {"f": f})["q"]
    bound = 0.01 * np.abs(q).max()
    q = q + bound * np.random.default_rng(0).uniform(-1, 1, len(t))
    rl.save(folder / "run.h5", rl.Record(t, {"f": f}, {"q": q}, {"f": "N", "q": "m"}))
    done = run_text(folder, RECIPE.format(path=folder / "run.h5", bound=float(noise * bound)))
    return done, entry(done, "held")


def test_a_set_that_explains_the_record_meets_the_requirement(tmp_path):
    done, step = run(tmp_path, (0.5, -0.7))
    numbers = step["numbers"]
    assert done.exit_code == 0
    assert numbers["verdict"] == f"not invalidated at gamma = {numbers['gamma']:.4g}"
    assert numbers["lower"] <= numbers["gamma"] == numbers["upper"] <= 0.7
    assert numbers["blocks"]["k"]["size"] <= numbers["gamma"] * (1 + 1e-9)
    assert [f["stem"] for f in step["figures"]] == ["held-record-q"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert numbers["verdict"] in page
    assert "Not invalidated is not proved" in page
    kept = rl.load(tmp_path / "out" / "evidence" / "held.h5")
    assert kept.type == "Validation"
    assert kept.data["upper"] == pytest.approx(numbers["gamma"])


def test_a_set_that_does_not_explain_it_misses_the_requirement(tmp_path):
    done, step = run(tmp_path, (0.5, -1.6))
    assert done.exit_code == 4  # constants of a continuous model have no proved lower bound: undecided
    assert not step["numbers"]["invalidated"]
    assert step["numbers"]["upper"] > 1


def test_a_bound_of_zero_gives_no_number(tmp_path):
    done, step = run(tmp_path, (0.5, -0.7), noise=0.0)
    assert done.exit_code == 4
    assert "singular noise model" in step["error"]
    assert not step["numbers"]
