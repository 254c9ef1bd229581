"""``robustlab report``: write the report of a finished run again; compare two runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from robustlab.cli.console import emit
from robustlab.cli.options import JsonOption
from robustlab.shown import text_table as table

if TYPE_CHECKING:
    from robustlab.report.run_comparison import Change, RunComparison

MOST_NUMBERS = 40  # changed numbers that are listed; --json has all


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
    further beyond; a step's number can no longer be vouched for.

    Exit code 0: nothing got worse; 1: something did.

    Example: robustlab report compare out/first-light out/first-light-seed-7
    """
    from robustlab.errors import EXIT_OK, EXIT_REQUIREMENT_NOT_MET
    from robustlab.recipe.run import read_result
    from robustlab.report.run_comparison import compare_runs

    comparison = compare_runs(read_result(run1), read_result(run2), rtol)
    emit("report compare", {"runs": [run1, run2], **comparison.to_json()}, _text(comparison, rtol), as_json)
    raise typer.Exit(EXIT_REQUIREMENT_NOT_MET if comparison.worse else EXIT_OK)


def _text(comparison: RunComparison, tolerance: float) -> str:
    parts: list[str] = []
    if comparison.settings:
        parts.append("What was run:\n" + _table(comparison.settings, ("", "first", "second")))
    rows = [(c.verdict, c.what, _cell(c.first), _cell(c.second), c.condition, c.why) for c in comparison.requirements]
    header = ("", "requirement", "first", "second", "condition", "")
    parts.append(table(rows, header) if rows else "Neither run states a requirement.")
    steps = [c for c in comparison.steps if c.verdict != "same"]
    if steps:
        parts.append("Steps that ended otherwise:\n" + _table(steps, ("step", "first", "second")))
    numbers = comparison.numbers[:MOST_NUMBERS]
    if numbers:
        parts.append(
            f"Numbers that differ by more than {100 * tolerance:g} %, the largest change first:\n"
            + table(
                [(c.what, _cell(c.first), _cell(c.second), _percent(c)) for c in numbers],
                ("number", "first", "second", "change"),
            )
        )
    left = len(comparison.numbers) - len(numbers)
    more = f", {left} more differ (--json lists them)" if left else ""
    parts.append(f"{comparison.equal} numbers do not differ{more}")
    count = len(comparison.worse)
    parts.append(f"{count} got worse: " + "; ".join(c.what for c in comparison.worse) if count else "nothing got worse")
    return "\n\n".join(parts)


def _table(changes: Any, header: tuple[str, str, str]) -> str:
    return table([(c.what, _cell(c.first), _cell(c.second)) for c in changes], header)


def _cell(value: Any) -> str:
    from robustlab.report.html import in_words

    return "-" if value is None else in_words(value)


def _percent(change: Change) -> str:
    numbers = [v for v in (change.first, change.second) if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(numbers) < 2:
        return change.verdict
    return f"{100 * (numbers[1] / numbers[0] - 1):+.3g} %" if numbers[0] else "from zero"
