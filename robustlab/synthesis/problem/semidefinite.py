"""Linear matrix inequalities handed to Clarabel directly: one door, the triangles of its cones, rows of one size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget

# Endings whose numbers are worth a look; whoever asked checks them outside of the solver.
ACCEPTED = ("Solved", "AlmostSolved", "InsufficientProgress", "MaxIterations")
# Residual up to which that holds where its arithmetic ends before its tolerances do.
RESIDUAL = 1e-8


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


def symmetric_basis(n: int) -> Array:
    """Symmetric matrices with one entry, or one pair of entries, that is 1; shape (n (n + 1) / 2, n, n)."""
    rows, columns = np.triu_indices(n)
    basis = np.zeros((len(rows), n, n))
    basis[np.arange(len(rows)), rows, columns] = basis[np.arange(len(rows)), columns, rows] = 1.0
    return basis


def equal_rows(matrix: Array) -> Array:
    """Factors d with which the largest entry of each row of ``d_i m_ij d_j`` is about one (Ruiz 2001).

    The rows of fast states drown those of slow ones otherwise.
    """
    size, d = np.abs(matrix), np.ones(len(matrix))
    for _ in range(10):
        largest = (d[:, None] * size * d).max(axis=1, initial=0.0)
        d /= np.sqrt(np.where(largest > 0, largest, 1.0))
    return d


@dataclass(eq=False)
class Inequalities:
    """Linear matrix inequalities in ``unknowns`` numbers x, collected one after the other and then solved."""

    unknowns: int
    _rows: list[Any] = field(default_factory=list)
    _right: list[Array] = field(default_factory=list)
    _sizes: list[int] = field(default_factory=list)

    def add(self, parts: Mapping[int, Array], constant: Array) -> None:
        """``constant + sum parts[first][i] x[first + i]`` is to be positive semidefinite; parts are stacks."""
        from scipy import sparse

        columns = np.concatenate([first + np.arange(len(part)) for first, part in parts.items()])
        values = np.vstack([-triangle(part) for part in parts.values()])
        which, rows = np.nonzero(values)
        shape = values.shape[1], self.unknowns
        self._rows.append(sparse.csr_matrix((values[which, rows], (rows, columns[which])), shape))
        self._right.append(triangle(constant))
        self._sizes.append(len(constant))

    def least(self, cost: Array, budget: Budget, steps: int) -> SemidefiniteAnswer:
        """The x of the least ``cost x``."""
        from scipy import sparse

        matrix: Any = sparse.vstack(self._rows)
        work = 1e-3 * matrix.nnz * len(cost)
        return solve_semidefinite(cost, matrix, np.concatenate(self._right), 0, self._sizes, budget, steps, work)


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
    close = status == "NumericalError" and solution.r_prim < RESIDUAL and solution.r_dual < RESIDUAL
    usable = (status in ACCEPTED or close) and bool(np.isfinite(x).all())
    return SemidefiniteAnswer(x if usable else None, status)
