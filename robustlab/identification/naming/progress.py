"""Where a search stands, told every few seconds: a line with the time passed and the time to go.

A search has parts, and how many of them is known at its end only. So the time to go is that of the present part; a
count that is smaller than the last one is the next part's.

The clock only prints. What a search does never depends on it, so that the answer is the same on a busy machine.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol, Self, runtime_checkable

__all__ = ["Counting", "Progress"]

EVERY = 4.0  # s between lines, with a second to spare: the user hears every five


@runtime_checkable
class Counting(Protocol):
    """A listener that shows the numbers itself, and then needs no lines with times in them."""

    def __call__(self, text: str) -> None:
        """A text that is told at once."""

    def part(self, done: float, expected: float, text: str) -> None:
        """What `Progress.step` was told."""


class Progress:
    """Lines of progress for a callable; inside a ``with`` block they come even while a step takes long.

    Parameters
    ----------
    say
        Takes a line of text, from a thread of its own too; None says nothing. One that is `Counting` gets the numbers.
    clock
        Seconds, from any beginning.
    """

    def __init__(self, say: Callable[[str], None] | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._counting = say if isinstance(say, Counting) else None
        self._began = self._told = self._part_began = clock()
        self._part_from = 0.0
        self._now: tuple[float, float, str] = (0.0, 0.0, "begun")
        self._lock, self._over = threading.Lock(), threading.Event()
        self._beat = threading.Thread(target=self._go_on, daemon=True)

    def __enter__(self) -> Self:
        if self._say is not None:
            self._beat.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._beat.is_alive():
            self._beat.join()

    def step(self, done: float, expected: float, text: str) -> None:
        """What is being done now; said with times where the last line is some seconds old.

        Parameters
        ----------
        done, expected
            Work done in this part, and in all of it as far as is known now, in any unit; the time to go is in
            proportion.
        text
            What is being done.
        """
        if self._counting is not None:
            self._counting.part(done, expected, text)
            return
        if done < self._now[0] or expected <= 0:
            self._part_began, self._part_from = self._clock(), done
        self._now = (done, expected, text)
        self._say_if_due()

    def tell(self, text: str) -> None:
        """Say a text at once: a part of the search has ended, and how long the next one takes is not known."""
        self._now = (0.0, 0.0, text)
        self._part_began, self._part_from = self._clock(), 0.0
        if self._counting is not None:
            self._counting.part(0.0, 0.0, text)
        if self._say is not None:
            with self._lock:
                self._told = self._clock()
                self._say(text)

    def _say_if_due(self) -> None:
        if self._say is None or self._counting is not None:
            return
        with self._lock:
            now = self._clock()
            if now - self._told >= EVERY:
                self._told = now
                done, expected, text = self._now
                times = _times(now - self._began, now - self._part_began, done - self._part_from, expected - done)
                self._say(f"{text} ({times})")

    def _go_on(self) -> None:
        while not self._over.wait(EVERY / 8.0):
            try:
                self._say_if_due()
            except OSError:  # nobody reads any more; the search itself meets that where it prints its result
                return


def _times(elapsed: float, in_part: float, done: float, left: float) -> str:
    """Time passed in all and to go in this part, of which ``done`` took ``in_part`` seconds."""
    passed = f"{_duration(elapsed)} so far"
    if done <= 0.0 or left < 0.0:
        return passed
    return f"{passed}, about {_duration(in_part * left / done)} to go in this part"


def _duration(seconds: float) -> str:
    """``38 s``, ``2 min 5 s``."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
