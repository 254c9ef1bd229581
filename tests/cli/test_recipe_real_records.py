"""Recipes that identify missing effects of measured machines; the records are not shipped."""

from pathlib import Path

import numpy as np
import pytest
from recipe_runs import numbers, run_on, run_text, unmet

import robustlab as rl

ROOT = Path(__file__).parents[2]
DATA = Path(__file__).parents[3] / "shared" / "data"
FILES = {
    "rack-pinion": "rack_pinion_friction.h5",
    "cascaded-tanks": "cascaded_tanks.h5",
    "coupled-drives": "ced.h5",
}
# Requirements that are not met yet, by what they judge. The recipes keep the bars; nothing beyond these may be missed.
MISSED = {
    "rack-pinion": {"naming.time-delay.delay"},  # a lag explains it better than a delay, and is longer
    "cascaded-tanks": set(),
    "coupled-drives": {"naming.verdict"},  # may be missed only by naming what the sensor does, see below
}


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    [*(pytest.param(name, marks=pytest.mark.slow) for name in ("rack-pinion", "coupled-drives")), "cascaded-tanks"],
)
def test_what_the_other_records_say(name, tmp_path):
    """hsm150 takes minutes: it is not run here."""
    result = run_on(name, DATA / FILES[name], tmp_path)
    assert unmet(result) <= MISSED[name]
    if name == "coupled-drives" and unmet(result):
        assert "magnitude-sensor" in numbers(result, "naming")["names"]
    if name == "rack-pinion":
        assert {"coulomb-friction", "actuator-lag"} <= {*numbers(result, "naming")["answer"]}
    assert result.exit_code == (1 if unmet(result) else 0)


@pytest.mark.parametrize("name", ["hsm150", "rack_pinion", "cascaded_tanks", "coupled_drives"])
def test_the_committed_models_are_those_of_their_script(name):
    from runpy import run_path

    made = run_path(str(ROOT / "recipes/data/make_nominal_models.py"))["MODELS"][name]()
    committed = rl.load(ROOT / "models" / f"{name}.h5")
    assert (made.states, made.inputs, made.outputs) == (committed.states, committed.inputs, committed.outputs)
    for matrix in "ABCD":
        np.testing.assert_array_equal(getattr(made, matrix), getattr(committed, matrix))


TWO_LOGGERS = """schema = "robustlab.recipe/1"
name = "two"
[step.a]
do = "record"
path = "a.csv"
inputs = ["f"]
outputs = []
clock = "ta"
[step.b]
do = "record"
path = "b.csv"
inputs = []
outputs = ["v"]
clock = "tb"
[step.both]
do = "join"
first = "a"
second = "b"
[[require]]
text = "The coarser clock is kept, where both run"
that = "both.samples"
equals = 3.0
"""


def test_two_loggers_are_joined_in_a_recipe(tmp_path):
    (tmp_path / "a.csv").write_text("ta,f\n0.05,1\n0.15,2\n0.25,3\n0.35,4\n0.45,5\n0.55,6\n0.65,7\n")
    (tmp_path / "b.csv").write_text("tb,v\n0.0,0\n0.2,1\n0.4,2\n0.6,3\n")
    result = run_text(tmp_path, TWO_LOGGERS)
    assert unmet(result) == set()
    assert numbers(result, "both")["dt"] == pytest.approx(0.2)
    assert result.exit_code == 0
