"""``robustlab recipe``: check recipes, list the kinds of steps and their keys, print the schema, start a new one."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any

import typer

from robustlab.cli.console import emit
from robustlab.cli.offers import plant_or_file
from robustlab.cli.options import ChangesOption, JsonOption, RecipeArgument, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import UsageError, did_you_mean
from robustlab.shown import text_table as table

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
    from robustlab.recipe.keys import keys_of_step
    from robustlab.recipe.load import KINDS

    what = {word: " ".join((made.__doc__ or "").split("\n\n")[0].split()) for word, made in sorted(KINDS.items())}
    if kind is None:
        rows = [(word, KINDS[word].gives, re.split(r"(?<=[a-z)])[.] ", line)[0]) for word, line in what.items()]
        kinds = [{"do": word, "gives": KINDS[word].gives, "what": line} for word, line in what.items()]
        emit("recipe steps", {"steps": kinds}, table(rows, ("do =", "gives", "what it does")), as_json)
        return
    if kind not in KINDS:
        hint = did_you_mean(kind, list(KINDS)) or "robustlab recipe steps lists them"
        raise UsageError(f"recipe steps {kind}", "no such kind of step", f"one of {', '.join(what)}", hint)
    keys = keys_of_step(kind)
    rows = [
        (key.name, "needed" if key.needed else "", key.takes.replace("``", ""), " ".join(key.meaning.split()))
        for key in keys
    ]
    text = f'do = "{kind}": {what[kind]}\n\n{table(rows, ("key", "", "takes", "meaning"))}'
    emit("recipe steps", {"do": kind, "what": what[kind], "keys": [vars(key) for key in keys]}, text, as_json)


@app.command()
def schema() -> None:
    """Print the JSON Schema of recipes, for editors that complete and check TOML.

    Example: robustlab recipe schema > recipe.schema.json
    """
    from robustlab.recipe.schema import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
@grouped
def new(
    *,
    name: Annotated[
        str | None,
        typer.Argument(
            help="Name of the recipe, or folder/name; the file is NAME.toml. With data: the file's, if left out."
        ),
    ] = None,
    data: Annotated[str | None, typer.Option("--from-data", help="A record of yours: the recipe reads it.")] = None,
    plant: Annotated[
        str | None,
        typer.Option(help="With data: plant to compare it with, a name or file.py:name.", autocompletion=plant_or_file),
    ] = None,
    clock: Annotated[str | None, typer.Option(help="With data: channel with the times.")] = None,
    dt: Annotated[float | None, typer.Option(help="With data: sample time in s.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over NAME.toml if it is there.")] = False,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Write a small commented recipe to start from, NAME.toml in the working directory or in the folder before NAME.

    With --from-data a recipe for a record of yours: times, inputs and outputs are recognised by names and units, what
    was guessed and what only you can know is marked DECIDE.

    Example: robustlab recipe new my-motor && robustlab run my-motor.toml
    Example: robustlab recipe new --from-data run3.csv --plant servo-axis
    """
    from robustlab.recipe.starters import write_starter

    if data is not None:
        with progress.shown("recipe new"):
            text, result = _new_from_data(name, data, plant, clock, dt, force)
        emit("recipe new", result, text, as_json)
        return
    if plant or clock or dt is not None:
        raise UsageError("recipe new", "--plant, --clock or --dt", "--from-data FILE with it")
    if name is None:
        raise UsageError("recipe new", "no name", "robustlab recipe new NAME, or --from-data FILE")
    path = write_starter(name, force=force)
    emit("recipe new", {"file": str(path)}, f"{path}\nrun it with: robustlab run {path}", as_json)


def _new_from_data(
    name: str | None, data: str, plant: str | None, clock: str | None, dt: float | None, force: bool
) -> tuple[str, dict[str, Any]]:
    """What was written and guessed, as text and for JSON."""
    from pathlib import Path

    from robustlab.cli.plant import read_plant
    from robustlab.recipe.starters import recognised, record_recipe, stem_of, write_starter

    # Any file name makes a recipe's name: 03-run (a).csv is run-a.
    name = name or re.sub(r"[^A-Za-z0-9_]+", "-", Path(data).stem).lstrip("-_0123456789").rstrip("-") or "record"
    stem = stem_of(name)
    found = recognised(data, read_plant(plant, {}) if plant else None, clock, dt)
    path = write_starter(name, record_recipe(stem, data, found, plant or "", dt), force)
    record = found.record
    rows = [(side, name, record.unit(name) or "?") for side in ("inputs", "outputs") for name in getattr(record, side)]
    lines = [
        str(path),
        f"{record.n} samples, {record.duration:.6g} s, dt {record.dt:.6g} s",
        table([(side[:-1], *rest) for side, *rest in rows], ("side", "signal", "unit")),
        *(f"guessed: {line}" for line in found.guessed),
        f"look at what is marked DECIDE, then: robustlab run {path}",
    ]
    result = {
        "file": str(path), "inputs": found.inputs, "outputs": found.outputs, "clock": found.clock, "dt": record.dt,
        "units": found.units, "guessed": found.guessed,
    }  # fmt: skip
    return "\n".join(lines), result
