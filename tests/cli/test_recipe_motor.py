"""The recipe on a measured motor, and its second half by itself: map, feed-forward, trial, C code."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.recipe.load import load_recipe, parse_recipe, recipe_path
from robustlab.recipe.run import run_recipe
from robustlab.signals import Taken

DATA = Path(__file__).parents[3] / "shared" / "data" / "odrive.h5"
measured = pytest.mark.skipif(not DATA.is_file(), reason="the measured records are not at hand")
# Waves a turn and amplitudes in A of the map that was measured at standstill and published with the records.
PUBLISHED = {7: (0.26, 1.0), 28: (0.4, 0.7), 14: (0.25, 0.45), 36: (0.2, 0.4), 12: (0.2, 0.36)}


def numbers(result, step):
    return next(s["numbers"] for s in result.data["steps"] if s["name"] == step)


def at_hand(name):
    recipe = load_recipe(recipe_path(name)).recipe
    return [f"{step}.path={DATA}" for step, s in recipe.step.items() if s.kind == "record"]


def second_half(folder):
    """The recipe from the feed-forward on, with a plant as it was named once, under a PD controller."""
    effects = {
        "cogging": {"Ac": -0.0030, "As": -0.0410, "k": 6.9977},
        "coulomb-friction": {"Fc": 0.02556},
    }
    rl.save(folder / "named.h5", rl.with_effects(rl.plant("brushless-motor", J=2.38e-4, Kt=0.0638), effects))
    slope = 0.3 * 0.2 / 2.5e-4  # A per rad of difference, of a derivative filtered over five samples
    names = [Taken("phi_ref", "rad", "r", "phi"), Taken("phi", "rad")]
    K = rl.StateSpaceModel(
        [[0.8]], [[1.0, -1.0]], [[-0.2 * slope]], [[8 + slope, -8 - slope]], 2.5e-4, names, [("i", "A")]
    )
    rl.save(folder / "k.h5", rl.Controller(K))
    text = recipe_path("motor-feed-forward").read_text(encoding="utf-8").replace("../shared/data/odrive.h5", str(DATA))
    steps = dict(re.findall(r"(?ms)^\[step\.(\w+)\]\n(.*?)(?=^\[|^# ---|\Z)", text))
    left_out = ("motor", "run_22", "run_27", "set", "task", "task_alone", "servo", "proved", "proved_alone")
    steps |= {"naming": 'do = "load"\npath = "named.h5"\n', "digital": 'do = "load"\npath = "k.h5"\n'}
    kept = "".join(f"[step.{name}]\n{said}\n" for name, said in steps.items() if name not in left_out)
    (folder / "half.toml").write_text(f'schema = "robustlab.recipe/1"\nname = "half"\n{kept}', encoding="utf-8")
    return run_recipe(load_recipe(folder / "half.toml"), folder / "out")


@pytest.mark.shared
@measured
def test_the_hidden_machine_has_the_published_map_and_feed_forward_helps(tmp_path):
    result = second_half(tmp_path)
    machine = numbers(result, "machine")
    found = dict(zip(machine["counts"], machine["waves"], strict=True))
    for count, (low, high) in PUBLISHED.items():
        assert low <= found[count] <= high, count
    assert 0.3 <= machine["friction"] <= 0.4  # published: about 0.3 A
    assert machine["inertia"] == pytest.approx(2.5e-4 / 0.06, rel=0.2)
    for step in ("one_turn", "three_turns"):
        rows = numbers(result, step)["controllers"]
        assert rows["named_law"]["error_ratio"] > 1.5
        assert rows["named_law"]["ripple_ratio"] > 1.2
        assert rows["map_law"]["error_ratio"] > rows["named_law"]["error_ratio"]
        assert rows["map_law"]["ripple_ratio"] > 2.0
    code = (tmp_path / "out" / "servo_c.c").read_text()
    assert "servo_feed_forward" in code
    assert "u[2]: rate of phi_ref [rad/s]" in code


@pytest.mark.shared
@pytest.mark.slow
@measured
def test_the_recipe_does_what_it_promises(tmp_path):
    result = run_recipe(load_recipe(recipe_path("motor-feed-forward"), at_hand("motor-feed-forward")), tmp_path / "out")
    assert [q["text"] for q in result.data["requirements"] if not q["met"]] == []
    assert result.exit_code == 0
    proved = numbers(result, "proved")
    assert proved["verified"]
    assert numbers(result, "servo")["verified"]


STEPS = """schema = "robustlab.recipe/1"
name = "x"
[step.a]
do = "plant"
plant = "brushless-motor"
[step.f]
do = "feed-forward"
"""


@pytest.mark.parametrize(
    "said", ["", 'of = "a"\nmachine = "a"', 'of = "a"\nperiod = 6.28', 'of = "a"\nrecords = ["a"]']
)
def test_a_feed_forward_has_one_source(said):
    with pytest.raises(InputError):
        parse_recipe(STEPS + said)


def test_a_plant_without_effects_gives_none(tmp_path):
    (tmp_path / "x.toml").write_text(STEPS + 'of = "a"\n')
    with pytest.raises(InputError, match="no effect that is a force"):
        run_recipe(load_recipe(tmp_path / "x.toml"), tmp_path / "out")


def test_no_record_of_the_motor_is_read_twice():
    """What the naming saw, what judged it, and the hidden machine are different runs."""
    steps = (
        load_recipe(recipe_path("motor-feed-forward"), at_hand("motor-feed-forward")).recipe.step
        if DATA.is_file()
        else {}
    )
    groups = [s.group for s in steps.values() if s.kind == "record"]
    assert len(set(groups)) == len(groups)
    if steps:
        seen = {*steps["naming"].records, *steps["naming"].held_out, *steps["own_map"].records}
        assert not seen & set(steps["machine"].records)
        assert np.isclose(steps["named_law"].period, 2 * np.pi)
