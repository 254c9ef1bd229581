"""Choices of a plant in a recipe: a preset, motors, a chain of masses."""

import json

import pytest
from shell import robustlab

RECIPE = """\
schema = "robustlab.recipe/1"
name = "choices"
[step.platform]
do = "plant"
plant = "stewart-platform"
choices = { preset = "physical", motors = true }
[step.chain]
do = "plant"
plant = "mass-spring-damper"
choices = { m = [1.0, 2.0, 3.0], c = [0.1, 0.1, 0.1], k = [10.0, 20.0, 30.0] }
[step.linear]
do = "linearise"
of = "platform"
at = [0.0, 0.0, 0.13, 0.0, 0.0, 0.0]
"""


def steps_of(folder, text):
    (folder / "r.toml").write_text(text)
    robustlab("run", folder / "r.toml", "--out", folder / "o", code=0)
    return {s["name"]: s for s in json.loads((folder / "o" / "result.json").read_text())["steps"]}


def test_choices_reach_the_plant(tmp_path):
    steps = steps_of(tmp_path, RECIPE)
    assert any(fact["value"].startswith("phi_1") and "i_6" in fact["value"] for fact in steps["linear"]["facts"])
    assert "f3" in steps["chain"]["summary"]


SETS = (
    RECIPE
    + """\
[step.exact]
do = "uncertain"
of = "platform"
tolerances = { platform_mass = 0.1, R = "5%" }
at = [0.0, 0.0, 0.13, 0.0, 0.0, 0.0]
[step.covered]
do = "uncertain"
of = "platform"
tolerances = { platform_mass = 0.1, r_b = "0.1%" }
"""
)


def test_an_uncertain_platform_reports_its_sampled_parts(tmp_path):
    steps = steps_of(tmp_path, SETS)
    assert steps["exact"]["summary"] == "platform: exact uncertain model (parameters); uncertain: platform_mass, R."
    assert "sampled" not in steps["exact"]["numbers"]
    assert steps["covered"]["summary"].startswith("platform: sampled uncertain model")
    assert steps["covered"]["numbers"]["sampled"] == ["r_b", "remainder"]
    assert "for samples only (blocks r_b, remainder)" in steps["covered"]["notes"][0]
    assert "remainder: sampled: proved on the hull of" in steps["covered"]["text"]


ON_CHAIN = SETS.replace('of = "platform"\ntolerances', 'of = "chain"\ntolerances', 1)


@pytest.mark.parametrize(
    ("recipe", "text"),
    [
        (
            ON_CHAIN.replace('platform_mass = 0.1, R = "5%"', "m1 = 0.1"),
            "exact: at: mass-spring-damper has one linear model",
        ),
        (RECIPE.replace('"physical"', '"nosuch"'), "preset"),
        (RECIPE.replace("motors = true", "motorz = true"), "motorz"),
        (
            RECIPE.replace("choices = { preset", "parameters = { motors = 1.0 }\nchoices = { preset"),
            "motors is among parameters and choices",
        ),
    ],
)
def test_wrong_choices_are_named(tmp_path, recipe, text):
    (tmp_path / "r.toml").write_text(recipe)
    assert text in robustlab("run", tmp_path / "r.toml", "--out", tmp_path / "o", code=3).err
