r"""Smallest level beta of a scaled H-infinity problem, and its derivative by the parameters of the scalings.

The level is where :math:`\rho(X Y) = 1`. One Lyapunov equation for each of X and Y gives the derivative by all
parameters. Doyle, Glover, Khargonekar, Francis (1989), theorem 3; Glover, Doyle (1988) for D11.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balanced_eigenvalues, care, judged_afterwards
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.two_riccati import RiccatiPair, TwoRiccatiProblem, quadratic
from robustlab.synthesis.problem.partition import PlantMatrices, dual
from robustlab.synthesis.problem.scaling import Scaling

RESIDUAL = 1e-7  # of a solution after Newton's steps; 1e-3 accepts levels without a proof
STEP = 1e-5  # of logarithmic parameters in derivatives of the frozen forms, which are smooth
NEGLIGIBLE = 1e-6  # eigenvalues of X Y below this share of the largest are noise
STEEPEST = 1e6  # logarithmic derivatives beyond this are rounding
LEVEL_RTOL = 1e-6  # of the smallest level
MAX_TESTS = 40  # pairs of Riccati equations to find a level ...
SECANTS = 15  # ... of which the later ones only bisect
SLOPE = -4.0  # first guess of the derivative of log rho(X Y) by log beta
WITHIN = 0.5  # distance (log beta) below the level of the branches in the model of a step ...
MOST = 5  # ... and their largest number; more: kinks are detected earlier, each step costs more

# Measured work of a test and of a frozen form, without that of their factorisations.
TEST_WORK, FORM_WORK = 300, 250


class Pair(NamedTuple):
    """Solutions of both equations at one beta, in scaled units, with the eigenvalues of X Y over gamma^2, descending,
    and their directions ``S q`` where ``Y = S S^T`` and q is a unit eigenvector of ``S^T X S``.
    """

    X: AnyArray
    F: AnyArray
    Y: AnyArray
    L: AnyArray
    eigenvalues: AnyArray
    directions: AnyArray

    @property
    def coupling(self) -> float:
        """``rho(X Y) / gamma^2``."""
        return float(self.eigenvalues.max(initial=1e-300))


class Branches(NamedTuple):
    """Several eigenvalues of X Y to first order: ``log beta(theta + d) = max_i (values_i + slopes_i^T d)``."""

    values: AnyArray
    slopes: AnyArray


class Level(NamedTuple):
    """Smallest level of given scalings."""

    beta: float
    smooth: bool  # True where `rho(X Y) = 1` there; else a Riccati equation loses its solution
    pair: Pair  # the solutions slightly above the level


class LevelSearch:
    """Smallest levels of ``plant(theta, beta)`` in the units of one numerical scaling."""

    def __init__(self, plant: Callable[[AnyArray, float], PlantMatrices], scaling: Scaling, budget: Budget) -> None:
        self._plant, self.scaling, self.budget = plant, scaling, budget

    def smallest(self, theta: AnyArray, start: float, rtol: float = LEVEL_RTOL) -> Level | None:
        """Return the smallest level near ``start``; None where none is found."""
        # Secants of f = log rho(X Y) over t = log beta in a bracket: above the level f < 0, below it f >= 0, or an
        # equation has no solution.
        t = float(np.log(max(start, 1e-300)))
        low, high, smooth, step, slope = -np.inf, np.inf, False, 1e-4, SLOPE
        best: Pair | None = None
        last: tuple[float, float] | None = None
        for k in range(MAX_TESTS):
            pair = self._test(theta, float(np.exp(t)))
            f = np.nan if pair is None else float(np.log(pair.coupling))
            if last is not None and abs(t - last[0]) > 3 * rtol and (f - last[1]) * (t - last[0]) < 0:
                slope = (f - last[1]) / (t - last[0])
            last = (t, f) if pair is not None else last
            if f < 0:
                high, best = t, pair
                if slope != SLOPE and f / slope <= rtol:
                    low, smooth = t, True
            else:
                low, smooth = t, pair is not None
            if high - low <= rtol or step > 60 or self.budget.over:
                break
            bracketed, aim = high - low < np.inf, t - f / slope + 0.3 * rtol if k < SECANTS else np.nan
            if low < aim < high and (bracketed or abs(aim - t) < 1):
                t = aim
            elif bracketed:
                t = 0.5 * (low + high)
            else:
                t, step = t + (step if high == np.inf else -step), 4 * step
        return None if best is None or low == -np.inf else Level(float(np.exp(high)), smooth, best)

    def branches(self, theta: AnyArray, level: Level) -> Branches | None:
        """Return the largest eigenvalues of X Y at and slightly below the level by theta; None: no smooth level."""
        if not level.smooth:
            return None
        n = len(self.scaling.states)
        self.budget.spend(dense(n, 2 * MOST) + (len(theta) + 2) * (FORM_WORK + n**3 // 100))
        forms, log_beta = self._frozen(theta, level), float(np.log(level.beta))
        here = forms(theta, log_beta)
        slope = (forms(theta, log_beta + STEP) - here) / STEP
        size = level.pair.eigenvalues[:MOST]
        below = np.log(size) * size / np.where(slope < 0, -slope, np.nan)
        if not below[0] > -np.inf:
            return None
        # Of an eigenvalue at the level of rounding both the logarithm and the slope are noise.
        near = (below - below[0] > -WITHIN) & np.isfinite(below)
        kept = np.flatnonzero(near & (size > NEGLIGIBLE * size[0]))
        moved = [(forms(theta + e, log_beta) - here) / STEP for e in STEP * np.eye(len(theta))]
        slopes = np.array(moved).reshape(len(theta), len(slope)).T
        relative = slopes[kept] / -slope[kept, None]
        sound = np.abs(relative).max(axis=1, initial=0.0) < STEEPEST
        found = Branches(log_beta + below[kept][sound] - below[0], relative[sound])
        return found if len(sound) and sound[0] else None

    def controller(self, theta: AnyArray, beta: float) -> StateSpaceModel | None:
        """Return the central controller at this level for the plant without D22; None where there is none."""
        try:
            pair = self._test(theta, beta)
            if pair is None or pair.coupling >= 1:
                return None
            # X and Y do not depend on the coordinates of w, z, u, y.
            solved = RiccatiPair(self.scaling.gain, pair.X, pair.Y, pair.coupling)
            K = TwoRiccatiProblem(self._scaled(theta, beta), False, self.budget).central_controller(solved)
            return StateSpaceModel(*self.scaling.controller_to_plant(K))
        except (NoTrustworthyNumber, InputError, np.linalg.LinAlgError):
            return None

    def _scaled(self, theta: AnyArray, beta: float) -> PlantMatrices:
        return self.scaling.apply(self._plant(theta, beta))

    def _test(self, theta: AnyArray, beta: float) -> Pair | None:
        self.budget.spend(TEST_WORK + dense(len(self.scaling.states), 4))
        try:
            p = self._scaled(theta, beta)
            first = self._solution(p)
            second = None if first is None else self._solution(dual(p))
        except (InputError, np.linalg.LinAlgError):  # entries overflow
            return None
        if first is None or second is None:
            return None
        (X, F), (Y, L) = first, second
        root = _root(Y)
        values, vectors = np.linalg.eigh(root.T @ X @ root)
        values, vectors = values[::-1] / self.scaling.gain**2, vectors[:, ::-1]
        return Pair(X, F, Y, L, np.maximum(values, 1e-300), root @ vectors)

    def _solution(self, p: PlantMatrices) -> tuple[AnyArray, AnyArray] | None:
        """Return the stabilising positive semidefinite solution and its gain; None where R or X has wrong signs."""
        A, B, Q, S, _, n_w = equation = quadratic(p)
        R = equation.R(self.scaling.gain)
        if int((np.linalg.eigvalsh(R) < 0).sum()) != n_w:
            return None
        try:
            found = care(A, B, Q, R, S, tolerance=RESIDUAL)
        except NoTrustworthyNumber:
            return None
        B_2, S_2 = B[:, n_w:], S[:, n_w:]
        poles = balanced_eigenvalues(A - B_2 @ np.linalg.solve(R[n_w:, n_w:], B_2.T @ found.X + S_2.T))
        if poles is None or np.real(poles).max(initial=-1.0) >= 0:
            return None
        return found.X, found.gain

    def _frozen(self, theta: AnyArray, level: Level) -> Callable[[AnyArray, float], AnyArray]:
        """Return ``tr(V_X M_X) + tr(V_Y M_Y)`` of each eigenvalue for fixed X, Y, V, which has the slopes of rho."""
        pair, gain = level.pair, self.scaling.gain
        p = self._scaled(theta, level.beta)
        A_X, A_Y = p.A + np.hstack([p.B1, p.B2]) @ pair.F, p.A.T + np.vstack([p.C1, p.C2]).T @ pair.L
        weights = []
        for rho, direction in zip(pair.eigenvalues[:MOST], pair.directions.T, strict=False):
            # With Y = S S^T and q an eigenvector of S^T X S: u = X S q, Y u = rho S q, u^T Y u = rho^2.
            dual_direction = pair.X @ direction / np.sqrt(rho * gain**2)
            weights.append((_adjoint(A_X, pair.F, direction), _adjoint(A_Y, pair.L, dual_direction)))

        def value(at: AnyArray, log_beta: float) -> AnyArray:
            q = self._scaled(at, float(np.exp(log_beta)))
            M_X, M_Y = _form(q, pair.X, gain), _form(dual(q), pair.Y, gain)
            return np.array([(V_X * M_X).sum() + (V_Y * M_Y).sum() for V_X, V_Y in weights]) / gain**2

        return value


def _root(Y: AnyArray) -> AnyArray:
    """Return S with ``Y = S S^T``, through a unit diagonal so that entries of any size keep their digits."""
    size = np.sqrt(np.maximum(np.diag(Y), 0.0))
    back = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    values, vectors = np.linalg.eigh(back[:, None] * Y * back)
    return size[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0)))


def _adjoint(closed: AnyArray, gain: AnyArray, direction: AnyArray) -> AnyArray:
    """Return ``[I; F] Lambda [I F^T]`` with ``A_X Lambda + Lambda A_X^T + d d^T = 0``."""
    from scipy.linalg import solve_continuous_lyapunov

    with judged_afterwards():  # eigenvalues may nearly mirror each other; slopes of rounding are removed by their size
        weight = solve_continuous_lyapunov(closed, -np.outer(direction, direction))
    tall = np.vstack([np.eye(len(closed)), gain])
    return tall @ weight @ tall.T


def _form(p: PlantMatrices, X: AnyArray, gamma: float) -> AnyArray:
    """Return the symmetric ``[A^T X + X A + Q, X B + S; ., R]``."""
    A, B, Q, S, _, _ = equation = quadratic(p)
    drift, cross = X @ A, X @ B + S
    return np.block([[drift + drift.T + Q, cross], [cross.T, equation.R(gamma)]])
