"""``robustlab recipe``: check recipes, list the kinds of steps and their keys, print the schema, start a new one."""

from __future__ import annotations

import json
import re
from typing import Annotated

import typer

from robustlab.cli.console import emit
from robustlab.cli.generated import ChangesOption, JsonOption, RecipeArgument
from robustlab.display import text_table as table
from robustlab.errors import UsageError, did_you_mean

app = typer.Typer(
    help="Check a recipe, list the kinds of steps, start a new one.", no_args_is_help=True, add_completion=False
)


@app.command()
def check(recipe: RecipeArgument, changes: ChangesOption = None, as_json: JsonOption = False) -> None:
    """Check a recipe and the files it reads without running it: keys, files, signals, units, the results required.

    Every fault is named. What only the run can show is no fault.

    Example: robustlab recipe check first-light
    """
    from robustlab.recipe.check import look_through
    from robustlab.recipe.load import load_recipe, recipe_path

    loaded = load_recipe(recipe_path(recipe), changes or [])
    files = {name: str(path) for name, path in look_through(loaded).sources.items()}
    steps = [(name, step.kind, files.get(name, "")) for name, step in loaded.recipe.step.items()]
    count = len(loaded.recipe.require)
    text = f"{table(steps, ('step', 'does', 'reads'))}\n\ncan be run; steps: {len(steps)}, requirements: {count}"
    result = {"recipe": str(loaded.path), "steps": [list(step) for step in steps], "requirements": count}
    emit("recipe check", result, text, as_json)


@app.command()
def steps(
    kind: Annotated[str | None, typer.Argument(help="A kind of step: its keys. All kinds where left out.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the kinds of steps that a recipe may have, or the keys of one.

    Example: robustlab recipe steps record
    """
    from robustlab.recipe.load import KINDS
    from robustlab.recipe.schema import json_schema

    what = {word: " ".join((made.__doc__ or "").split("\n\n")[0].split()) for word, made in sorted(KINDS.items())}
    if kind is None:
        rows = [(word, KINDS[word].gives, re.split(r"(?<=[a-z)])[.] ", line)[0]) for word, line in what.items()]
        kinds = [{"do": word, "gives": KINDS[word].gives, "what": line} for word, line in what.items()]
        emit("recipe steps", {"steps": kinds}, table(rows, ("do =", "gives", "what it does")), as_json)
        return
    if kind not in KINDS:
        hint = did_you_mean(kind, list(KINDS)) or "robustlab recipe steps lists them"
        raise UsageError(f"recipe steps {kind}", "no such kind of step", f"one of {', '.join(what)}", hint)
    parts = json_schema()["$defs"].values()
    (part,) = [p for p in parts if p["properties"].get("do", {}).get("const") == kind]
    keys = {name: key for name, key in part["properties"].items() if name != "do"}
    rows = [
        (name, "needed" if name in part["required"] else json.dumps(key.get("default")),
         " ".join(key.get("description", "").split()))
        for name, key in keys.items()
    ]  # fmt: skip
    text = f'do = "{kind}": {what[kind]}\n\n{table(rows, ("key", "default", "meaning"))}'
    emit("recipe steps", {"do": kind, "what": what[kind], "keys": keys}, text, as_json)


@app.command()
def schema() -> None:
    """Print the JSON Schema of recipes, for editors that complete and check TOML.

    Example: robustlab recipe schema > recipe.schema.json
    """
    from robustlab.recipe.schema import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the recipe, or folder/name; the file is NAME.toml.")],
    force: Annotated[bool, typer.Option("--force", help="Write over NAME.toml if it is there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a small commented recipe to start from, NAME.toml in the working directory or in the folder before NAME.

    Example: robustlab recipe new my-motor && robustlab run my-motor.toml
    """
    from robustlab.recipe.starters import write_starter

    path = write_starter(name, force=force)
    emit("recipe new", {"file": str(path)}, f"{path}\nrun it with: robustlab run {path}", as_json)
