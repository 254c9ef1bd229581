"""``robustlab report``: write the report of a finished run again; compare two runs."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from robustlab.cli.console import emit
from robustlab.cli.generated import JsonOption
from robustlab.display import text_table as table

MOST_NUMBERS = 40  # of changed numbers in the list; --json has all


class _FolderOrCommand(TyperGroup):
    """``robustlab report RUN_DIR`` is short for ``robustlab report write RUN_DIR``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        known = (*self.commands, "--help")
        if args and not any(a in known for a in args[:1]):
            args = ["write", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    help="Write the report of a finished run again (robustlab report RUN_DIR), or compare two runs.",
    cls=_FolderOrCommand,
    no_args_is_help=True,
    add_completion=False,
)


@app.command()
def write(
    run_dir: Annotated[str, typer.Argument(help="The folder that robustlab run wrote.")], as_json: JsonOption = False
) -> None:
    """Write report.html and junit.xml again from result.json and figures of a finished run; nothing is computed again.

    The word write may be left out.

    Example: robustlab report out/first-light
    """
    from pathlib import Path

    from robustlab.recipe.run import read_result, write_report

    folder = Path(run_dir)
    write_report(read_result(folder), folder)
    files = [str(folder / name) for name in ("report.html", "junit.xml")]
    emit("report", {"files": files}, "\n".join(files), as_json)


@app.command()
def compare(
    run1: Annotated[str, typer.Argument(help="The folder of the earlier run.")],
    run2: Annotated[str, typer.Argument(help="The folder of the later run.")],
    rtol: Annotated[float, typer.Option(min=0.0, help="Relative changes up to this count as none.")] = 0.01,
    as_json: JsonOption = False,
) -> None:
    """Requirements and numbers of two runs side by side, what changed, and what got worse.

    Worse is: a requirement was met and is not, or is no longer stated; its number came nearer to its limit or went
    further beyond; a step's number is no longer trustworthy.

    Exit code 0: nothing got worse; 1: something did.

    Example: robustlab report compare out/first-light out/first-light-seed-7
    """
    from robustlab.errors import EXIT_OK, EXIT_REQUIREMENT_NOT_MET
    from robustlab.recipe.run import read_result
    from robustlab.report.run_comparison import compare_runs

    found = compare_runs(read_result(run1), read_result(run2), rtol)
    emit("report compare", {"runs": [run1, run2], **found}, _text(found, rtol), as_json)
    raise typer.Exit(EXIT_REQUIREMENT_NOT_MET if found["worse"] else EXIT_OK)


def _text(found: dict[str, Any], tolerance: float) -> str:
    parts = []
    if found["settings"]:
        parts.append("What was run:\n" + _table(found["settings"], ("", "first", "second")))
    header = ("", "requirement", "first", "second", "condition", "")
    rows = [(c["verdict"], *_cells(c), c["condition"], c["why"]) for c in found["requirements"]]
    parts.append(table(rows, header) if rows else "Neither run states a requirement.")
    if steps := [c for c in found["steps"] if c["verdict"] != "same"]:
        parts.append("Steps that ended otherwise:\n" + _table(steps, ("step", "first", "second")))
    if numbers := found["numbers"][:MOST_NUMBERS]:
        head = f"Numbers that differ by more than {100 * tolerance:g} %, the largest change first:\n"
        parts.append(head + _table(numbers, ("number", "first", "second")))
    left = len(found["numbers"]) - MOST_NUMBERS
    parts.append(f"{found['equal_numbers']} numbers do not differ" + f", {left} more do (--json)" * (left > 0))
    worse = [c["what"] for c in (*found["requirements"], *found["steps"]) if c["verdict"] == "WORSE"]
    parts.append(f"{len(worse)} got worse: {'; '.join(worse)}" if worse else "nothing got worse")
    return "\n\n".join(parts)


def _table(changes: list[dict[str, Any]], header: tuple[str, str, str]) -> str:
    return table([_cells(c) for c in changes], header)


def _cells(change: dict[str, Any]) -> tuple[str, str, str]:
    from robustlab.report.html import in_words

    first, second = ("-" if change[key] is None else in_words(change[key]) for key in ("first", "second"))
    return change["what"], first, second
