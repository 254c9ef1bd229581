"""Where a search stands, told now and then: a line with the time passed and the time to go.

The clock only prints. What a search does never depends on it, so that the answer is the same on a busy machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["Progress"]

EVERY = 4.0  # s between lines; a step may take one more second, and the user still hears within five


class Progress:
    """Lines of progress for a callable.

    Parameters
    ----------
    say
        Takes a line of text; None says nothing.
    clock
        Seconds, from any beginning.
    """

    def __init__(self, say: Callable[[str], None] | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._began = self._told = clock()

    def step(self, done: float, expected: float, text: str) -> None:
        """Say the text with times where the last line is some seconds old.

        Parameters
        ----------
        done, expected
            Work done so far, and in all as far as is known now, in any unit; the time to go is in proportion.
        text
            What is being done.
        """
        now = self._clock()
        if now - self._told >= EVERY:
            self.tell(f"{text} ({_times(now - self._began, done, expected)})")

    def tell(self, text: str) -> None:
        """Say a text at once: a part of the search has ended."""
        if self._say is not None:
            self._told = self._clock()
            self._say(text)


def _times(elapsed: float, done: float, expected: float) -> str:
    passed = f"{_duration(elapsed)} so far"
    if done <= 0.0 or expected < done:
        return passed
    return f"{passed}, about {_duration(elapsed * (expected - done) / done)} to go"


def _duration(seconds: float) -> str:
    """``38 s``, ``2 min 5 s``."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
