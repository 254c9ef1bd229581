"""What every command shares: results on stdout, progress and notes on stderr, errors as exit codes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from robustlab.cli.ending import main_guard
from robustlab.errors import InputError, UsageError, plain_text
from robustlab.units import amount, share

__all__ = [
    "EffortOption",
    "JsonOption",
    "OutOption",
    "SeedOption",
    "TimeLimitOption",
    "assignments",
    "emit",
    "ends",
    "main_guard",
    "note",
    "plant_settings",
    "progress",
    "shares",
    "status_line",
    "table",
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of the random numbers; same seed, same answer.")]
EffortOption = Annotated[
    float,
    typer.Option("--effort", help="Work that the search may take, as a multiple of the usual; counted, not timed."),
]
TimeLimitOption = Annotated[
    float | None,
    typer.Option(
        "--time-limit",
        "--timeout",
        help="Guard in s: where it strikes, the answer is not repeatable. No limit if left out.",
        show_default=False,
    ),
]
OutOption = Annotated[str | None, typer.Option("--out", "-o", help="File to write.", show_default=False)]

SCHEMA = "robustlab.result/1"


def emit(command: str, result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print the result, and nothing but the result, on stdout: ``text``, or one JSON object with ``--json``."""
    if as_json:
        from robustlab.result import plain

        print(json.dumps({"schema": SCHEMA, "command": command, **plain(result)}, indent=2, allow_nan=False))
    else:
        # Names from files may carry escape sequences; line breaks are ours.
        print("\n".join(plain_text(line) for line in text.splitlines()))


def note(text: str) -> None:
    """Print a remark on stderr."""
    print("\n".join(plain_text(line) for line in text.splitlines()), file=sys.stderr)


def assignments(option: str, texts: list[str] | None, units: Mapping[str, str] | None = None) -> dict[str, float]:
    """``["u=42"]`` as ``{"u": 42.0}``; also ``["u=42V"]`` where ``units`` has the names' units."""
    values: dict[str, float] = {}
    for text in texts or []:
        name, _, value = text.rpartition("=")
        if not name:
            raise UsageError(f"{option} {text}", "no name", "NAME=VALUE")
        values[name] = _number(option, text, value, (units or {}).get(name, ""))
    return values


def shares(option: str, texts: list[str] | None) -> dict[str, float]:
    """``["Km=5%"]`` or ``["Km=0.05"]`` as ``{"Km": 0.05}``."""
    values: dict[str, float] = {}
    for text in texts or []:
        name, _, value = text.rpartition("=")
        if not name:
            raise UsageError(f"{option} {text}", "no name", "NAME=VALUE")
        try:
            values[name] = share(f"{option} {text}", value)
        except InputError as error:
            raise UsageError(error.where, error.found, error.expected) from None
    return values


def ends(
    option: str, texts: list[str] | None, units: Mapping[str, str] | None = None
) -> dict[str, tuple[float, float]]:
    """``["tau=0.75:1.5"]`` as ``{"tau": (0.75, 1.5)}``; each end may carry its unit as in `assignments`."""
    found: dict[str, tuple[float, float]] = {}
    for text in texts or []:
        name, _, value = text.rpartition("=")
        low, colon, high = value.partition(":")
        if not (name and colon):
            raise UsageError(f"{option} {text}", "no name and two numbers", "NAME=LOW:HIGH")
        unit = (units or {}).get(name, "")
        found[name] = _number(option, text, low, unit), _number(option, text, high, unit)
    return found


def _number(option: str, text: str, value: str, unit: str) -> float:
    try:
        return amount(f"{option} {text}", value, unit)
    except InputError as error:
        raise UsageError(error.where, f"no number after =: {error.found}", error.expected) from None


def plant_settings(texts: list[str] | None) -> dict[str, Any]:
    """``["R=2.1", "preset=physical", "motors=true"]`` as the keyword arguments of a plant."""
    values: dict[str, Any] = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise UsageError(f"--set {text}", "no parameter and value", "NAME=VALUE")
        words: dict[str, Any] = {"true": True, "false": False}
        try:
            values[name] = words[value] if value in words else float(value)
        except ValueError:
            values[name] = value  # a choice, such as a preset; the plant knows which there are
    return values


def table(rows: list[tuple[str, ...]], header: tuple[str, ...] | None = None) -> str:
    """Left-aligned columns as plain text, with a rule under the header."""
    lines = [header, *rows] if header else rows
    if not lines:
        return ""
    widths = [max(len(row[i]) for row in lines) for i in range(len(lines[0]))]
    out = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in lines]
    if header:
        out.insert(1, "  ".join("-" * w for w in widths))
    return "\n".join(out)


@contextmanager
def progress(description: str, total: int | None = None) -> Iterator[Callable[..., None]]:
    """A progress bar on stderr, on a terminal only; yields ``advance(steps, text)``; a text is shown before it."""
    if not sys.stderr.isatty():
        yield lambda _steps, _text="": None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = [TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda steps, text="": bar.update(task, advance=steps, description=text or None)


@contextmanager
def status_line(description: str, verbose: bool = False) -> Iterator[Callable[[str], None]]:
    """Where a search stands; yields ``report(text)``.

    On a terminal one line on stderr that the next text replaces, elsewhere nothing; with ``verbose`` a line each.
    """
    if verbose:
        yield note
        return
    if not sys.stderr.isatty():
        yield lambda _text: None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status(escape(description)) as line:
        yield lambda text: line.update(escape(plain_text(f"{description}: {text}")))
