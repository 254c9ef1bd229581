r"""The inequality of Kalman, Yakubovich and Popov with unknown multipliers: solved, and then proved without the solver.

.. math:: \begin{bmatrix} A^T P + P A & P B \\ B^T P & 0 \end{bmatrix}
    + \sum_i \begin{bmatrix} C_i & D_i \end{bmatrix}^T M_i(\lambda) \begin{bmatrix} C_i & D_i \end{bmatrix}
    + \begin{bmatrix} C_z & D_z \end{bmatrix}^T \begin{bmatrix} C_z & D_z \end{bmatrix} - \gamma^2 E \prec 0

P is symmetric, of either sign: A is stable by itself. What the solver says counts for nothing. Two voices judge its P
and lambda: the matrix above is formed again and shown to be negative definite by a Cholesky factorisation beyond the
bound of all rounding (Rump), and the frequency-domain inequality is looked at at and between all frequencies which the
eigenvalues of its Hamiltonian name, none left out by a tolerance.

References
----------
Rantzer 1996; Megretski, Rantzer 1997; Rump, "Verification of positive definiteness", BIT 46 (2006).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget
from robustlab.conic import ACCEPTED, Cone, solve, triangle
from robustlab.iqc.filtered_model import FilteredModel, Rows
from robustlab.iqc.multipliers import Term, l1_norm
from robustlab.uncertainty.upper_lft import balanced

__all__ = ["Channels", "Inequality", "Judgement", "Point"]

EPS = float(np.finfo(float).eps)
STEPS = 200
# Least eigenvalue of every multiplier's unknowns as a share of the inequality's slack.
INSIDE = 1e-2
# Frequencies in the model's own time unit that the second voice looks at besides its candidates.
GRID = (1e-3, 1e3, 61)
# Relative rounding of an L1 norm, well above what its few exponentials can lose.
NORM_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Point:
    """P, the unknowns of every term, and gamma^2."""

    P: Array
    unknowns: tuple[Array, ...]
    square: float
    slack: float


@dataclass(frozen=True)
class Judgement:
    """What both voices say of a point.

    ``slack`` is the distance of the matrix from singular, ``rounding`` the bound of its error; ``highest`` the largest
    eigenvalue of the frequency-domain inequality at any candidate, over the largest part of it there.
    """

    proved: bool
    slack: float
    rounding: float
    highest: float
    at: float


class Channels(NamedTuple):
    """Responses at one frequency over all inputs of an inequality: y, and block -> (z, w)."""

    y: AnyArray
    blocks: Mapping[str, tuple[AnyArray, AnyArray]]


class Heard(Protocol):
    """The loop as it was given, for the second voice."""

    def at(self, omega: AnyArray) -> Iterator[tuple[float, Channels]]:
        """Frequency and responses, frequencies in this inequality's time unit."""
        ...

    def given(self, point: Point, terms: Sequence[Term]) -> tuple[Array, Array]:
        """P and all unknowns of a point in the units of the loop as it was given."""
        ...


