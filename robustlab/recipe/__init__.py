"""Recipes: a TOML file of steps and requirements, checked before anything runs, and run to a result and a report."""

from robustlab.recipe.load import load_recipe, parse_recipe

__all__ = ["load_recipe", "parse_recipe"]
