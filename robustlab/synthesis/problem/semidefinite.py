"""Linear matrix inequalities, posed in cvxpy and solved by Clarabel, in rows of one size."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget


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
    """Factors d with which the largest entry of each row of ``d_i m_ij d_j`` is about one (Ruiz 2001)."""
    size, d = np.abs(matrix), np.ones(len(matrix))
    for _ in range(10):
        largest = (d[:, None] * size * d).max(axis=1, initial=0.0)
        d /= np.sqrt(np.where(largest > 0, largest, 1.0))
    return d


@dataclass(eq=False)
class Inequalities:
    """Linear matrix inequalities in ``unknowns`` numbers x, collected one after the other and then solved."""

    unknowns: int
    _parts: list[tuple[Any, Array]] = field(default_factory=list)

    def add(self, parts: Mapping[int, Array], constant: Array) -> None:
        """``constant + sum parts[first][i] x[first + i]`` is to be positive semidefinite; parts are stacks."""
        from scipy import sparse

        columns = np.concatenate([first + np.arange(len(part)) for first, part in parts.items()])
        values = np.vstack([(0.5 * (part + np.swapaxes(part, 1, 2))).reshape(len(part), -1) for part in parts.values()])
        which, rows = np.nonzero(values)
        shape = values.shape[1], self.unknowns
        self._parts.append((sparse.csr_matrix((values[which, rows], (rows, columns[which])), shape), constant))

    def least(self, cost: Array, budget: Budget, steps: int) -> SemidefiniteAnswer:
        """The x of the least ``cost x``."""
        import cvxpy as cp
        from cvxpy.error import SolverError

        x = cp.Variable(self.unknowns)
        held: list[Any] = [
            cp.reshape(part @ x + constant.ravel(), constant.shape, order="C") >> 0 for part, constant in self._parts
        ]
        problem = cp.Problem(cp.Minimize(cost @ x), held)
        work = 1e-3 * sum(part.nnz for part, _ in self._parts) * len(cost)
        options: dict[str, Any] = {"max_iter": int(np.clip(budget.left / work, 1, steps)), "accept_unknown": True}
        if np.isfinite(budget.seconds_left):
            options["time_limit"] = max(budget.seconds_left, 1e-3)
        try:
            with warnings.catch_warnings():
                # Whoever asked proves the answer anew.
                warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
                problem.solve(solver=cp.CLARABEL, warm_start=False, **options)
        except SolverError as error:
            return SemidefiniteAnswer(None, str(error))
        budget.spend((problem.solver_stats.num_iters or 0) * work)
        found = x.value
        return SemidefiniteAnswer(found if found is not None and np.isfinite(found).all() else None, problem.status)
