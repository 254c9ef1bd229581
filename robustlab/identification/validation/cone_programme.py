"""Cone programmes within a budget, and the largest gamma that a certificate disproves, for both domains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.conic import Cone, solve
from robustlab.errors import NoTrustworthyNumber

MOST_ITERATIONS = 200
FEWEST_ITERATIONS = 20  # of any programme, independent of the remaining budget
BUILDING_WORK = 2.0  # to set up a programme, per stored entry, as measured
ITERATION_WORK = 0.5  # of an iteration, per stored entry, as measured
HALVINGS = 24  # of the interval in which a disproved gamma is searched
SLACK = 1e-9  # rounding in the noise of an explanation, over its bound

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


@cache
def sparse_matrices() -> Any:
    """Import scipy.sparse untyped: its types take a minute to infer."""
    return import_module("scipy.sparse")


class Rows(NamedTuple):
    """Rows ``offset - matrix x`` in cones of one kind: zero, nonnegative, or ``|(s_2 .. s_height)| <= s_1``.

    Several second-order cones are stored with the first rows of all first, then the second rows of all, and so on.
    """

    matrix: Any
    offset: Array
    cone: Literal["zero", "positive", "second-order"]
    height: int = 1
    label: tuple[str, int] | None = None


@dataclass(frozen=True)
class Multipliers:
    """Nonnegative multipliers of a certificate: D (n, blocks) of the energies, and noise (n, n_y)."""

    D: Array
    noise: Array

    def arrays(self) -> dict[str, Array]:
        return {"energy": self.D, "noise": self.noise}


class Search(NamedTuple):
    """Required relative width of the bounds, and the work budget."""

    precision: float
    budget: Budget


@dataclass(frozen=True)
class ConeSolution:
    """The point x, and the multipliers (height, cones) of each labelled part of the rows."""

    x: Array
    dual: dict[tuple[str, int], Array]


def solved_cones(cost: Array, rows: Sequence[Rows], budget: Budget) -> ConeSolution | None:
    """Minimise ``cost x`` over all x whose rows are in their cones; None if infeasible.

    The budget limits the iterations, and a time limit also the solver, which needs a second. The accuracy reported by
    the solver is not used: only the replay and the certificate of an answer count.
    """
    matrices, offsets, turns = [], [], []
    cones: list[Cone] = []
    for part in rows:
        turn = np.arange(part.matrix.shape[0]).reshape(part.height, -1).T
        matrices.append(part.matrix.tocsr()[turn.ravel()])
        offsets.append(part.offset[turn.ravel()])
        turns.append(turn)
        several = part.height > 1
        whole: Cone = (part.cone, part.height if several else len(turn))
        cones += [whole] * (len(turn) if several else 1)
    A = sparse_matrices().vstack(matrices).tocsc()
    each = 50 + ITERATION_WORK * A.nnz
    most = min(max(budget.left / each, FEWEST_ITERATIONS), MOST_ITERATIONS)
    seconds = max(budget.seconds_left, 1.0) if budget.seconds_left < 1e6 else None
    found = solve(cost, A, np.concatenate(offsets), cones, steps=most, seconds=seconds)
    if found is None:
        raise NoTrustworthyNumber("validate", "the solver failed")
    budget.spend(200 + BUILDING_WORK * A.nnz + found.iterations * each)
    status = str(found.status)
    if status == "MaxTime":
        budget.strike()
    if status in INFEASIBLE:
        return None
    x, dual = np.array(found.x), np.array(found.z)
    if not (np.isfinite(x).all() and np.isfinite(dual).all()):
        raise NoTrustworthyNumber("validate", f"the solver gave no answer ({status})")
    parts = np.split(dual, np.cumsum([turn.size for turn in turns])[:-1])
    labelled = [(r.label, part.reshape(t.shape).T) for r, t, part in zip(rows, turns, parts, strict=True)]
    return ConeSolution(x, {label: part for label, part in labelled if label is not None})


def largest_disproved(disproved: Callable[[float], bool], start: float, finest: float) -> float:
    """Find the largest gamma below ``start`` that is disproved, to the relative width ``finest``; 0 for none.

    A certificate that disproves a gamma disproves every smaller one: the search begins close to the start, then halves.
    """
    high = start
    for share in (*(finest * 2.0**k for k in range(64) if finest * 2.0**k < 1), 1.0):
        good = start * (1 - share)
        if disproved(good):
            break
        high = good
    else:
        return 0.0
    for _ in range(HALVINGS):
        if high - good <= finest * high:
            break
        middle = 0.5 * (good + high)
        good, high = (middle, high) if disproved(middle) else (good, middle)
    return good
