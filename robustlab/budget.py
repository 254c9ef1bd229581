"""Work budgets of searches, which make results repeatable on every machine; and one BLAS thread.

Searches count their work (gamma tests, evaluations, frequencies, boxes, each with the size of its matrices) and end
when their budget is used up. The user may add a time limit; a result that it ended reports that it is not repeatable.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from robustlab.errors import InputError

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

# A unit of work takes about a microsecond on one core of 2026.
MILLION = 1_000_000
# Texts of results whose search was ended by the time limit, or by the budget.
NOT_REPEATABLE = "the time limit ended the search, so the answer depends on the machine and is not repeatable"
USED_UP = "work budget used up; a larger effort may prove more"

# Takes the work done and the work in all.
Listener = Callable[[float, float], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Let budgets made inside the ``with`` block report their work done and in all to ``listener``."""
    before = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(before)


def dense(n: int, times: int = 1) -> int:
    """Return the work of ``times`` dense factorisations (eigenvalues, Schur, Riccati, singular values) of size n."""
    return times * (100 + n**3 // 25)


class Budget:
    """The work left of a search, and perhaps a time limit; checked between steps."""

    def __init__(self, work: float = inf, time_limit: float | None = None) -> None:
        self._work = float(work)
        self._end = inf if time_limit is None else time.monotonic() + time_limit
        self._parent: Budget | None = None
        self._whole, self._listener = self._work, _LISTENER.get() if self._work < inf else None
        # whether a time limit ended a search here or in a part of this budget: the result is not repeatable
        self.struck = False
        self._used_up = False

    def spend(self, work: float) -> None:
        """Count work done, here and in the budgets that this one is a part of."""
        self._work -= work
        if self._parent is not None:
            self._parent.spend(work)
        elif self._listener is not None:
            self._listener(self._whole - self._work, self._whole)

    def share(self, part: float) -> Budget:
        """Return a budget of this part of the work and time left; its work is counted here, too."""
        child = Budget(part * max(self.left, 0.0))
        if self._end < inf:
            child._end = time.monotonic() + part * max(self._end - time.monotonic(), 0.0)
        child._parent = self
        return child

    @property
    def left(self) -> float:
        """Units of work left; negative if a step took more than there was."""
        return self._work if self._parent is None else min(self._work, self._parent.left)

    @property
    def over(self) -> bool:
        """Return whether the search has to end: its work is done or its time is up."""
        if self.left <= 0:
            self._mark("_used_up")
            return True
        if time.monotonic() < self._end:
            return self._parent is not None and self._parent.over
        self._mark("struck")
        return True

    @property
    def remark(self) -> str | None:
        """How the search ended, for texts: by time, by work; None if it was completed."""
        return NOT_REPEATABLE if self.struck else USED_UP if self._used_up else None

    @property
    def seconds_left(self) -> float:
        """Seconds until the time limit, for solvers that take one; inf without a limit."""
        own = self._end - time.monotonic() if self._end < inf else inf
        return own if self._parent is None else min(own, self._parent.seconds_left)

    def strike(self) -> None:
        """Record that a time limit ended a solver with a limit of its own."""
        self._mark("struck")

    def use_up(self) -> None:
        """Record that a search ended because the work left was too little."""
        self._mark("_used_up")

    def _mark(self, flag: str) -> None:
        setattr(self, flag, True)
        if self._parent is not None:
            self._parent._mark(flag)


def search_budget(where: str, work: float, effort: float, time_limit: float | None) -> Budget:
    """Return the budget of a public function: ``effort`` times its usual work, under the user's time limit."""
    if not 0 < effort < inf:
        raise InputError(where, f"effort is {effort}", "a positive number (1 is the usual work)")
    if time_limit is not None and not time_limit >= 0:
        raise InputError(where, f"time_limit is {time_limit}", "a time in s, or None for no limit")
    return Budget(work * effort, time_limit)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run with one BLAS thread: the quickest for small matrices, and the same bits on every number of cores."""
    with _thread_pools(len(sys.modules)).limit(limits=1):
        yield


@lru_cache(maxsize=1)
def _thread_pools(_modules: int) -> ThreadpoolController:
    """Return the thread pools of the loaded libraries; recomputed when more modules are imported."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def child_environment() -> dict[str, str]:
    """Return the environment of a child process: ours with one thread, UTF-8, and the folder of this package."""
    paths = (str(Path(__file__).resolve().parents[1]), os.environ.get("PYTHONPATH", ""))
    threads = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    own = {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "PYTHONUTF8": "1"}
    return {**os.environ, **own, **dict.fromkeys(threads, "1")}
