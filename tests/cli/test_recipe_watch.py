"""The recipe step that watches a log: an axis with dry friction, whose friction rises in one of two logs."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import catalogue
from robustlab.recipe import load_recipe, run_recipe

FEW = ("coulomb-friction", "constant-load", "quadratic-drag")
DT, PIECE = 0.002, 1000
STEPS = """schema = "robustlab.recipe/1"
name = "watched"
[step.axis]
do = "load"
path = "axis.h5"
[step.monday]
do = "load"
path = "monday.h5"
[step.friday]
do = "load"
path = "friday.h5"
"""
WATCH = """[step.{0}-watched]
do = "watch"
of = "axis"
records = ["{0}"]
every = 2.0
noise = {{ q = 1e-4 }}
false_alarm = 0.001
exclude = [{1}]
"""
REQUIRED = """[[require]]
text = "The model explains the log"
that = "{0}-watched.met"
equals = true
"""


def axis(friction):
    return rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": friction}})


def log(seed, frictions):
    """Pieces of two seconds, each from rest, one after the other; the axis moves as far as it likes between them."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(PIECE)
    u = [np.repeat(rng.uniform(-3.0, 3.0, 20), PIECE // 20) for _ in frictions]
    q = [
        rl.simulate(axis(Fc), t, v)["q"] + 1e-4 * rng.standard_normal(PIECE) for Fc, v in zip(frictions, u, strict=True)
    ]
    t = DT * np.arange(PIECE * len(frictions))
    return rl.Record(t, {"u": np.concatenate(u)}, {"q": np.concatenate(q)}, {"u": "V", "q": "m"}, f"log {seed}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("watched")
    rl.save(made / "axis.h5", axis(20.0))
    rl.save(made / "monday.h5", log(1, [20.0] * 4))
    rl.save(made / "friday.h5", log(2, [20.0, 20.0, 23.0, 26.0]))
    return made


def run(folder, out, *days, more=""):
    left_out = ", ".join(f'"{name}"' for name in sorted(set(catalogue()) - set(FEW)))
    text = STEPS + "".join(WATCH.format(day, left_out) for day in days)
    path = folder / f"{out.name}.toml"
    path.write_text(text + "".join(REQUIRED.format(day) for day in days) + more, encoding="utf-8")
    return run_recipe(load_recipe(path), out)


def test_an_unchanged_machine_meets_the_requirements(folder, tmp_path):
    result = run(folder, tmp_path / "quiet", "monday")
    (step,) = (s for s in result.data["steps"] if s["name"] == "monday-watched")
    assert (result.exit_code, step["numbers"]["verdict"]) == (0, "explained")
    assert "explains all of the log, 4 pieces" in step["summary"]


@pytest.mark.slow
def test_wear_ends_the_recipe_in_1_with_its_time(folder, tmp_path):
    more = """[[require]]
text = "Changed"
that = "friday-watched.verdict"
equals = "changed"
[[require]]
text = "Since the third piece"
that = "friday-watched.since"
within = [2.0, 6.0]
"""
    result = run(folder, tmp_path / "worn", "friday", more=more)
    assert result.exit_code == 1
    assert [judged["met"] for judged in result.data["requirements"]] == [False, True, True]
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert "no longer explains the log" in page
