"""The recipe that names what a linear model of EMPS lacks; the record is not ours to ship."""

from __future__ import annotations

from pathlib import Path

import pytest

import robustlab as rl
from robustlab.recipe.load import load_recipe
from robustlab.recipe.run import run_recipe
from robustlab.recipe.shipped import recipe_path

EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps.h5"
# Requirements that are not met yet, by what they judge. The recipe keeps the bars; nothing beyond these may be missed.
MISSED = {"naming.gaps.q.updated", "naming.effects.coulomb-friction.Fc", "naming.nominal.Fv"}


@pytest.mark.slow
@pytest.mark.shared
def test_emps(tmp_path):
    """Published by Janot, Gautier and Brunot: 166.71 N s/m forwards and 240.42 N s/m backwards."""
    if not EMPS.is_file():
        pytest.skip("the measured record is not at hand")
    recipe = load_recipe(recipe_path("emps-discover"))
    at = [f"{step}.path={EMPS}" for step, s in recipe.recipe.step.items() if s.kind == "record"]
    result = run_recipe(load_recipe(recipe_path("emps-discover"), at), tmp_path / "out")
    assert {q["that"] for q in result.data["requirements"] if not q["met"]} <= MISSED
    found = next(s["numbers"] for s in result.data["steps"] if s["name"] == "naming")
    mean, half = found["nominal"]["Fv"], found["effects"]["asymmetric-viscous-friction"]["dFv"]
    # The bar is 3 %; the naming stands at -7 % and -3 %, and this only keeps it from getting worse.
    assert mean + half == pytest.approx(166.7061, rel=0.08)
    assert mean - half == pytest.approx(240.4236, rel=0.08)
    assert [e.effect.id for e in rl.load(result.folder / "naming-plant.h5").effects] == found["names"]
