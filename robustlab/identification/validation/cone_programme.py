"""Cone programmes: rows, the cones they lie in, and the solver's answer within a budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.budget import Budget
from robustlab.conic import Cone, solve
from robustlab.errors import NoTrustworthyNumber

MOST_ITERATIONS = 200
FEWEST_ITERATIONS = 20  # that any programme gets, however little of the budget is left
BUILDING_WORK = 2.0  # of setting a programme up, per stored entry, as measured
ITERATION_WORK = 0.5  # of an iteration, per stored entry, as measured

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


@cache
def sparse_matrices() -> Any:
    """The module scipy.sparse, untyped: its types take a minute to infer."""
    return import_module("scipy.sparse")


class Rows(NamedTuple):
    """Rows ``offset - matrix x`` that lie in cones of one kind, and what they stand for.

    The cones: zero; not negative; or ``|(s_2 .. s_height)| <= s_1``, one after the other.
    """

    matrix: Any
    offset: Array
    cone: Literal["zero", "positive", "second-order"]
    height: int = 0
    label: tuple[str, int] | None = None


@dataclass(frozen=True)
class Search:
    """What every search for the smallest gamma is given."""

    scaled: Mask  # the blocks that gamma scales, (n_blocks,); the others keep the size 1
    precision: float  # relative width of the bounds to be reached
    budget: Budget  # work it may take

    def gammas(self, gamma: float) -> Array:
        """Sizes of the blocks that belong to a gamma."""
        return np.where(self.scaled, gamma, 1.0)


@dataclass(frozen=True)
class ConeSolution:
    """The point x, and the multipliers of each part of the rows that has a label, with its label."""

    x: Array
    dual: tuple[tuple[tuple[str, int], Array], ...]


def solved_cones(
    cost: Array, rows: Sequence[Rows], budget: Budget, squares: Array | None = None
) -> ConeSolution | None:
    """Least ``cost x + squares x^2 / 2`` over all x whose rows lie in their cones; None where there is no such x.

    The budget limits the iterations; a time limit, where there is one, is the solver's too, which needs a second.
    Whatever the solver says of its accuracy, an answer counts only as far as its replay and its certificate go.
    """
    sparse = sparse_matrices()
    A = sparse.vstack([part.matrix for part in rows]).tocsc()
    b = np.concatenate([part.offset for part in rows])
    cones: list[Cone] = []
    for part in rows:
        count = part.matrix.shape[0]
        whole: Cone = (part.cone, part.height or count)
        cones += [whole] * (count // part.height if part.height else 1)
    each = 50 + ITERATION_WORK * A.nnz
    most = min(max(budget.left / each, FEWEST_ITERATIONS), MOST_ITERATIONS)
    seconds = max(budget.seconds_left, 1.0) if budget.seconds_left < 1e6 else None
    found = solve(cost, A, b, cones, steps=most, seconds=seconds, squares=squares)
    if found is None:
        raise NoTrustworthyNumber("validate", "the solver broke down")
    budget.spend(200 + BUILDING_WORK * A.nnz + found.iterations * each)
    status = str(found.status)
    if status == "MaxTime":
        budget.strike()
    if status in INFEASIBLE:
        return None
    x, dual = np.array(found.x), np.array(found.z)
    if not (np.isfinite(x).all() and np.isfinite(dual).all()):
        raise NoTrustworthyNumber("validate", f"the solver gave no answer ({status})")
    ends = np.cumsum([part.matrix.shape[0] for part in rows])
    parts = np.split(dual, ends[:-1])
    return ConeSolution(x, tuple((r.label, part) for r, part in zip(rows, parts, strict=True) if r.label is not None))
