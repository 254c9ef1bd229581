"""``robustlab run``: run a recipe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from robustlab.cli.completion import recipe_or_file
from robustlab.cli.console import emit, note, result_alone, shown
from robustlab.cli.generated import ChangesOption, JsonOption, ProgressOption
from robustlab.display import text_table as table
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.recipe.run import RunResult

WIDTH = 44  # of a step's line, before its time

app = typer.Typer(help="Run a recipe: steps, requirements, report.", add_completion=False)


@app.command()
def run(
    recipe: Annotated[
        str | None,
        typer.Argument(
            help="A recipe file, or the name of one that comes with robustlab.", autocompletion=recipe_or_file
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the recipes that come with robustlab.")] = False,
    changes: ChangesOption = None,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", "-o", help="Folder to write.  [default: out/NAME, and one of its own for other settings]"
        ),
    ] = None,
    png: Annotated[bool, typer.Option("--png", help="Draw the figures as PNG, too.")] = False,
    figures: Annotated[
        Literal["required", "all"],
        typer.Option("--figures", help="Steps whose figures are drawn: those that requirements name, or all."),
    ] = "required",
    progress: ProgressOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Run a recipe, judge its requirements, and write report.html, result.json, junit.xml and the figures.

    Without --out each recipe and each choice of settings has a folder of its own. The
    report is written however the run ends; until then it shows that the run has not finished.

    Exit code 0: all requirements met; 1: one is not; 3: the recipe requires a missing number; 4: a step ended without
    a trustworthy number.

    Example: robustlab run first-light --set seed=7 --out out/first-light
    """
    import time
    from contextlib import suppress
    from pathlib import Path

    if listed or recipe is None:
        _list_recipes(listed, as_json)
        return
    from robustlab.errors import InputError
    from robustlab.recipe.load import load_recipe, recipe_path
    from robustlab.recipe.run import default_folder, read_result, replaced, run_recipe
    from robustlab.report.html import ending_of

    path = recipe_path(recipe)
    loaded = load_recipe(path, changes or [])
    folder = Path(out) if out else default_folder(loaded)
    replacing = replaced(folder, loaded)
    count = len(loaded.recipe.step)
    begun, since = list[str](), [0.0]
    result_alone()  # the recipe may run a user's code
    with shown(progress, "run", count, lines=True, budgets=False) as display:

        def ended() -> None:
            if begun:
                display.done(f"{begun[-1]:<{WIDTH}} {time.monotonic() - since[0]:6.1f} s")

        def begin(name: str, kind: str) -> None:
            ended()
            since[0] = time.monotonic()
            begun.append(f"[{len(begun) + 1}/{count}] {name} ({kind})")
            display.step(len(begun) - 1, begun[-1])

        try:
            result = run_recipe(loaded, folder, begin, png, figures)
        except BaseException:
            with suppress(InputError):  # no report was written
                if ending_of(read_result(folder))["how"] != "finished":
                    note(f"report of what was run: {folder.resolve() / 'report.html'}")
            raise
        ended()
    if replacing:
        note(f"note: {replacing}")
    emit("run", {**result.data, "folder": str(result.folder)}, _text(result), as_json)
    raise typer.Exit(result.exit_code)


def _list_recipes(requested: bool, as_json: bool) -> None:
    """Print the shipped recipes, or raise with them as choices where no list was requested."""
    from robustlab.recipe.shipped import shipped_titles

    titles = shipped_titles()
    if not requested:
        lines = tuple(f"  {line}" for line in table(list(titles.items())).splitlines())
        hint = "robustlab run first-light"
        raise UsageError("robustlab run", "RECIPE is missing", "a recipe file, or one of these", hint, lines)
    emit("run", {"recipes": titles}, table(list(titles.items()), ("recipe", "title")), as_json)


def _text(result: RunResult) -> str:
    """Return the judgements of the requirements, and the steps without a trustworthy number."""
    from robustlab.report.html import found_in_words, in_windows_only, verdict_of

    data = result.data
    words = [(verdict_of(q), q) for q in data["requirements"]]
    rows = [(v if q["met"] else v.upper(), q["text"], found_in_words(q), q["condition"]) for v, q in words]
    doubtful = [
        f"no trustworthy number: step {s['name']}: {s['error'] or s['status']}"
        for s in data["steps"]
        if not s["trustworthy"]
    ]
    met = sum(q["met"] for q in data["requirements"])
    parts = [
        table(rows, ("", "requirement", "found", "condition")) if rows else "no requirement stated",
        *doubtful,
        *in_windows_only(data["requirements"]),
        f"{met} of {len(rows)} requirements met in {data['seconds']:.1f} s",
        f"report: {result.folder / 'report.html'}",
    ]
    return "\n\n".join(parts)
