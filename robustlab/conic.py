"""Cone programmes handed to Clarabel: the one call of the solver, and the triangles of its cones of matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from robustlab.arrays import AnyArray, Array

# Endings whose numbers are worth a look; whoever asked checks them outside of the solver.
ACCEPTED = ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations")
# A kind of cone and its size: how many numbers, or how many rows a symmetric matrix has.
Cone = tuple[Literal["zero", "positive", "second-order", "semidefinite"], int]


def triangle(matrix: AnyArray) -> AnyArray:
    """Upper triangles of a stack (..., n, n) by columns, off the diagonal times the root of two: Clarabel's way."""
    columns, rows = np.tril_indices(matrix.shape[-1])
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return scale * 0.5 * (matrix[..., rows, columns] + matrix[..., columns, rows])


def solve(
    cost: Array,
    rows: Any,
    right: Array,
    cones: Sequence[Cone],
    *,
    steps: float,
    seconds: float | None,
    threads: int = 1,
) -> Any:
    r"""Minimise ``cost x`` with ``right - rows x`` in the cones; None where the solver panics.

    ``rows``: dense or sparse, those of matrices by triangles (`triangle`).
    ``steps``, ``seconds``: the most that the solver may take; None is without a limit.
    ``threads``: of the solver; 0 takes all that there are, and rounds as many ways.
    """
    import clarabel
    from scipy import sparse

    solver: Any = clarabel  # its types are not declared
    kinds = {
        "zero": solver.ZeroConeT,
        "positive": solver.NonnegativeConeT,
        "second-order": solver.SecondOrderConeT,
        "semidefinite": solver.PSDTriangleConeT,
    }
    settings = solver.DefaultSettings()
    settings.verbose, settings.max_threads = False, threads
    settings.max_iter = int(steps)
    if seconds is not None:
        settings.time_limit = seconds
    quadratic = sparse.csc_matrix((len(cost), len(cost)))
    parts = [kinds[kind](size) for kind, size in cones]
    try:
        return solver.DefaultSolver(quadratic, cost, sparse.csc_matrix(rows), right, parts, settings).solve()
    except BaseException as error:
        # Clarabel's own panics derive from BaseException, past every except clause for errors.
        if isinstance(error, (Exception, KeyboardInterrupt, SystemExit)):
            raise
        return None
