"""Recipes that a test writes, or that are shipped, and what came of them."""

import pytest

from robustlab.recipe import load_recipe, recipe_path, run_recipe


def run_text(folder, text):
    """Write a recipe into a folder and run it there."""
    (folder / "r.toml").write_text(text, encoding="utf-8")
    return run_recipe(load_recipe(folder / "r.toml"), folder / "out")


def run_on(name, record, folder):
    """Run a shipped recipe on a measured record, which may not be at hand."""
    if not record.is_file():
        pytest.skip("the measured record is not at hand")
    steps = load_recipe(recipe_path(name)).recipe.step
    at = [f"{step}.path={record}" for step, s in steps.items() if s.kind == "record"]
    return run_recipe(load_recipe(recipe_path(name), at), folder / "out")


def entry(result, step):
    return next(s for s in result.data["steps"] if s["name"] == step)


def numbers(result, step):
    return entry(result, step)["numbers"]


def unmet(result):
    """Return the values of the requirements that are not met."""
    return {q["that"] for q in result.data["requirements"] if not q["met"]}
