"""Cone programs for Clarabel: directly for small problems solved often, by cvxpy for matrix inequalities."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget

# Statuses whose solution is usable; callers verify it independently of the solver.
ACCEPTED = ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations")
MATRIX_STEPS = 200  # most steps for a problem in cvxpy: three times the largest number observed
# A kind of cone and its size: number of entries, or of rows of a symmetric matrix.
Cone = tuple[Literal["zero", "positive", "second-order", "semidefinite"], int]


def triangle(matrix: AnyArray) -> AnyArray:
    """Return the upper triangles of a stack (..., n, n) by columns, off-diagonal entries times sqrt(2) (Clarabel)."""
    columns, rows = np.tril_indices(matrix.shape[-1])
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return scale * 0.5 * (matrix[..., rows, columns] + matrix[..., columns, rows])


def solve(cost: Array, rows: Any, right: Array, cones: Sequence[Cone], *, steps: float, seconds: float | None) -> Any:
    """Minimise ``cost x`` with ``right - rows x`` in the cones; None where the solver panics."""
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
    settings.verbose, settings.max_threads = False, 1
    settings.max_iter = int(steps)
    if seconds is not None:
        settings.time_limit = seconds
    quadratic = sparse.csc_matrix((len(cost), len(cost)))
    parts = [kinds[kind](size) for kind, size in cones]
    try:
        return solver.DefaultSolver(quadratic, cost, sparse.csc_matrix(rows), right, parts, settings).solve()
    except BaseException as error:
        # Panics of Clarabel derive from BaseException, not from Exception.
        if isinstance(error, (Exception, KeyboardInterrupt, SystemExit)):
            raise
        return None


def least(cost: Any, conditions: Sequence[Any], budget: Budget) -> str:
    """Solve a problem in cvxpy and set the values of its variables; return the reason of a failure, or ""."""
    import cvxpy as cp
    from cvxpy.error import SolverError

    if budget.over:
        return "no work was left for the LMI"
    problem = cp.Problem(cp.Minimize(cost), list(conditions))
    unknowns = sum(variable.size for variable in problem.variables())
    work = 4e-3 * unknowns**2 * sum(c.shape[0] if c.shape else 1 for c in conditions)
    options: dict[str, Any] = {"max_iter": int(np.clip(budget.left / work, 1, MATRIX_STEPS)), "accept_unknown": True}
    if np.isfinite(budget.seconds_left):
        options["time_limit"] = max(budget.seconds_left, 1e-3)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
            problem.solve(solver=cp.CLARABEL, warm_start=False, **options)
    except SolverError as error:
        return f"the LMI solver says {error}"
    budget.spend((problem.solver_stats.num_iters or 0) * work)
    found = [variable.value for variable in problem.variables()]
    sound = all(value is not None and np.isfinite(value).all() for value in found)
    return "" if sound else f"the LMI solver says {problem.status}"


def bounded_real(top: Any, C: Any, D: Any, gamma: Any) -> Any:
    """Return ``[top_A, top_B, C^T; ., -gamma I, D^T; ., ., -gamma I]``, ``top = [top_A, top_B]``, symmetric top_A."""
    import cvxpy as cp

    n, (q, m) = C.shape[1], D.shape
    return cp.bmat([[top[:, :n], top[:, n:], C.T], [top[:, n:].T, -gamma * np.eye(m), D.T], [C, D, -gamma * np.eye(q)]])


def equal_rows(matrix: AnyArray) -> AnyArray:
    """Return factors d for which the largest entry of each row of ``d_i m_ij d_j`` is about one (Ruiz 2001)."""
    # Without them the rows of fast states dominate those of slow ones.
    size, d = np.abs(matrix), np.ones(len(matrix))
    for _ in range(10):
        largest = (d[:, None] * size * d).max(axis=1, initial=0.0)
        d /= np.sqrt(np.where(largest > 0, largest, 1.0))
    return d
