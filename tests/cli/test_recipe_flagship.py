"""From a record to a better controller: the steps on a small problem, and the recipe as shipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.recipe.load import load_recipe, recipe_path
from robustlab.recipe.run import run_recipe

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
[step.story]
do = "story"
record = "held"
plants = ["plain", "plain"]
covers = ["wide", "wide"]
performance = ["proved", "proved"]
controllers = ["before", "before"]
runs = "runs"
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
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return run_recipe(load_recipe(path), folder / "out")


def numbers(result, step):
    return next(s["numbers"] for s in result.data["steps"] if s["name"] == step)


def test_cover_design_and_story(tmp_path):
    result = run_small(tmp_path)
    assert [s["error"] for s in result.data["steps"] if s["error"]] == []
    wide, story = numbers(result, "wide"), numbers(result, "story")
    # 20 N of the 70 N that the first level is: more than that share was lost, less than all.
    assert 0.25 < wide["needed_lower"] <= wide["needed"] < 1.0
    assert wide["radius"] == pytest.approx(1.1 * wide["needed"])
    assert wide["loads"] == {}
    assert story["mu"]["fall_percent"] == 0.0
    assert story["gap"]["ratio"] == story["error"]["ratio"] == story["radius"]["ratio"] == 1.0
    proved = numbers(result, "proved")["controllers"]["before"]["mu_upper"]
    assert story["mu"]["before"] == proved
    told = next(s for s in result.data["steps"] if s["name"] == "story")
    assert "The errors are simulated, the record is simulated." in told["figures"][0]["caption"]
    facts = " ".join(map(str, told["facts"]))
    assert "simulated record, RMS" in facts
    assert "of the referee, simulated" in facts
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert page.index("From the gap to the better controller") < page.index(">Requirements</h2>")
    assert page.count("From the gap to the better controller") == 2  # its alternative text and its caption, once


def test_a_simulated_record_is_called_simulated(tmp_path):
    """By the report of the record, and of what is compared with it; one whose recipe does not say so is measured."""
    head = SMALL[: SMALL.index("[step.wide]")].replace("simulated = true\n", "", 1)
    compare = '[step.gap]\ndo = "compare"\nof = "plain"\nrecord = "held"\n'
    steps = {s["name"]: s for s in run_small(tmp_path, head + compare).data["steps"]}
    assert "(measured)" in steps["run"]["summary"]
    assert "(simulated)" in steps["held"]["summary"]
    assert "Record held is simulated, not measured." in steps["gap"]["notes"]


def test_what_grew_is_not_called_so_many_times_smaller():
    from robustlab.analysis.story import fall_in_words, times_in_words

    assert times_in_words(3.0, 2.0) == "1.5 times smaller"
    assert times_in_words(2.0, 3.0) == "1.5 times larger"
    assert fall_in_words(1.0, 0.7) == "30 % lower"
    assert fall_in_words(1.0, 1.2) == "20 % higher"


def test_the_story_says_what_is_simulated():
    from types import SimpleNamespace

    from robustlab.analysis.story import Story
    from robustlab.report.design_figures import story_figure

    t = np.linspace(0.0, 1.0, 5)
    margin = SimpleNamespace(omega=np.array([1.0, 10.0]), mu_upper=np.array([0.5, 0.4]))
    gap = {"t": t, "record": t, "origin": "simulated", "curves": [t, t], "rms": [1.0, 0.5], "label": "q [m]"}
    figure = story_figure(Story(gap, None, None, [margin, margin], [0.5, 0.4], t, [t, t], [2.0, 1.0], "mm", 0.5))
    texts = [axes.get_title(loc="left") for axes in figure.axes]
    texts += [text.get_text() for axes in figure.axes[:3] for text in axes.get_legend().get_texts()]
    assert "simulated record" in texts
    assert "before: at most 2 mm from 0.5 s on" in texts
    assert any("Simulated machine: error 2 times smaller" in text for text in texts)
    assert not any("measured" in text or "itself" in text for text in texts)


@pytest.mark.parametrize("keep", [1, 2])
def test_thinning_keeps_what_the_input_did_on_average(tmp_path, keep):
    """The model is true; every other sample of its input alone would be off by half a volt of one."""
    t = np.arange(300) * 5e-3
    u = np.where(t < 0.7, 1.0, -1.0) + 0.5 * (-1.0) ** np.arange(300)
    q = rl.simulate(rl.plant("servo-axis", M=95.0, Fv=200.0), t, u)["q"]
    lines = [f"{a:.4f},{b:.4f},{c:.9f}" for a, b, c in zip(t, u, q, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["t [s],u [V],q [m]", *lines]) + "\n", encoding="utf-8")
    head = SMALL[: SMALL.index("[step.held]")]
    cover = '[step.wide]\ndo = "data-cover"\nof = "plain"\nrecords = ["run"]\nnoise = { q = 1e-4 }\nat_rest = true\n'
    (tmp_path / "small.toml").write_text(f"{head}{cover}decimate = {keep}\n", encoding="utf-8")
    result = run_recipe(load_recipe(tmp_path / "small.toml"), tmp_path / "out")
    assert numbers(result, "wide")["needed"] < 0.05


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('plants = ["plain", "plain"]\n', "", "record and plants belong together"),
        ('controllers = ["before", "before"]', 'controllers = ["before"]', "at least 2"),
        ('runs = "runs"', 'runs = "proved"', "runs"),
    ],
)
def test_a_wrong_story_is_refused(tmp_path, old, new, says):
    write_records(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(SMALL.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_recipe(path)
    assert says in str(error.value) + " ".join(error.value.more or ())


def test_before_and_after_are_asked_for_the_same():
    steps = load_recipe(recipe_path("flagship")).recipe.step
    before, after = (steps[f"task_{word}"].model_dump(exclude={"of", "title", "loads"}) for word in ("before", "after"))
    assert before == after
    before, after = (steps[word].model_dump(exclude={"of", "title", "start"}) for word in ("before", "after"))
    assert before == after


@pytest.mark.slow
def test_flagship(tmp_path):
    result = run_recipe(load_recipe(recipe_path("flagship")), tmp_path / "out")
    assert [q["text"] for q in result.data["requirements"] if not q["met"]] == []
    assert result.exit_code == 0
