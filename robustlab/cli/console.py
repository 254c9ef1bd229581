"""Output of all commands: results on stdout, notes and the progress display on stderr.

``--progress auto`` is on a terminal a bar with elapsed and remaining time, from two seconds to the end; elsewhere only
the lines that some commands always print.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import robustlab as rl
from robustlab.errors import InputError, UsageError, plain_text

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
    """Write each figure as SVG and PNG, in a folder or with names that begin as ``path``; return the paths."""
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


MODES = ("auto", "none")
PATIENCE = 2.0  # s until the bar appears
EVERY = 0.25  # s between two updates of the bar


@contextmanager
def shown(
    progress: str, command: str, total: int | None = None, *,
    lines: bool = False, verbose: bool = False, budgets: bool = True,
) -> Iterator[Display]:  # fmt: skip
    """Yield the display in the mode of ``--progress``."""
    from robustlab.budget import listening

    if progress not in MODES:
        raise UsageError(f"--progress {progress}", "no such mode", f"one of {', '.join(MODES)}")
    mode = progress
    if mode == "auto":
        mode = "lines" if verbose else "bar" if sys.stderr.isatty() else "lines" if lines else "none"
    display = Display(command, mode, total)
    with listening(display.work if budgets and mode == "bar" else None), display:
        yield display


class Display:
    """The display of texts and counts of a command.

    The remaining time is in proportion to known steps; of a search that counts its largest work, an upper estimate
    (``at_most``); of a search in parts, that of the current part (``part``).
    """

    def __init__(self, command: str, mode: str, total: int | None = None) -> None:
        self.command, self.mode, self.total = command, mode, float(total or 0)
        self._text, self._done, self._from, self._at_most, self._part = "", 0.0, 0.0, False, False
        self._kept: list[str] = []  # lines above the bar
        self._began = self._base = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._bar, daemon=True)

    def __enter__(self) -> Display:
        if self.mode == "bar":
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        for text in self._kept:
            note(text)

    def __call__(self, text: str) -> None:
        """Show the current activity."""
        self._text = text
        if self.mode == "lines":
            note(text)

    def done(self, text: str) -> None:
        """Keep a line on a terminal; elsewhere it was printed at the start of the step."""
        if self.mode == "bar":
            self._kept.append(text)

    def step(self, done: float, text: str = "") -> None:
        """Set the number of finished steps."""
        self._done = done
        if text:
            self(text)

    def resumed(self, done: float) -> None:
        """Set the number of steps finished before this run, which do not count for its speed."""
        self._from = self._done = done

    def work(self, done: float, whole: float) -> None:
        """Set the work done and its largest amount; a new amount starts a new count."""
        if whole != self.total:
            self._base, self._from = time.monotonic(), 0.0
        self._done, self.total, self._at_most = done, whole, True

    @property
    def listener(self) -> Display | Callable[[str], None]:
        """Return the listener of a search in parts: the display where it shows numbers, else a printer of lines."""
        return self if self.mode == "bar" else self.__call__

    def part(self, done: float, expected: float, text: str) -> None:
        """Set the work done and expected in the current part of a search; a smaller count starts the next part."""
        if done < self._done or expected <= 0 or not self._part:
            self._base, self._from = time.monotonic(), done
        self._done, self.total, self._text, self._part = done, expected, text, True

    def times(self) -> str:
        """Return the elapsed time, and the estimated remaining time where it is known."""
        now, done = time.monotonic(), self._done - self._from
        passed = _duration(now - self._began)
        if done <= 0 or self.total < self._done:
            return passed
        remaining = _duration((now - self._base) * (self.total - self._done) / done)
        return f"{passed}, {'at most' if self._at_most else 'about'} {remaining} to go{' in this part' * self._part}"

    def _bar(self) -> None:
        """Show the bar after a while (run in the thread)."""
        if self._over.wait(PATIENCE):
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

        columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=24),
                   TextColumn("{task.fields[times]}", markup=False))  # fmt: skip
        with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bar:
            task = bar.add_task(self.command, total=None, times="")
            while True:
                while self._kept:
                    bar.console.print(plain_text(self._kept.pop(0)), markup=False, highlight=False)
                text = plain_text(f"{self.command}: {self._text}" if self._text else self.command)[-80:]
                bar.update(task, description=text, completed=self._done, total=self.total or None, times=self.times())
                if self._over.wait(EVERY):
                    return


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
