"""Lines of progress: how often, and what they say of the time."""

from __future__ import annotations

import threading
import time

import pytest
from patience import PATIENCE

from robustlab.identification.naming import discovery as module
from robustlab.identification.naming.discovery import Progress


class Clock:
    """A clock that is set by hand."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize("pause", [0.01, 0.3, 1.0])
def test_a_line_comes_at_least_every_five_seconds_and_no_flood(pause):
    clock, told = Clock(), []
    progress = Progress(lambda _: told.append(clock.now), clock)
    while clock.now < 160.0:
        progress.step(clock.now, 200.0, "fits")
        clock.now += pause
    gaps = [b - a for a, b in zip([100.0, *told], told, strict=False)]
    assert max(gaps) <= 5.0
    assert len(told) <= 15


def test_the_time_to_go_is_in_proportion():
    clock, lines = Clock(), []
    progress = Progress(lines.append, clock)
    progress.step(0, 10, "first")  # at once: nothing to say yet
    clock.now += 30.0
    progress.step(2, 10, "coulomb-friction@v")
    clock.now += 5.0
    progress.step(0, 0, "nothing is known")
    clock.now += 5.0
    progress.step(12, 10, "more than was expected")
    clock.now += 5.0
    progress.step(10, 10, "last")
    assert lines == [
        "coulomb-friction@v (30 s so far, about 2 min 0 s to go in this part)",
        "nothing is known (35 s so far)",
        "more than was expected (40 s so far)",
        "last (45 s so far)",
    ]


def test_the_time_to_go_is_that_of_the_present_part():
    clock, lines = Clock(), []
    progress = Progress(lines.append, clock)
    progress.step(1, 10, "first part")
    clock.now += 90.0
    progress.step(10, 10, "first part")
    progress.step(1, 11, "second part")  # its clock starts here: the 90 s are no measure of its speed
    clock.now += 10.0
    progress.step(6, 11, "second part")  # five took 10 s, five are left
    assert lines == [
        "first part (1 min 30 s so far, about 0 s to go in this part)",
        "second part (1 min 40 s so far, about 10 s to go in this part)",
    ]


def test_a_listener_that_counts_gets_every_number_and_no_times():
    class Counter:
        def __init__(self):
            self.told = []

        def __call__(self, text):
            self.told.append(text)

        def part(self, done, expected, text):
            self.told.append((done, expected, text))

    counter = Counter()
    with Progress(counter) as progress:
        progress.step(1, 4, "fits")
        progress.step(2, 4, "fits")
        progress.tell("what remains")
    assert counter.told == [(1, 4, "fits"), (2, 4, "fits"), (0, 0, "what remains"), "what remains"]


def test_a_milestone_is_told_at_once_and_counts_as_a_line():
    clock, lines = Clock(), []
    progress = Progress(lines.append, clock)
    clock.now += 3.0
    progress.tell("named: coulomb-friction")
    clock.now += 3.0
    progress.step(1, 2, "too early")
    assert lines == ["named: coulomb-friction"]


def test_without_a_listener_nothing_happens():
    with Progress(None) as progress:
        progress.step(1, 2, "x")
        progress.tell("x")


def test_lines_come_while_one_step_takes_long_and_end_with_it(monkeypatch):
    monkeypatch.setattr(module, "EVERY", 0.02)
    before, lines = threading.active_count(), []
    with Progress(lines.append) as progress:
        progress.step(1, 3, "a long fit")
        deadline = time.monotonic() + PATIENCE
        while len(lines) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        progress.tell("what remains")
    told = len(lines)
    assert told >= 4
    assert lines[0].startswith("a long fit (0 s so far")
    assert threading.active_count() == before
    time.sleep(0.1)
    assert len(lines) == told


def test_an_error_ends_the_lines_and_goes_on(monkeypatch):
    monkeypatch.setattr(module, "EVERY", 0.01)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt), Progress(lambda _: None):
        raise KeyboardInterrupt
    assert threading.active_count() == before


def test_a_reader_that_went_away_does_not_stop_the_search(monkeypatch):
    monkeypatch.setattr(module, "EVERY", 0.01)
    asked = threading.Event()

    def gone(_):
        asked.set()
        raise BrokenPipeError

    with Progress(gone):
        assert asked.wait(10.0)
