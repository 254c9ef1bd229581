"""One cone programme, solved by Clarabel within a budget: iterations are counted, and spent."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber

__all__ = ["solved_cones"]

# Iterations: as many as the solver takes at most, and those that any programme gets.
MOST, LEAST = 200, 20
# Work of setting a programme up and of an iteration, per stored entry of A, as measured.
BUILDING, ITERATION = 2.0, 0.5


def solved_cones(P: Any, cost: Any, A: Any, b: Any, cones: list[Any], budget: Budget) -> Any:
    """Clarabel's answer to ``min x P x / 2 + cost x`` subject to ``b - A x`` in the cones; sparse P and A.

    The budget limits the iterations; a time limit, where there is one, is the solver's too, which needs a second.

    Raises
    ------
    NoTrustworthyNumber
        The solver breaks down.
    """
    clarabel: Any = import_module("clarabel")  # its types are not published
    each = 50 + ITERATION * A.nnz
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.max_iter = int(min(max(budget.left / each, LEAST), MOST))
    if budget.seconds_left < 1e6:
        settings.time_limit = max(budget.seconds_left, 1.0)
    try:
        found = clarabel.DefaultSolver(P, cost, A, b, cones, settings).solve()
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        raise NoTrustworthyNumber("validate", f"the solver broke down ({type(error).__name__})") from None
    budget.spend(200 + BUILDING * A.nnz + found.iterations * each)
    if str(found.status) == "MaxTime":
        budget.strike()
    return found