class Inequality:
    """One model with its terms.

    Parameters
    ----------
    loop
        The second voice's responses.
    model
        With all filters.
    terms
        Constraints of the blocks.
    z
        Rows of the performance outputs; None: stability alone.
    w
        Which inputs the performance inputs are.
    """

    def __init__(self, model: FilteredModel, terms: Sequence[Term], z: Rows | None, w: slice, loop: Heard) -> None:
        self.A, self.B, self.terms, self.loop = model.A, model.B, list(terms), loop
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
        """The inequality without P."""
        found = self.z.T @ self.z - square * self.E
        for term, rows, x in zip(self.terms, self.rows, unknowns, strict=True):
            found = found + rows.T @ term.middle(x) @ rows
        return 0.5 * (found + found.T)

    def _size(self, point: Point) -> float:
        """Bound of the norm of the error with which the matrix is formed: one of its products, entry by entry."""
        p, a, b = np.abs(point.P), np.abs(self.A), np.abs(self.B)
        pa, pb = p @ a, p @ b
        found = np.block([[pa + pa.T, pb], [pb.T, np.zeros((self.m, self.m))]])
        found += np.abs(self.z).T @ np.abs(self.z) + point.square * self.E
        for term, rows, x in zip(self.terms, self.rows, point.unknowns, strict=True):
            found += np.abs(rows).T @ np.abs(term.middle(x)) @ np.abs(rows)
        # Each entry is a sum of products of at most three factors; the entries of the model may be off by a rounding
        # each (states and time are scaled), those of M by a few.
        steps = 3 * (self.n + self.m) + max((len(r) for r in self.rows), default=0) + len(self.rows) + 20
        return steps * EPS * float(found.sum(axis=1).max(initial=0.0))

    # --- the solver ---------------------------------------------------------------------------------------------------

    def solve(self, budget: Budget, square: float | None = None) -> Point | None:
        """Least gamma^2 (``square`` None), or at a given one the point with most slack; None where there is none."""
        least = square is None and self.has_gain
        rows, constant, cost, sizes, fixed = self._cone_data(least, square)
        x = _clarabel(rows, constant, cost, sizes, fixed, budget)
        if x is None:
            return None
        parts = np.split(x[:-1], np.cumsum(self.counts)[:-1])
        P = np.zeros((self.n, self.n))
        P[np.triu_indices(self.n)] = parts[0]
        last = float(x[-1])
        found, slack = (last, 0.0) if least else (square or 0.0, last)
        return Point(P + np.triu(P, 1).T, tuple(parts[1:]), found, slack)

    def _cone_data(
        self, least: bool, square: float | None
    ) -> tuple[Array, Array, Array, list[int], tuple[Array, float] | None]:
        """Rows, constants and cost of "constant + rows x in the cones"; the last unknown is gamma^2 or the slack."""
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

    # --- the proof ----------------------------------------------------------------------------------------------------

    def judged(self, point: Point) -> Judgement:
        """Both voices on a point."""
        F = -(self._kyp(point.P) + self.supply(point.unknowns, point.square))
        rounding = self._size(point)
        matrix = is_positive(F, rounding)
        slack = float(np.linalg.eigvalsh(F)[0]) - rounding if np.isfinite(F).all() else -np.inf
        highest, at = self._over_frequency(point)
        proved = matrix and highest < 0 and self.multipliers_hold(point)
        return Judgement(proved, slack, rounding, highest, at)

    def multipliers_hold(self, point: Point) -> bool:
        """Whether every multiplier is one of its class: its X positive definite, its h within the L1 norm."""
        for term, x in zip(self.terms, point.unknowns, strict=True):
            for part in term.positive(x):
                if not is_positive(part, 8 * EPS * len(part) * float(np.abs(part).max())):
                    return False
            if term.kernels is not None:
                causal, anti, direct = term.kernels(x)
                if l1_norm(causal) + l1_norm(anti) > direct * (1 - NORM_ROUNDING):
                    return False
        return True

    def _over_frequency(self, point: Point) -> tuple[float, float]:
        """The largest relative eigenvalue at all candidates, and its frequency in rad/s of this time unit.

        From the transfer functions of the model as it was given and of the filters: nothing of this class's states.
        """
        omega = self._candidates(self.supply(point.unknowns, point.square))
        if not len(omega):
            return np.inf, np.nan
        top = np.array([self._relative(point, w, channels) for w, channels in self.loop.at(omega)])
        worst = int(np.argmax(top))
        return float(top[worst]), float(omega[worst])

    def _relative(self, point: Point, omega: float, channels: Channels) -> float:
        """Largest eigenvalue of the inequality at one frequency, over its largest part."""
        inputs = np.eye(self.m)
        form = channels.y.conj().T @ channels.y - point.square * self.E[self.n :, self.n :]
        size = np.abs(form).max(initial=0.0)
        for term, x in zip(self.terms, point.unknowns, strict=True):
            v = term.heard(1j * omega, *channels.blocks[term.block], inputs)
            part = v.conj().T @ term.middle(x) @ v
            form, size = form + part, max(size, np.abs(part).max())
        return float(np.linalg.eigvalsh(0.5 * (form + form.conj().T))[-1] / max(size, 1e-300))

    def _candidates(self, S: Array) -> AnyArray:
        """Imaginary parts of all eigenvalues of the Hamiltonian, points between and beyond them, and a grid."""
        n = self.n
        Q, N, R = S[:n, :n], S[:n, n:], S[n:, n:]
        try:
            with np.errstate(all="ignore"):
                feedback = np.linalg.solve(R, np.hstack([N.T, self.B.T]))
                a = self.A - self.B @ feedback[:, :n]
                hamiltonian = np.block([[a, -self.B @ feedback[:, n:]], [-Q + N @ feedback[:, :n], -a.T]])
                height = np.abs(np.linalg.eigvals(balanced(hamiltonian)).imag)
        except np.linalg.LinAlgError:  # no strict inequality at infinity, or numbers beyond all measure
            return np.array([])
        found = np.unique(np.append(height, 0.0))
        between = 0.5 * (found[:-1] + found[1:])
        beyond = [2 * found[-1] + 1.0, 10 * found[-1] + 10.0]
        return np.unique(np.concatenate([found, between, beyond, np.geomspace(*GRID)]))


def is_positive(matrix: Array, error: float = 0.0) -> bool:
    """Whether a symmetric matrix is positive definite, and so is each within ``error`` of it in norm: proved.

    Cholesky's factorisation of the matrix less the bound of its own rounding ends without a root of what is negative.
    """
    n = len(matrix)
    if not np.isfinite(matrix).all():
        return False
    own = (n + 2) * EPS / (1 - (n + 2) * EPS)
    shift = error + 2 * own * float(np.abs(np.diag(matrix)).sum()) + n * 1e-300
    try:
        np.linalg.cholesky(matrix - shift * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


def _clarabel(
    rows: Array, constant: Array, cost: Array, sizes: list[int], fixed: tuple[Array, float] | None, budget: Budget
) -> Array | None:
    """Least ``cost x`` with ``constant + rows x`` in cones of symmetric matrices; None where there is no answer."""
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
