"""Linear matrix inequalities handed to Clarabel directly, in rows of one size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.conic import ACCEPTED, Cone, solve, triangle

# Residual up to which that holds where its arithmetic ends before its tolerances do.
RESIDUAL = 1e-8


@dataclass(frozen=True, eq=False)
class SemidefiniteAnswer:
    """The point where the solver ended, None where there is none worth a look, and how it ended, in its words."""

    x: Array | None
    text: str


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

    ``rows``: dense or sparse, by triangles (`conic.triangle`).
    ``budget``, ``steps``, ``work``: every step of the solver counts as ``work``; ``steps`` of them at most.
    """
    seconds = max(budget.seconds_left, 1e-3) if np.isfinite(budget.seconds_left) else None
    cones: list[Cone] = [("positive", positive), *(("semidefinite", size) for size in sizes)]
    most = np.clip(budget.left / work, 1, steps)
    cones = [cone for cone in cones if cone[1]]
    solution = solve(cost, rows, right, cones, steps=most, seconds=seconds, threads=0)
    if solution is None:
        return SemidefiniteAnswer(None, "panicked")
    budget.spend(solution.iterations * work)
    x, status = np.array(solution.x), str(solution.status)
    close = status == "NumericalError" and solution.r_prim < RESIDUAL and solution.r_dual < RESIDUAL
    usable = (status in ACCEPTED or close) and bool(np.isfinite(x).all())
    return SemidefiniteAnswer(x if usable else None, status)
