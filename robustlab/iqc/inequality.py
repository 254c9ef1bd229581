r"""Multipliers, the integral quadratic constraints of blocks with unknowns, and the inequality that a solver takes.

The constraints :math:`\int_0^\infty v^T M v \, dt \ge 0`, :math:`v = \Psi (z, w)`, and the order of their unknowns
lambda are those of robustlab/verification/theorems.md. In the inequality of Kalman, Yakubovich and Popov (Rantzer 1996)

.. math:: \begin{bmatrix} A^T P + P A & P B \\ B^T P & 0 \end{bmatrix}
    + \sum_i \begin{bmatrix} C_i & D_i \end{bmatrix}^T M_i(\lambda) \begin{bmatrix} C_i & D_i \end{bmatrix}
    + \begin{bmatrix} C_z & D_z \end{bmatrix}^T \begin{bmatrix} C_z & D_z \end{bmatrix} - \gamma^2 E \prec 0

P is symmetric, of either sign: A is stable by itself. The solver's P and lambda are only candidates, which
`robustlab.verification.iqc` proves in ball arithmetic for the given model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.conic import ACCEPTED, Cone, solve, triangle
from robustlab.iqc.block_types import BlockType, Nonlinearity, Varying

STEPS = 200
# Least eigenvalue of every multiplier's unknowns as a share of the inequality's slack.
INSIDE = 1e-2
MOST = 100_000  # unknowns of all multipliers


class Filtered:
    """The model ``A, B, C, D`` with the filters of its constraints; a signal is a matrix of rows over (x, u).

    ``filters`` states and ``extra`` inputs are the totals, so that every row has its final length.
    """

    def __init__(self, A: Array, B: Array, C: Array, D: Array, filters: int, extra: int) -> None:
        self.n, self.width = len(A) + filters, len(A) + filters + B.shape[1] + extra
        self._C, self._states, self._inputs = C, len(A), self.n + B.shape[1]
        self._rates = [self._wide(A, B)]
        self.outputs = self._wide(C, D)

    def _wide(self, C: Array, D: Array) -> Array:
        found = np.zeros((len(C), self.width))
        found[:, : C.shape[1]], found[:, self.n : self.n + D.shape[1]] = C, D
        return found

    @property
    def rates(self) -> Array:
        return np.vstack(self._rates)

    def input(self, columns: slice) -> Array:
        return np.eye(self.width)[self.n + columns.start : self.n + columns.stop]

    def added(self, count: int) -> Array:
        self._inputs += count
        return np.eye(self.width)[self._inputs - count : self._inputs]

    def stages(self, signal: Array, pole: float, order: int, driven: Sequence[Array] = ()) -> list[Array]:
        """Return the signal behind each power of ``a / (s + a)``; ``driven``: a further input of each stage."""
        found: list[Array] = []
        for j in range(order):
            own = np.eye(self.width)[self._states : self._states + len(signal)]
            rate = pole * ((found[-1] if found else signal) - own)
            self._rates.append(rate + driven[j] if driven else rate)
            self._states += len(signal)
            found.append(own)
        return found

    def derivative(self, rows: slice) -> Array:
        return self._C[rows] @ self._rates[0]


class Unknowns:
    """The unknowns of all multipliers, read in their order, and the matrices of them that must be positive."""

    def __init__(self, values: Array) -> None:
        self.values, self.at = values, 0
        self.positive: list[Array] = []

    def take(self, count: int) -> Array:
        self.at += count
        return self.values[self.at - count : self.at]

    def skew(self, size: int) -> Array:
        X = np.zeros((size, size))
        X[np.triu_indices(size, 1)] = self.take(size * (size - 1) // 2)
        return X - X.T

    def definite(self, size: int) -> Array:
        X = np.zeros((size, size))
        X[np.triu_indices(size)] = self.take(size * (size + 1) // 2)
        X = X + np.triu(X, 1).T
        self.positive.append(X)
        return X


Form = Callable[[Unknowns], Array]  # the quadratic form v^T M v over (x, u)


def filter_order(block_type: BlockType | None, order: int) -> int:
    """Return the highest power of a filter that the constraints of a block allow."""
    if isinstance(block_type, Varying):
        return order if math.isfinite(block_type.rate) else 0
    return order if block_type is None or (block_type.slope is not None and block_type.steady) else 0


def linear(
    F: Filtered, z: Array, w: Array, order: int, pole: float, *, scalar: bool, real: bool, rate: float
) -> tuple[str, Form]:
    """Return the kinds and the form of a linear block of gain one: ``rate`` is the bound of a real scalar, else inf."""
    rated, count = bool(order) and math.isfinite(rate), len(z)
    behind_z = F.stages(z, pole, order)
    moved = F.added(order * count) if rated else z[:0]  # delta' x / rate, x the states of the stages
    behind_w = F.stages(w, pole, order, [rate * part for part in np.split(moved, order)] if rated else ())
    above, below = np.vstack([z, *behind_z]), np.vstack([w, *behind_w])
    size, copies = ((order + 1) * count, (1, 1)) if scalar else (order + 1, (count, len(w)))

    def scaled(above: Array, below: Array, size: int, copies: tuple[int, int], x: Unknowns) -> Array:
        X = x.definite(size)
        over, under = (np.kron(X, np.eye(k)) for k in copies)
        cross = above.T @ x.skew(size) @ below if real else 0.0
        return above.T @ over @ above - below.T @ under @ below + cross + np.transpose(cross)

    def form(x: Unknowns) -> Array:
        found = scaled(above, below, size, copies, x)
        return found + scaled(np.vstack(behind_z), moved, order * count, (1, 1), x) if rated else found

    kind = ("real parameter" if real else "dynamics") + ("" if order else ", static multiplier")
    return f"{kind}, its rate" if rated else kind, form


def law(
    F: Filtered, rows: slice, w: Array, order: int, pole: float, block_type: Nonlinearity, free: tuple[bool, bool]
) -> tuple[str, Form]:
    """Return the kinds and the form of a memoryless law of sector [-1, 1].

    ``free``: its input has no direct term from any block, from any input. If it has, only constraints are used that
    hold for differences of two signals too: these make the loop well posed.
    """
    z, popov = F.outputs[rows], free[1] and block_type.steady
    rate = F.derivative(rows) if popov else z
    m, k = block_type.slope or (0.0, 0.0)
    p, q = k * z - w, w - m * z
    behind_q, behind_p = F.stages(q, pole, order), F.stages(p, pole, order)
    signs = (1.0, -1.0) if block_type.odd else (1.0,)

    def form(x: Unknowns) -> Array:
        half = np.zeros((F.width, F.width))
        if free[0]:
            half += 0.5 * x.definite(1)[0, 0] * (z.T @ z - w.T @ w)
        if popov:
            half += x.take(1)[0] * rate.T @ w
        if block_type.slope is not None:
            direct, mass = x.take(1)[0], 0.0
            half += direct * p.T @ q
            for one, behind in ((p, behind_q), (q, behind_p)) if order else ():  # both directions of time
                for sign in signs:
                    h = _kernel(x, order)
                    mass += h.sum()
                    half -= sign * one.T @ sum(c * stage for c, stage in zip(h, behind, strict=True))
            x.positive.append(np.array([[direct - mass]]))
        return half + half.T

    falb = "" if block_type.slope is None else "Zames-Falb" if order else "slope, static multiplier"
    return ", ".join(word for word in ("sector" * free[0], "Popov" * popov, falb) if word), form


def _kernel(x: Unknowns, order: int) -> Array:
    r"""Read c of :math:`h(t) = a e^{-a t} \sum_l c_l (a t)^l / l!`."""
    # With s_i = (a t)^i / i! every polynomial that is nonnegative for t >= 0 is s' Q1 s + a t s' Q2 s.
    found = np.zeros(order)
    for shift in range(min(order, 2)):
        Q = x.definite((order - 1 - shift) // 2 + 1)
        for i, j in np.ndindex(Q.shape):
            found[i + j + shift] += Q[i, j] * math.factorial(i + j + shift) / math.factorial(i) / math.factorial(j)
    return found


class Point(NamedTuple):
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
        ends = [0]
        for _, form in forms:  # each reads its unknowns after those of the others
            form(reader)
            ends.append(reader.at)
        self.squares = np.repeat([square for square, _ in forms], np.diff(ends))
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
        x, square = x[:-1], float(x[-1]) if least else square or 0.0
        # The point in the units of the given model.
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
