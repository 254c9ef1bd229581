"""Output of all commands: results on stdout, progress and notes on stderr, errors as exit codes."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import robustlab as rl
from robustlab.errors import InputError, plain_text

if TYPE_CHECKING:
    from robustlab.report.drawings import Picture


SCHEMA = "robustlab.result/1"
FIGURE = "Figures to write, SVG and PNG: NAME, one of several NAME-...; or FOLDER/."


class _Redirected:
    """A replacement of stdout that writes to stderr, until `emit` restores it."""

    def __init__(self, stdout: Any) -> None:
        self.stdout = stdout
        try:
            is_first = stdout.fileno() == 1
        except (OSError, ValueError, AttributeError):  # a stream in memory has no number
            is_first = False
        self.number = os.dup(1) if is_first else None
        if is_first:  # also redirects compiled libraries and child processes
            stdout.flush()
            os.dup2(2, 1)

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)

    def restore(self) -> None:
        if self.number is not None:
            os.dup2(self.number, 1)
            os.close(self.number)
        sys.stdout = self.stdout


def result_alone() -> None:
    """Redirect stdout to stderr until `emit`, for commands that run a user's code."""
    if not isinstance(sys.stdout, _Redirected):
        sys.stdout = _Redirected(sys.stdout)


def emit(command: str, result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print the result on stdout: ``text``, or one JSON object with ``--json``."""
    if isinstance(sys.stdout, _Redirected):
        sys.stdout.restore()
    if as_json:
        from robustlab.result import plain

        print(json.dumps({"schema": SCHEMA, "command": command, **plain(result)}, indent=2, allow_nan=False))
    else:
        # Names from files may contain escape sequences.
        print("\n".join(plain_text(line) for line in text.splitlines()))


def note(text: str) -> None:
    """Print a remark on stderr."""
    print("\n".join(plain_text(line) for line in text.splitlines()), file=sys.stderr)


def named(signals: Iterable[rl.Signal]) -> list[str]:
    """Return the signals with their units."""
    return [f"{s.name} [{s.unit}]" if s.unit else s.name for s in signals]


def save_figures(pictures: Mapping[str, Picture], path: str) -> list[str]:
    """Write each figure as SVG and PNG; return the paths.

    In a folder (one that exists, or a path that ends in a slash) each has its own name, else the first is ``path``
    and the others have their own name added.
    """
    from robustlab.report.style import save_figure

    target, made = Path(path), list[str]()
    alone = path.endswith(("/", os.sep)) or target.is_dir()
    if not (alone or target.stem):
        raise InputError("--figure", repr(path), "a name, for example design.svg, or a folder")
    stem = target.stem if target.suffix.lower() in (".svg", ".png") else target.name
    for name, picture in pictures.items():
        place = (target, name) if alone else (target.parent, f"{stem}-{name}" if made else stem)
        made += map(str, save_figure(picture.figure, *place))
    return made
