"""Choices of a plant in a recipe: a preset, motors, a chain of masses."""

from __future__ import annotations

import json

import pytest

from robustlab.cli.main import run
from robustlab.errors import InputError

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


def test_choices_reach_the_plant(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE)
    assert run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}
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


def test_an_uncertain_platform_says_what_is_sampled(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(SETS)
    assert run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}
    assert steps["exact"]["summary"] == "platform: exact uncertain model (parameters); uncertain: platform_mass, R."
    assert "sampled" not in steps["exact"]["numbers"]
    assert steps["covered"]["summary"].startswith("platform: sampled uncertain model")
    assert steps["covered"]["numbers"]["sampled"] == ["r_b", "remainder"]
    assert "for samples only (blocks r_b, remainder)" in steps["covered"]["notes"][0]
    assert "remainder: sampled: proved on the hull of" in steps["covered"]["text"]


def test_a_linear_plant_has_no_pose(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(SETS.replace('of = "platform"\ntolerances', 'of = "chain"\ntolerances', 1).replace(
        'platform_mass = 0.1, R = "5%"', "m1 = 0.1"))  # fmt: skip
    with pytest.raises(InputError, match="exact: at: mass-spring-damper has one linear model"):
        run(["run", "r.toml", "--out", "o"])


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('preset = "physical"', 'preset = "nosuch"', "preset"),
        ("motors = true", "motorz = true", "motorz"),
        (
            "choices = { preset",
            "parameters = { motors = 1.0 }\nchoices = { preset",
            "motors is among parameters and choices",
        ),
    ],
)
def test_wrong_choices_are_named(old, new, text, tmp_path, monkeypatch, capsys):
    from robustlab.cli.ending import main_guard

    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE.replace(old, new))
    assert main_guard(lambda: run(["run", "r.toml", "--out", "o"])) == 3
    assert text in capsys.readouterr().err
