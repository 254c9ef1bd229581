r"""Smallest gamma over all lines: cone programmes from above, multipliers from below.

A block of size gamma explains w from z if :math:`|w_k|^2 \le \gamma^2 |z_k|^2`. With the tangent
:math:`\epsilon_k = 2 \operatorname{Re} \bar z^c_k z_k - |z^c_k|^2 \le |z_k|^2` that is kept by
:math:`|w_k|^2 \le g\, \epsilon_k`, :math:`g = \gamma^2`, a second-order cone: exact where z is known (then
:math:`\epsilon = |z|^2`), otherwise repeated around the last z (convex-concave procedure).

From below, for any :math:`D_{ik} \ge 0` and :math:`\Lambda \ge 0`

.. math:: L = \sum_{ik} D_{ik} (\gamma_i^2 |z_{ik}|^2 - |w_{ik}|^2) + \sum_j \Lambda_j
              \Bigl(r_j^2 - \sum_k \omega_k |n_{jk}|^2\Bigr) \ge 0

at every explanation, so :math:`\max_w L < 0` disproves gamma; the maximum is one small Hermitian system at each line.
With at most three such forms the test loses nothing (S-procedure over complex numbers); with more it is a relaxation.

One cone programme, solved by Clarabel within a budget: iterations are counted, and spent.

References
----------
Smith and Doyle (1992), section IV; Huang and Zhang, "Complex matrix decomposition and quadratic programming",
Mathematics of Operations Research 32 (2007), theorem 2.1, for when the multipliers are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.spectral_problem import SpectralProblem

__all__ = [
    "LineMultipliers",
    "SpectralSizes",
    "largest_disproved_at",
    "line_lagrangian",
    "smallest_by_lines",
    "solved_cones",
]


# Iterations: as many as the solver takes at most, and those that any programme gets.
MOST, LEAST = 200, 20
# Work of setting a programme up and of an iteration, per stored entry of A, as measured.
BUILDING, ITERATION = 2.0, 0.5


def solved_cones(P: Any, cost: Any, A: Any, b: Any, cones: list[Any], budget: Budget) -> Any:
    """Clarabel's answer to ``min x P x / 2 + cost x`` subject to ``b - A x`` in the cones; sparse P and A.

    The budget limits the iterations; a time limit, where there is one, is the solver's too, which needs a second.

    Raises
    ------
    NoTrustworthyNumber
        The solver breaks down.
    """
    clarabel: Any = import_module("clarabel")  # its types are not published
    each = 50 + ITERATION * A.nnz
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.max_iter = int(min(max(budget.left / each, LEAST), MOST))
    if budget.seconds_left < 1e6:
        settings.time_limit = max(budget.seconds_left, 1.0)
    try:
        found = clarabel.DefaultSolver(P, cost, A, b, cones, settings).solve()
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        raise NoTrustworthyNumber("validate", f"the solver broke down ({type(error).__name__})") from None
    budget.spend(200 + BUILDING * A.nnz + found.iterations * each)
    if str(found.status) == "MaxTime":
        budget.strike()
    return found


ROUNDS = 30
SLACK = 1e-9
MARGIN = 1e-9  # the programmes aim this far inside the noise bound
FLOOR = 1e-9
HALVINGS = 60


@dataclass(frozen=True)
class LineMultipliers:
    """Multipliers of a certificate: D (n, blocks), and noise (n, n_y); the same over all lines for a total bound."""

    D: Array
    noise: Array


@dataclass(frozen=True)
class SpectralSizes:
    """What `smallest_by_lines` found.

    Attributes
    ----------
    lower, upper
        Bounds of gamma; both inf where no Delta of any size explains the data.
    w
        (n, q); zeros where nothing was found.
    multipliers
        Those of the lower bound.
    least_noise
        By what factor the noise bound would have to grow for any Delta at all to explain the data; at most 1: none.
    known
        Whether z is known, and the test thereby convex.
    recheck
        The lower bound once more, from the multipliers alone.
    """

    lower: float
    upper: float
    w: ComplexArray
    multipliers: LineMultipliers
    least_noise: float
    known: bool
    recheck: Callable[[], float] | None


def smallest_by_lines(
    problem: SpectralProblem, scaled: NDArray[np.bool_], precision: float, budget: Budget
) -> SpectralSizes:
    """Bounds over the blocks that ``scaled`` names; the others keep the size 1.

    Raises
    ------
    NoTrustworthyNumber
        The solver gives no answer, or an impossibility that its multipliers do not prove.
    """
    programme = _Programme(problem, scaled, budget)
    known = not np.abs(problem.M11).max(initial=0.0)
    none = np.zeros((problem.n, problem.M21.shape[2]), dtype=complex)
    empty = LineMultipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))
    if problem.excess(problem.noise(none)) <= 1:
        return SpectralSizes(0.0, 0.0, none, empty, problem.excess(problem.noise(none)), known, None)
    free = programme.least_noise()
    least = problem.excess(problem.noise(free.w))
    if least > 1 + SLACK:
        multipliers = LineMultipliers(empty.D, programme.multipliers(free).noise)
        if not line_lagrangian(problem, multipliers, np.ones(len(problem.blocks))) < 0:
            raise NoTrustworthyNumber("validate", f"the noise bound is missed by {least - 1:.1e} of itself, unproved")
        return SpectralSizes(np.inf, np.inf, none, multipliers, least, known, None)
    best, at, lower, multipliers = np.inf, none, 0.0, empty
    for start in (problem.z0, problem.z(free.w)):
        gamma, w, solved = _descend(problem, programme, scaled, start, known, precision)
        if solved is not None:
            trial = programme.multipliers(solved)
            # With several programmes in one the multipliers of a line are those of its own gamma: the worst decides.
            disproved = largest_disproved_at(problem, trial, scaled, _reach(gamma, solved))
            lower, multipliers = (disproved, trial) if disproved > lower else (lower, multipliers)
        if gamma < best:
            best, at = gamma, w
        if known or lower >= best * (1 - precision):
            break

    def recheck() -> float:
        return largest_disproved_at(problem, multipliers, scaled, lower * (1 + 1e-6))

    return SpectralSizes(lower, best, at, multipliers, min(least, 1.0), known, recheck if lower > 0 else None)


def _reach(gamma: float, solved: _Solved) -> float:
    """From where to look for what is disproved."""
    return gamma if np.isfinite(gamma) else float(np.sqrt(solved.g.max(initial=0.0)))


def _descend(
    problem: SpectralProblem,
    programme: _Programme,
    scaled: NDArray[np.bool_],
    z: ComplexArray,
    known: bool,
    precision: float,
) -> tuple[float, ComplexArray, _Solved | None]:
    """Best gamma that its own w shows, that w, and the last programme solved."""
    best, at, last, before = np.inf, np.zeros_like(problem.e[:, :0]), None, np.inf
    for _ in range(1 if known else ROUNDS):
        solved = programme.smallest(z)
        if solved is None:
            break
        last = solved
        z = problem.z(solved.w)
        gamma = shown_size(problem, solved.w, scaled)
        if gamma < best:
            best, at = gamma, solved.w
        if gamma > before * (1 - 0.02 * precision) or programme.budget.over:
            break
        before = gamma
    return best, at, last


def shown_size(problem: SpectralProblem, w: ComplexArray, scaled: NDArray[np.bool_]) -> float:
    """Largest size of the scaled blocks that w needs; inf where it leaves too much noise or breaks another block."""
    sizes = problem.sizes(w)
    if problem.excess(problem.noise(w)) > 1 + SLACK or (sizes[:, ~scaled] > 1 + 1e-6).any():
        return np.inf
    return float(sizes[:, scaled].max(initial=0.0))


# --- certificate -----------------------------------------------------------------------------------------------------


def line_lagrangian(problem: SpectralProblem, multipliers: LineMultipliers, gammas: Array) -> float:
    """Largest value of L over all w: for a total bound of the sum over lines, else of the line where it is smallest.

    +inf where L is not bounded above. Negative is a proof.
    """
    n, p = problem.z0.shape
    q = problem.M21.shape[2]
    to_z, to_w = np.zeros((n, p)), np.zeros((n, q))
    for i, (rows, cols) in enumerate(problem.blocks):
        to_z[:, cols] = (gammas[i] ** 2 * multipliers.D[:, i])[:, None]
        to_w[:, rows] = multipliers.D[:, i][:, None]
    noise = multipliers.noise
    M11, M21 = problem.M11, problem.M21
    back = M11.conj().transpose(0, 2, 1) * to_z[:, None, :], M21.conj().transpose(0, 2, 1) * noise[:, None, :]
    H = back[0] @ M11 - back[1] @ M21
    H[:, range(q), range(q)] -= to_w
    slope = np.einsum("kij,kj->ki", back[0], problem.z0) + np.einsum("kij,kj->ki", back[1], problem.e)
    at_zero = (to_z * np.abs(problem.z0) ** 2).sum(axis=1) - (noise * np.abs(problem.e) ** 2).sum(axis=1)
    values, vectors = np.linalg.eigh(0.5 * (H + H.conj().transpose(0, 2, 1)))
    turned = np.abs(np.einsum("kij,ki->kj", vectors.conj(), slope)) ** 2
    size = np.abs(values).max(axis=1, initial=0.0)[:, None] + 1e-300
    reach = size * (np.abs(at_zero)[:, None] + 1e-300)
    flat = values > -1e-12 * size
    if problem.total:
        if (flat & ((values > 1e-12 * size) | (turned > 1e-14 * reach))).any():
            return np.inf
        gained = np.where(flat, 0.0, turned / np.where(flat, 1.0, -values)).sum(axis=1)
        Lambda = noise.max(axis=0, initial=0.0) / problem.weight.max()
        top = float(Lambda @ problem.radius**2)
        least = float((at_zero + gained).sum())
        return least + top + 1e-12 * (abs(top) + float(np.abs(at_zero).sum()) + float(gained.sum()))
    bad = (flat & ((values > 1e-12 * size) | (turned > 1e-14 * reach))).any(axis=1)
    gained = np.where(flat, 0.0, turned / np.where(flat, 1.0, -values)).sum(axis=1)
    each = at_zero + gained + noise.sum(axis=1)
    each += 1e-12 * (np.abs(at_zero) + gained + noise.sum(axis=1))
    each[bad | ~(noise.sum(axis=1) > 0)] = np.inf
    return float(each.min(initial=np.inf))


def largest_disproved_at(
    problem: SpectralProblem, multipliers: LineMultipliers, scaled: NDArray[np.bool_], start: float
) -> float:
    """Largest gamma, at most ``start``, that the multipliers disprove; L grows with gamma, so halving finds it."""

    def disproved(gamma: float) -> bool:
        return line_lagrangian(problem, multipliers, np.where(scaled, gamma, 1.0)) < 0

    if not start > 0 or not np.isfinite(start) or not disproved(0.0):
        return 0.0
    good, high = 0.0, start
    for _ in range(HALVINGS):
        middle = 0.5 * (good + high)
        good, high = (middle, high) if disproved(middle) else (good, middle)
        if high - good < 1e-7 * high:
            break
    return good


# --- programmes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Solved:
    w: ComplexArray
    g: Array
    dual: Array
    starts: NDArray[np.int_]
    order: tuple[tuple[str, int], ...]


class _Programme:
    """Cone programmes in the real and imaginary parts of w, and g: one, or one for each line where they are apart."""

    def __init__(self, problem: SpectralProblem, scaled: NDArray[np.bool_], budget: Budget) -> None:
        self.problem, self.scaled, self.budget = problem, scaled, budget
        self.q = problem.M21.shape[2]
        self.n_g = 1 if problem.total else problem.n
        self.at_g = 2 * problem.n * self.q
        self.size = self.at_g + self.n_g

    def _affine(self, gains: ComplexArray, offset: ComplexArray) -> tuple[Any, Array]:
        """Rows for real and imaginary part of ``offset_k + gains_k w_k`` (n,), one after the other at each line."""
        from scipy import sparse

        n, q = gains.shape
        cols = (2 * q * np.arange(n)[:, None] + np.arange(q)).repeat(2, axis=0).reshape(n, 2, q)
        rows = np.arange(2 * n).reshape(n, 2, 1).repeat(q, axis=2)
        re = np.stack([gains.real, gains.imag], axis=1)
        im = np.stack([-gains.imag, gains.real], axis=1)
        values = np.concatenate([re.ravel(), im.ravel()])
        at = np.concatenate([rows.ravel(), rows.ravel()]), np.concatenate([cols.ravel(), (cols + q).ravel()])
        matrix = sparse.csr_matrix((values, at), (2 * n, self.size))
        return matrix, np.stack([offset.real, offset.imag], axis=1).ravel()

    def _g(self, lines: NDArray[np.int_], values: Array) -> Any:
        """Rows that hold ``values`` times the g of each line."""
        from scipy import sparse

        which = self.at_g + (np.zeros_like(lines) if self.n_g == 1 else lines)
        return sparse.csr_matrix((values, (np.arange(len(lines)), which)), (len(lines), self.size))

    def _noise(self, free: bool) -> tuple[list[Any], list[Array], list[Any], list[tuple[str, int]]]:
        """Noise within its bound, or within g times its bound."""
        from scipy import sparse

        clarabel: Any = import_module("clarabel")  # its types are not published
        p, parts = self.problem, ([], [], [], [])
        every = np.arange(p.n)
        for j in range(p.e.shape[1]):
            rows, offset = self._affine(-p.M21[:, j], p.e[:, j])
            if p.total:
                root = np.sqrt(p.weight).repeat(2)
                radius = p.radius[j]
                head = (
                    self._g(np.zeros(1, dtype=int), np.array([radius])) if free else sparse.csr_matrix((1, self.size))
                )
                parts[0].append(-sparse.vstack([head, sparse.diags(root) @ rows]))
                parts[1].append(np.concatenate([[0.0 if free else radius * (1 - MARGIN)], root * offset]))
                parts[2].append(clarabel.SecondOrderConeT(1 + 2 * p.n))
            else:
                head = self._g(every, np.ones(p.n)) if free else sparse.csr_matrix((p.n, self.size))
                both = sparse.vstack([head, rows]).tocsr()
                ahead = np.full(p.n, 0.0 if free else 1 - MARGIN)
                turn = np.column_stack([every, p.n + 2 * every, p.n + 2 * every + 1]).ravel()
                parts[0].append(-both[turn])
                parts[1].append(np.concatenate([ahead, offset])[turn])
                parts[2].extend([clarabel.SecondOrderConeT(3)] * p.n)
            parts[3].append(("noise", j))
        return parts

    def _blocks(self, z: ComplexArray) -> tuple[list[Any], list[Array], list[Any], list[tuple[str, int]]]:
        """``(g + eps, g - eps, 2 w)`` in the cone, with the tangents eps at z."""
        from scipy import sparse

        clarabel: Any = import_module("clarabel")
        p, parts = self.problem, ([], [], [], [])
        every = np.arange(p.n)
        for i, (rows, cols) in enumerate(p.blocks):
            here = z[:, cols]
            slope = np.einsum("ki,kij->kj", here.conj(), p.M11[:, cols])
            tangent, offset = self._affine(2 * slope, 2 * (here.conj() * p.z0[:, cols]).sum(axis=1))
            tangent, offset = tangent[::2], offset[::2] - (np.abs(here) ** 2).sum(axis=1)
            ones, unit = (
                (self._g(every, np.ones(p.n)), 0.0) if self.scaled[i] else (sparse.csr_matrix(tangent.shape), 1.0)
            )
            inner = []
            for row in range(rows.start, rows.stop):
                pick = np.zeros((p.n, self.q))
                pick[:, row] = 2.0
                inner.append(self._affine(pick.astype(complex), np.zeros(p.n, dtype=complex))[0])
            stacked = sparse.vstack([ones + tangent, ones - tangent, *inner]).tocsr()
            wide = 2 * len(inner)
            heads = [every, p.n + every]
            turn = np.column_stack(
                [*heads, *((2 + 2 * k) * p.n + 2 * every + part for k in range(len(inner)) for part in (0, 1))]
            ).ravel()
            parts[0].append(-stacked[turn])
            parts[1].append(np.concatenate([unit + offset, unit - offset, np.zeros(p.n * wide)])[turn])
            parts[2].extend([clarabel.SecondOrderConeT(2 + wide)] * p.n)
            parts[3].append(("block", i))
        return parts

    def _still(self) -> tuple[list[Any], list[Array], list[Any], list[tuple[str, int]]]:
        """W is real where every spectrum is."""
        from scipy import sparse

        clarabel: Any = import_module("clarabel")
        lines = np.flatnonzero(self.problem.real)
        cols = (2 * self.q * lines[:, None] + self.q + np.arange(self.q)).ravel()
        if not len(cols):
            return [], [], [], []
        rows = sparse.csr_matrix((np.ones(len(cols)), (np.arange(len(cols)), cols)), (len(cols), self.size))
        return [rows], [np.zeros(len(cols))], [clarabel.ZeroConeT(len(cols))], [("real", 0)]

    def smallest(self, z: ComplexArray) -> _Solved | None:
        """Smallest g with the tangents at z; None where there is none."""
        return self._solve([self._still(), self._noise(False), self._blocks(z)])

    def least_noise(self) -> _Solved:
        """Smallest factor on the noise bound with any w."""
        found = self._solve([self._still(), self._noise(True)])
        if found is None:
            raise NoTrustworthyNumber("validate", "the solver gave no answer for the least noise")
        return found

    def _solve(self, parts: list[tuple[list[Any], list[Array], list[Any], list[tuple[str, int]]]]) -> _Solved | None:
        from scipy import sparse

        matrices = [m for part in parts for m in part[0]]
        A = sparse.vstack(matrices).tocsc()
        b = np.concatenate([offset for part in parts for offset in part[1]])
        cost = np.zeros(self.size)
        cost[self.at_g :] = 1.0
        square = sparse.csc_matrix((self.size, self.size))
        found = solved_cones(square, cost, A, b, [c for part in parts for c in part[2]], self.budget)
        status = str(found.status)
        if status in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
            return None
        x, dual = np.array(found.x), np.array(found.z)
        if not (np.isfinite(x).all() and np.isfinite(dual).all()):
            raise NoTrustworthyNumber("validate", f"the solver gave no answer ({status})")
        # Whatever the status says, the answer counts only as far as its replay and its multipliers go.
        p = self.problem
        w = x[: self.at_g].reshape(p.n, 2, self.q)
        starts = np.cumsum([0, *(m.shape[0] for m in matrices)])
        order = tuple(label for part in parts for label in part[3])
        g = np.broadcast_to(x[self.at_g :], (p.n,)).copy()
        return _Solved(w[:, 0] + 1j * w[:, 1], np.maximum(g, 0.0), dual, starts, order)

    def multipliers(self, solved: _Solved) -> LineMultipliers:
        """Multipliers of the quadratic certificate from those of the cone programme."""
        p = self.problem
        noise, D = np.zeros(p.e.shape), np.zeros((p.n, len(p.blocks)))
        g = np.maximum(solved.g, 1e-6 * float(solved.g.max(initial=0.0)) + 1e-12)
        for (kind, k), first, last in zip(solved.order, solved.starts[:-1], solved.starts[1:], strict=True):
            part = solved.dual[first:last]
            if kind == "noise":  # at |n| = r the slope of r^2 - |n|^2 is 2 r times that of r - |n|
                noise[:, k] = p.weight * part[0] / (2 * p.radius[k]) if p.total else 0.5 * part.reshape(p.n, 3)[:, 0]
            elif kind == "block":
                cone = part.reshape(p.n, -1)
                D[:, k] = (cone[:, 0] - cone[:, 1]) / (g if self.scaled[k] else 1.0)
        noise, D = np.maximum(noise, 0.0), np.maximum(D, 0.0)
        if p.total:
            D += FLOOR * max(float(D.max(initial=0.0)), float(noise.max(initial=0.0)))
        else:
            D += FLOOR * np.maximum(D.max(axis=1, initial=0.0), noise.max(axis=1, initial=0.0))[:, None]
        return LineMultipliers(D, noise)
