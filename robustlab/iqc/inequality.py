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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.conic import ACCEPTED, Cone, solve, triangle
from robustlab.iqc.multipliers import Filtered, Form, Unknowns

__all__ = ["Inequality", "Point"]

STEPS = 200
# Least eigenvalue of every multiplier's unknowns as a share of the inequality's slack.
INSIDE = 1e-2
MOST = 100_000  # unknowns of all multipliers


@dataclass(frozen=True, eq=False)
class Point:
    """P, the unknowns of all multipliers, gamma^2, and the smallest eigenvalue of the inequality."""

    P: Array
    multipliers: Array
    square: float
    slack: float


class Inequality:
    """The inequality of a model with its filters, solved in larger or smaller units.

    ``units``: of the states and inputs, (n + m,); ``blocks``: name -> kinds of its constraints, their form, and the
    square of the unit of its channels; ``z``, ``w``: performance outputs (none: stability alone) and inputs.
    """

    def __init__(
        self, F: Filtered, units: Array, blocks: Mapping[str, tuple[str, Form, float]], z: Array, w: Array
    ) -> None:
        self.units, self.n, n = units, F.n, F.n
        self.kinds = {name: kinds for name, (kinds, *_) in blocks.items()}
        forms = [(square, form) for _, form, square in blocks.values()]
        self.has_gain = bool(len(z))
        scaled = units[:, None] * units
        reader = Unknowns(np.zeros(MOST))
        self.squares = np.concatenate([np.full(_count(form, reader), square) for square, form in forms])
        sizes = [F.width, *(len(X) for X in reader.positive)]
        self.sizes, self.starts = sizes, np.cumsum([0, *(size * (size + 1) // 2 for size in sizes)])
        rates, count = F.rates * units / units[:n, None], n * (n + 1) // 2
        self.columns = np.zeros((count + len(self.squares), self.starts[-1]))
        for k, (i, j) in enumerate(zip(*np.triu_indices(n), strict=True)):
            G = np.zeros((F.width, F.width))
            G[i] = rates[j]
            if i != j:
                G[j] = rates[i]
            self.columns[k, : self.starts[1]] = triangle(-(G + G.T))
        for k, unit in enumerate(np.eye(len(self.squares))):
            reader = Unknowns(unit)
            supply = sum(square * form(reader) for square, form in forms)
            self.columns[count + k] = np.concatenate([triangle(X) for X in (-scaled * supply, *reader.positive)])
        self.constant = np.zeros((2, self.starts[-1]))  # without gamma^2, and its factor
        self.constant[:, : self.starts[1]] = triangle(scaled * np.array([-z.T @ z, w.T @ w]))

    def solve(self, budget: Budget, square: float | None = None) -> Point | None:
        """Minimise gamma^2 (``square`` None), or maximise the slack at a given one; None where infeasible."""
        least = self.has_gain and square is None
        constant = self.constant[0] + self.constant[1] * (square or 0.0)
        slack = [-np.eye(size) * (INSIDE if i else 1.0) for i, size in enumerate(self.sizes)]
        last = self.constant[1] if least else np.concatenate([triangle(X) for X in slack])
        rows = np.vstack([self.columns, last]).T
        cones: list[Cone] = [("semidefinite", size) for size in self.sizes]
        matrix, right = -rows, constant
        if not self.has_gain:
            # Without a gain the inequality is homogeneous: one sum of all multipliers fixes its scale.
            trace = np.concatenate([triangle(np.eye(size)) * bool(i) for i, size in enumerate(self.sizes)])
            weight = np.append(self.columns @ trace, 0.0)
            cones = [("zero", 1), *cones]
            matrix, right = np.vstack([weight, matrix]), np.append(float(len(self.sizes)), right)
        scale = np.maximum(np.abs(matrix).max(axis=0), 1e-8)
        work = 2e-4 * matrix.shape[1] ** 2 * matrix.shape[0]  # of a step, as measured
        seconds = max(budget.seconds_left, 1e-3) if np.isfinite(budget.seconds_left) else None
        most, cost = np.clip(budget.left / work, 1, STEPS), np.zeros(len(scale))
        cost[-1] = (1.0 if least else -1.0) / scale[-1]
        found = solve(cost, matrix / scale, right, cones, steps=most, seconds=seconds)
        if found is None:
            return None
        budget.spend(found.iterations * work)
        x = np.array(found.x) / scale
        if str(found.status) not in ACCEPTED or not np.isfinite(x).all():
            return None
        return self._point(x[:-1], float(x[-1]) if least else square or 0.0)

    def _point(self, x: Array, square: float) -> Point:
        """Return a point in the units of the given model."""
        n, at = self.n, self.n * (self.n + 1) // 2
        P = np.zeros((n, n))
        P[np.triu_indices(n)] = x[:at]
        P = P + np.triu(P, 1).T
        entries = (self.constant[0] + self.constant[1] * square + x @ self.columns)[: self.starts[1]]
        whole = np.zeros((self.sizes[0], self.sizes[0]))
        columns, rows = np.tril_indices(len(whole))
        whole[rows, columns] = whole[columns, rows] = np.where(rows == columns, entries, entries / np.sqrt(2.0))
        slack = float(np.linalg.eigvalsh(whole)[0]) if np.isfinite(whole).all() else -np.inf
        return Point(P / np.outer(self.units[:n], self.units[:n]), x[at:] * self.squares, square, slack)


def _count(form: Form, reader: Unknowns) -> int:
    """Return the number of unknowns of a form, read after others."""
    before = reader.at
    form(reader)
    return reader.at - before
