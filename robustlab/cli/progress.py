"""The progress display of all commands, on stderr.

``auto`` is on a terminal a bar with elapsed and remaining time, from two seconds to the end; elsewhere only the lines
that some commands always print. ``json`` is an object a line (`Display.state`) at every step and every few seconds.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from robustlab.cli.console import note
from robustlab.errors import UsageError, plain_text

SCHEMA = "robustlab.progress/1"
MODES = ("auto", "json", "none")
PATIENCE = 2.0  # s until the bar appears
EVERY = 0.25  # s between two updates of the bar
BEAT = 2.0  # s after which a line of JSON is printed without news
SHORT = 0.1  # s; least time between lines of JSON with the same text


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
    with listening(display.work if budgets and mode in ("bar", "json") else None), display:
        yield display


class Display:
    """The display of texts and counts of a command.

    The remaining time is in proportion to known steps; of a search that counts its largest work, an upper estimate
    (``at_most``); of a search in parts, that of the current part (``part``).
    """

    def __init__(self, command: str, mode: str, total: int | None = None) -> None:
        self.command, self.mode, self.total = command, mode, float(total or 0)
        self._text, self._done, self._at_most, self._part = "", 0.0, False, False
        self._kept: list[str] = []  # lines above the bar
        self._began = self._base = time.monotonic()
        self._from, self._printed = 0.0, 0.0
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._update, daemon=True)

    def __enter__(self) -> Display:
        if self.mode in ("bar", "json"):
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        for text in self._kept:
            note(text)
        if self.mode == "json":
            self._line(ended=True)

    def __call__(self, text: str) -> None:
        """Show the current activity."""
        self._text = text
        if self.mode == "lines":
            note(text)
        elif self.mode == "json":
            self._line()

    def done(self, text: str) -> None:
        """Keep a line on a terminal; elsewhere it was printed at the start of the step."""
        if self.mode == "bar":
            self._kept.append(text)

    def step(self, done: float, text: str = "") -> None:
        """Set the number of finished steps."""
        self._done = done
        if text:
            self(text)
        elif self.mode == "json" and time.monotonic() - self._printed > SHORT:
            self._line()

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
        return self if self.mode in ("bar", "json") else self.__call__

    def part(self, done: float, expected: float, text: str) -> None:
        """Set the work done and expected in the current part of a search; a smaller count starts the next part."""
        new = done < self._done or expected <= 0 or not self._part
        if new:
            self._base, self._from = time.monotonic(), done
        self._done, self.total, self._text, self._part = done, expected, text, True
        if new and expected > 0 and self.mode == "json":
            self._line()

    def _remaining(self) -> float | None:
        """Return the estimated remaining seconds, or None."""
        done = self._done - self._from
        if done <= 0 or self.total < self._done:
            return None
        return (time.monotonic() - self._base) * (self.total - self._done) / done

    def _update(self) -> None:
        """Show the bar after a while, or print lines of JSON (run in the thread)."""
        if self.mode == "bar":
            if not self._over.wait(PATIENCE):
                self._bar()
            return
        with suppress(OSError):  # stderr is closed
            while not self._over.wait(EVERY):
                if time.monotonic() - self._printed >= BEAT:
                    self._line()

    def state(self, ended: bool = False) -> dict[str, Any]:
        """Return the state of the command, the object ``progress`` of a line of JSON."""
        remaining = self._remaining()
        return {
            "command": self.command,
            "text": plain_text(self._text),
            "elapsed_s": round(time.monotonic() - self._began, 3),
            "done": self._done if self.total else None,
            "total": self.total or None,
            "remaining_s": None if remaining is None or ended else round(remaining, 3),
            "at_most": self._at_most,
            "part": self._part,
            "ended": ended,
        }

    def _line(self, ended: bool = False) -> None:
        with self._lock:
            self._printed = time.monotonic()
            print(json.dumps({"schema": SCHEMA, "progress": self.state(ended)}), file=sys.stderr, flush=True)

    def _bar(self) -> None:
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
                bar.update(task, description=text, completed=self._done, total=self.total or None, times=self._times())
                if self._over.wait(EVERY):
                    return

    def _times(self) -> str:
        passed, remaining = _duration(time.monotonic() - self._began), self._remaining()
        if remaining is None:
            return passed
        left = f"{'at most' if self._at_most else 'about'} {_duration(remaining)} to go"
        return f"{passed}, {left}{' in this part' * self._part}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
