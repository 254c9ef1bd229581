r"""The inequality of Kalman, Yakubovich and Popov with unknown multipliers, as a solver takes it.

.. math:: \begin{bmatrix} A^T P + P A & P B \\ B^T P & 0 \end{bmatrix}
    + \sum_i \begin{bmatrix} C_i & D_i \end{bmatrix}^T M_i(\lambda) \begin{bmatrix} C_i & D_i \end{bmatrix}
    + \begin{bmatrix} C_z & D_z \end{bmatrix}^T \begin{bmatrix} C_z & D_z \end{bmatrix} - \gamma^2 E \prec 0

P is symmetric, of either sign: A is stable by itself. The solver's P and lambda are only candidates: they are proved in
ball arithmetic for the given model (`robustlab.verification.iqc`).

References
----------
Rantzer 1996; Megretski, Rantzer 1997.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.conic import ACCEPTED, Cone, solve, triangle
from robustlab.iqc.filtered_model import FilteredModel, Rows
from robustlab.iqc.multipliers import Term, symmetric

__all__ = ["Inequality", "Point"]

STEPS = 200
# Least eigenvalue of every multiplier's unknowns as a share of the inequality's slack.
INSIDE = 1e-2


@dataclass(frozen=True, eq=False)
class Point:
    """P, the unknowns of every term, and gamma^2."""

    P: Array
    unknowns: tuple[Array, ...]
    square: float


class Inequality:
    """A model with all filters and its terms; ``z``, ``w``: performance outputs (None: stability alone) and inputs."""

    def __init__(self, model: FilteredModel, terms: Sequence[Term], z: Rows | None, w: slice) -> None:
        self.A, self.B, self.terms = model.A, model.B, list(terms)
        n, m = model.n, model.m
        self.n, self.m, self.has_gain = n, m, z is not None
        self.rows = [np.hstack([t.rows.padded(n, m).c, t.rows.padded(n, m).d]) for t in terms]
        self.z = np.zeros((0, n + m)) if z is None else np.hstack([z.padded(n, m).c, z.padded(n, m).d])
        self.E = np.zeros((n + m, n + m))
        if self.has_gain:
            self.E[n + w.start : n + w.stop, n + w.start : n + w.stop] = np.eye(w.stop - w.start)
        self.counts = [n * (n + 1) // 2, *(t.count for t in terms)]

    # --- the matrices -------------------------------------------------------------------------------------------------

    def _kyp(self, P: Array) -> Array:
        pa, pb = P @ self.A, P @ self.B
        return np.block([[pa + pa.T, pb], [pb.T, np.zeros((self.m, self.m))]])

    def supply(self, unknowns: Sequence[Array], square: float) -> Array:
        """Return the inequality without P."""
        found = self.z.T @ self.z - square * self.E
        for term, rows, x in zip(self.terms, self.rows, unknowns, strict=True):
            found = found + rows.T @ term.middle(x) @ rows
        return 0.5 * (found + found.T)

    # --- the solver ---------------------------------------------------------------------------------------------------

    def solve(self, budget: Budget, square: float | None = None) -> Point | None:
        """Minimise gamma^2 (``square`` None), or maximise the slack at a given one; None where infeasible."""
        least = square is None and self.has_gain
        rows, constant, cost, sizes, fixed = self._cone_data(least, square)
        x = _clarabel(rows, constant, cost, sizes, fixed, budget)
        if x is None:
            return None
        parts = np.split(x[:-1], np.cumsum(self.counts)[:-1])
        return Point(symmetric(parts[0], self.n), tuple(parts[1:]), float(x[-1]) if least else square or 0.0)

    def _cone_data(
        self, least: bool, square: float | None
    ) -> tuple[Array, Array, Array, list[int], tuple[Array, float] | None]:
        """Return rows, constants, cost of "constant + rows x in cones"; the last unknown is gamma^2 or the slack."""
        n, total = self.n, sum(self.counts) + 1
        side = n + self.m
        base = -self.supply([np.zeros(t.count) for t in self.terms], 0.0 if least else square or 0.0)
        sizes = [side]
        columns: list[list[tuple[int, Array]]] = []  # for every unknown: cone, matrix
        for i in range(n):
            for j in range(i, n):
                P = np.zeros((n, n))
                P[i, j] = P[j, i] = 1.0
                columns.append([(0, -self._kyp(P))])
        for term, rows in zip(self.terms, self.rows, strict=True):
            first = len(sizes)
            sizes += [len(part) for part in term.positive(np.zeros(term.count))]
            for k in range(term.count):
                unit = np.zeros(term.count)
                unit[k] = 1.0
                entry = [(0, -(rows.T @ term.middle(unit) @ rows))]
                columns.append([*entry, *((first + i, part) for i, part in enumerate(term.positive(unit)))])
        if least:
            columns.append([(0, self.E)])
        else:
            inside = [(i, -INSIDE * np.eye(size)) for i, size in enumerate(sizes) if i]
            columns.append([(0, -np.eye(side)), *inside])
        starts = np.concatenate([[0], np.cumsum([s * (s + 1) // 2 for s in sizes])])
        matrix, constant = np.zeros((starts[-1], total)), np.zeros(starts[-1])
        constant[: starts[1]] = triangle(base)
        for k, parts in enumerate(columns):
            for cone, part in parts:
                matrix[starts[cone] : starts[cone + 1], k] += triangle(part)
        cost = np.zeros(total)
        cost[-1] = 1.0 if least else -1.0
        if self.has_gain:
            return matrix, constant, cost, sizes, None
        # Without a gain the inequality is homogeneous: one sum of all multipliers fixes its scale.
        weight = np.zeros(total)
        for k, parts in enumerate(columns[:-1]):
            weight[k] = sum(float(np.trace(part)) for cone, part in parts if cone)
        return matrix, constant, cost, sizes, (weight, float(len(sizes)))

    def slack_of(self, point: Point) -> float:
        """Return the smallest eigenvalue of the inequality at a point; negative where it does not hold."""
        F = -(self._kyp(point.P) + self.supply(point.unknowns, point.square))
        return float(np.linalg.eigvalsh(F)[0]) if np.isfinite(F).all() else -np.inf


def _clarabel(
    rows: Array, constant: Array, cost: Array, sizes: list[int], fixed: tuple[Array, float] | None, budget: Budget
) -> Array | None:
    """Minimise ``cost x`` with ``constant + rows x`` in cones of symmetric matrices; None where that failed."""
    cones: list[Cone] = [("semidefinite", size) for size in sizes]
    matrix, right = -rows, constant
    if fixed is not None:
        cones = [("zero", 1), *cones]
        matrix, right = np.vstack([fixed[0], matrix]), np.append(fixed[1], right)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-8)
    work = 2e-4 * matrix.shape[1] ** 2 * matrix.shape[0]  # of a step, as measured
    seconds = max(budget.seconds_left, 1e-3) if np.isfinite(budget.seconds_left) else None
    most = np.clip(budget.left / work, 1, STEPS)
    found = solve(cost / scale, matrix / scale, right, cones, steps=most, seconds=seconds)
    if found is None:
        return None
    budget.spend(found.iterations * work)
    x = np.array(found.x) / scale
    return x if str(found.status) in ACCEPTED and np.isfinite(x).all() else None
