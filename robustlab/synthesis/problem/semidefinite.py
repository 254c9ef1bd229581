"""Linear matrix inequalities handed to Clarabel directly: one door, and the triangles in which its cones are stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget

# Endings whose numbers are worth a look; whoever asked checks them outside of the solver.
ACCEPTED = ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations")


@dataclass(frozen=True, eq=False)
class SemidefiniteAnswer:
    """The point where the solver ended, None where there is none worth a look, and how it ended, in its words."""

    x: Array | None
    text: str


def triangle(matrix: AnyArray) -> AnyArray:
    """Upper triangles of a stack (..., n, n) by columns, off the diagonal times the root of two: Clarabel's way."""
    n = matrix.shape[-1]
    rows, columns = np.triu_indices(n)
    order = np.lexsort((rows, columns))
    rows, columns = rows[order], columns[order]
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return scale * 0.5 * (matrix[..., rows, columns] + matrix[..., columns, rows])


def solve_semidefinite(
    cost: Array, rows: Any, right: Array, positive: int, sizes: Sequence[int], budget: Budget, steps: int, work: float
) -> SemidefiniteAnswer:
    r"""Minimise ``cost x`` with ``right - rows x`` in the cone of ``positive`` numbers, then matrices of ``sizes``.

    ``rows``: dense or sparse, by triangles (`triangle`).
    ``budget``, ``steps``, ``work``: every step of the solver counts as ``work``; ``steps`` of them at most.
    """
    import clarabel
    from scipy import sparse

    solver: Any = clarabel  # its types are not declared
    settings = solver.DefaultSettings()
    settings.verbose = False
    settings.max_iter = int(np.clip(budget.left / work, 1, steps))
    if np.isfinite(budget.seconds_left):
        settings.time_limit = max(budget.seconds_left, 1e-3)
    cones = [solver.NonnegativeConeT(positive)] if positive else []
    cones += [solver.PSDTriangleConeT(size) for size in sizes]
    nothing = sparse.csc_matrix((len(cost), len(cost)))
    try:
        solution = solver.DefaultSolver(nothing, cost, sparse.csc_matrix(rows), right, cones, settings).solve()
    except BaseException as error:
        # Clarabel's own panics derive from BaseException, past every except clause for errors.
        if type(error).__name__ != "PanicException":
            raise
        return SemidefiniteAnswer(None, "panicked")
    budget.spend(solution.iterations * work)
    x, status = np.array(solution.x), str(solution.status)
    usable = status in ACCEPTED and bool(np.isfinite(x).all())
    return SemidefiniteAnswer(x if usable else None, status)
