"""How far a long command is: the one display of all of them, on stderr.

``auto`` is on a terminal a bar with the time passed and to go, which appears after two seconds and vanishes at the end;
elsewhere nothing, but for the lines that some commands always print. ``json`` is an object a line (`Display.state`), at
every step and every few seconds. ``none`` is nothing.
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
PATIENCE = 2.0  # s; what takes less shows nothing on a terminal
EVERY = 0.25  # s between two looks at where the work stands
BEAT = 2.0  # s after which a line of JSON comes without anything new
SHORT = 0.1  # s; lines of JSON that come thicker are left out, unless the text is new


@contextmanager
def shown(
    progress: str, command: str, total: int | None = None, *,
    lines: bool = False, verbose: bool = False, budgets: bool = True,
) -> Iterator[Display]:  # fmt: skip
    """The display for the time of a ``with`` block, in the mode that ``--progress`` names."""
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
    """Takes texts and counts of a command, and shows them.

    Where a command knows its steps, the time to go is in proportion to them. Of a search that counts the work it may do
    at most, it is an upper estimate (``at_most``); of one in parts, that of the present part (``part``).
    """

    def __init__(self, command: str, mode: str, total: int | None = None) -> None:
        self.command, self.mode, self.total = command, mode, float(total or 0)
        self._text, self._done, self._at_most, self._part = "", 0.0, False, False
        self._kept: list[str] = []  # lines that are to stay above the bar
        self._began = self._base = time.monotonic()
        self._from, self._told = 0.0, 0.0
        self._lock, self._over = threading.Lock(), threading.Event()
        self._watch = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Display:
        if self.mode in ("bar", "json"):
            self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._watch.is_alive():
            self._watch.join()
        for text in self._kept:
            note(text)
        if self.mode == "json":
            self._line(ended=True)

    def __call__(self, text: str) -> None:
        """What is being done now."""
        self._text = text
        if self.mode == "lines":
            note(text)
        elif self.mode == "json":
            self._line()

    def done(self, text: str) -> None:
        """What has been done: a line that stays on a terminal; elsewhere it was printed when it began."""
        if self.mode == "bar":
            self._kept.append(text)

    def step(self, done: float, text: str = "") -> None:
        """So many steps are done."""
        self._done = done
        if text:
            self(text)
        elif self.mode == "json" and time.monotonic() - self._told > SHORT:
            self._line()

    def resumed(self, done: float) -> None:
        """Steps that were done before this run: no measure of its speed."""
        self._from = self._done = done

    def work(self, done: float, whole: float) -> None:
        """Work that a search has counted, of what it may do at most; a new search begins a new count."""
        if whole != self.total:
            self._base, self._from = time.monotonic(), 0.0
        self._done, self.total, self._at_most = done, whole, True

    @property
    def listener(self) -> Display | Callable[[str], None]:
        """For a search that counts in parts: the display where it shows numbers, else what takes lines of text."""
        return self if self.mode in ("bar", "json") else self.__call__

    def part(self, done: float, expected: float, text: str) -> None:
        """Work done in the present part of a search, of what is expected in it; a smaller count is the next part's."""
        new = done < self._done or expected <= 0 or not self._part
        if new:
            self._base, self._from = time.monotonic(), done
        self._done, self.total, self._text, self._part = done, expected, text, True
        if new and expected > 0 and self.mode == "json":
            self._line()

    def _remaining(self) -> float | None:
        """Seconds to go in proportion to what is done; None where nothing is known."""
        done = self._done - self._from
        if done <= 0 or self.total < self._done:
            return None
        return (time.monotonic() - self._base) * (self.total - self._done) / done

    def _look(self) -> None:
        """The thread that shows: a bar once the command takes long, or a line of JSON now and then."""
        if self.mode == "bar":
            if not self._over.wait(PATIENCE):
                self._bar()
            return
        with suppress(OSError):  # nobody reads any more; the command itself meets that where it prints its result
            while not self._over.wait(EVERY):
                if time.monotonic() - self._told >= BEAT:
                    self._line()

    def state(self, ended: bool = False) -> dict[str, Any]:
        """Where the command stands, as a line of JSON has it under ``progress``."""
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
            self._told = time.monotonic()
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
