"""Recipes: a TOML file of steps and requirements, checked before anything runs, and run to a result and a report."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    **dict.fromkeys(("MAX_BYTES", "find_file", "load_recipe", "parse_recipe", "recipe_path"), "load"),
    **dict.fromkeys(("read_result", "run_recipe", "write_report"), "run"),
    **dict.fromkeys(("Recipe", "Requirement", "json_schema", "judge", "look_up"), "schema"),
    "look_through": "check",
    **dict.fromkeys(("Fact", "KINDS", "look_ahead", "Outcome", "Step", "Workspace", "step"), "steps.contract"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.recipe.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.recipe' has no attribute {name!r}")
