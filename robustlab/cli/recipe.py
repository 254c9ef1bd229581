"""``robustlab recipe``: check recipes, print their schema, start a new one."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from robustlab.cli.console import emit, table
from robustlab.cli.options import ChangesOption, JsonOption, RecipeArgument

app = typer.Typer(help="Check a recipe, print its schema, start a new one.", no_args_is_help=True)


@app.command()
def check(
    recipe: RecipeArgument,
    changes: ChangesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a recipe and the files it reads without running it; every fault is named.

    Example: robustlab recipe check first-light
    """
    from robustlab.recipe.load import load_recipe
    from robustlab.recipe.paths import find_files, recipe_path

    loaded = load_recipe(recipe_path(recipe), changes or [])
    files = {name: str(path) for name, path in find_files(loaded).items()}
    steps = [(name, step.kind, files.get(name, "")) for name, step in loaded.recipe.step.items()]
    count = len(loaded.recipe.require)
    text = f"{table(steps, ('step', 'does', 'reads'))}\n\ncan be run; steps: {len(steps)}, requirements: {count}"
    result = {"recipe": str(loaded.path), "steps": [list(step) for step in steps], "requirements": count}
    emit("recipe check", result, text, as_json)


@app.command()
def schema() -> None:
    """Print the JSON Schema of recipes, for editors that complete and check TOML.

    Example: robustlab recipe schema > recipe.schema.json
    """
    from robustlab.recipe.schema import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the recipe; the file is NAME.toml.", show_default=False)],
    as_json: JsonOption = False,
) -> None:
    """Write a small commented recipe to start from, NAME.toml in the working directory.

    Example: robustlab recipe new my-motor && robustlab run my-motor.toml
    """
    from robustlab.recipe.paths import write_starter

    path = write_starter(name)
    emit("recipe new", {"file": str(path)}, f"{path}\nrun it with: robustlab run {path}", as_json)
