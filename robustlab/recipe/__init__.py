"""Recipes: a TOML file of steps and requirements, checked before anything runs, and run to a result and a report."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "load": "MAX_BYTES find_file load_recipe look_through parse_recipe recipe_path",
        "run": "read_result run_recipe write_report",
        "schema": "Recipe Requirement json_schema judge look_up",
        "steps.step": "Fact KINDS look_ahead Outcome Positive Step ToModel Workspace step",
    },
)
