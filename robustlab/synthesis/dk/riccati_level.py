r"""Smallest level beta of a scaled H-infinity problem, and its minimisation over the parameters of the scalings.

The level is where :math:`\rho(X Y) = 1`, which eliminates K. One Lyapunov equation for each of X and Y gives the
derivative by all parameters. Doyle, Glover, Khargonekar, Francis (1989), theorem 3; Glover, Doyle (1988) for D11;
minimax by sequential quadratic programming: Fletcher, *Practical Methods of Optimization* (1987), section 14.4.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balanced_eigenvalues, care, judged_afterwards
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.scalings import FIRST_STEP, DynamicScalings
from robustlab.synthesis.hinf.two_riccati import RiccatiPair, TwoRiccatiProblem, quadratic, smallest_level
from robustlab.synthesis.problem.generalized_plant import PlantMatrices, Scaling, dual

RESIDUAL = 1e-7  # of a solution after Newton's steps; 1e-3 accepts levels without a proof
STEP = 1e-5  # of logarithmic parameters in derivatives of the frozen forms, which are smooth
NEGLIGIBLE = 1e-3  # eigenvalues of X Y below this share of the largest are far from the level, or noise
STEEPEST = 1e6  # logarithmic derivatives beyond this are rounding
LEVEL_RTOL = 1e-6  # of the smallest level
WITHIN = 0.5  # distance (log beta) below the level of the branches in the model of a step ...
MOST = 5  # ... and their largest number; more: kinks are detected earlier, each step costs more

DECREASE = 1e-3  # share of the predicted decrease that a step must reach (Armijo)
LINE_STEPS = 10  # trials of one line search
STEPS = 60  # of one minimisation
STEP_PROGRESS = 2e-5  # relative progress in ...
PATIENCE = 5  # ... this number of steps below which a minimisation ends
LARGEST_MOVE = 1.0  # largest change of a logarithmic parameter in one step
LARGEST_RANGE = 16.0  # largest distance of a logarithmic parameter from the start: they may diverge
PLACES = 9  # frequencies tried for a new section

TEST_WORK, FORM_WORK = 300, 250  # measured work of a test and of a frozen form, without that of their factorisations


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
        pairs = dict[float, Pair]()

        def coupling(beta: float) -> float | None:
            floor, pair = self.test(theta, beta)
            if pair is None:
                return floor
            pairs[beta] = pair
            return max(pair.coupling, floor or 0.0)

        found = smallest_level(coupling, start, rtol, self.budget, FIRST_STEP)
        return None if found is None or not found[2] else Level(found[0], found[1], pairs[found[0]])

    def branches(self, theta: AnyArray, level: Level, moves: AnyArray | None = None) -> Branches | None:
        """Return the largest eigenvalues of X Y at and slightly below the level, with slopes; None: not smooth."""
        if not level.smooth:
            return None
        n, moves = len(self.scaling.states), STEP * np.eye(len(theta)) if moves is None else moves
        self.budget.spend(dense(n, 2 * MOST) + (len(moves) + 2) * (FORM_WORK + n**3 // 100))
        forms, log_beta = self._frozen(theta, level), float(np.log(level.beta))
        here = forms(theta, log_beta)
        slope = (forms(theta, log_beta + STEP) - here) / STEP
        size = np.append(level.pair.eigenvalues[: len(slope) - 2], here[-2:])
        with np.errstate(divide="ignore", invalid="ignore"):
            below = np.log(size) * size / np.where(slope < 0, -slope, np.nan)
        if not below[0] < below[-2:].max():  # the floors are not the limit
            below[-2:] = np.nan
        # Of an eigenvalue at the level of rounding both the logarithm and the slope are noise.
        kept = np.argsort(-np.where(np.isfinite(below), below, -np.inf))
        kept = kept[below[kept] > below[kept[0]] - WITHIN]
        moved = [(forms(theta + move, log_beta) - here) / STEP for move in moves]
        slopes = np.array(moved).reshape(len(moves), len(slope)).T
        relative = slopes[kept] / -slope[kept, None]
        sound = np.abs(relative).max(axis=1, initial=0.0) < STEEPEST
        found = Branches(log_beta + below[kept][sound] - below[kept[:1]], relative[sound])
        return found if len(sound) and sound[0] else None

    def controller(self, theta: AnyArray, beta: float) -> StateSpaceModel | None:
        """Return the central controller at this level for the plant without D22; None where there is none."""
        try:
            _, pair = self.test(theta, beta)
            if pair is None or pair.coupling >= 1:
                return None
            # X and Y do not depend on the coordinates of w, z, u, y.
            solved = RiccatiPair(self.scaling.gain, pair.X, pair.Y, pair.coupling)
            K = TwoRiccatiProblem(self._scaled(theta, beta), self.budget).central_controller(solved)
            return StateSpaceModel(*self.scaling.controller_to_plant(K))
        except (NoTrustworthyNumber, InputError, np.linalg.LinAlgError):
            return None

    def _scaled(self, theta: AnyArray, beta: float) -> PlantMatrices:
        return self.scaling.apply(self._plant(theta, beta))

    def test(self, theta: AnyArray, beta: float) -> tuple[float | None, Pair | None]:
        """Return the larger of `_floors` and the solutions of both equations; None where one has none."""
        self.budget.spend(TEST_WORK + dense(len(self.scaling.states), 4))
        try:
            p = self._scaled(theta, beta)
            floor = float(self._floors(p).max())
            first = None if floor >= 1 else self._solution(p)
            second = None if first is None else self._solution(dual(p))
        except (InputError, np.linalg.LinAlgError):  # entries overflow
            return None, None
        if first is None or second is None:
            return floor if floor >= 1 else None, None
        (X, F), (Y, L) = first, second
        root = _root(Y)
        values, vectors = np.linalg.eigh(root.T @ X @ root)
        values, vectors = values[::-1] / self.scaling.gain**2, vectors[:, ::-1]
        return floor, Pair(X, F, Y, L, np.maximum(values, 1e-300), root @ vectors)

    def _floors(self, p: PlantMatrices) -> AnyArray:
        """Return squares over gamma^2 of the parts of D11 out of reach of D12 and of D21: 1 where no level is below."""
        free = [np.linalg.svd(side.D12)[0][:, side.D12.shape[1] :].T @ side.D11 for side in (p, dual(p))]
        sizes = [np.linalg.norm(part, 2) if part.size else 0.0 for part in free]
        return (np.array(sizes) / self.scaling.gain) ** 2

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
        """Return a function of theta and log beta with the slopes of each eigenvalue, for fixed X, Y and weights.

        ``tr(Lambda (2 X (A + B F) + C_F^T C_F))``, C_F = C + D F, and the same of the dual plant; A + B F of X has the
        Lyapunov solution Lambda for the eigenvalue's direction.
        """
        pair, gain = level.pair, self.scaling.gain
        p = self._scaled(theta, level.beta)
        # With Y = S S^T and q an eigenvector of S^T X S: u = X S q, Y u = rho S q, u^T Y u = rho^2.
        size = pair.eigenvalues[:MOST]
        size = size[size > NEGLIGIBLE * size[0]]
        directions = pair.directions[:, : len(size)]
        duals = pair.X @ directions / (np.sqrt(size) * gain)
        sides = [
            (X, F, np.array([_weight(side.A + np.hstack([side.B1, side.B2]) @ F, d) for d in some.T]))
            for side, X, F, some in ((p, pair.X, pair.F, directions), (dual(p), pair.Y, pair.L, duals))
        ]

        def value(at: AnyArray, log_beta: float) -> AnyArray:
            q, total = self._scaled(at, float(np.exp(log_beta))), 0.0
            for side, (X, F, weights) in zip((q, dual(q)), sides, strict=True):
                n_w = side.B1.shape[1]
                A = side.A + side.B1 @ F[:n_w] + side.B2 @ F[n_w:]
                C = side.C1 + side.D11 @ F[:n_w] + side.D12 @ F[n_w:]
                total = total + np.tensordot(weights, 2 * X @ A + C.T @ C, 2)
            return np.append(np.asarray(total) / gain**2, self._floors(q))

        return value


def _root(Y: AnyArray) -> AnyArray:
    """Return S with ``Y = S S^T``, through a unit diagonal so that entries of any size keep their digits."""
    size = np.sqrt(np.maximum(np.diag(Y), 0.0))
    back = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    values, vectors = np.linalg.eigh(back[:, None] * Y * back)
    return size[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0)))


def _weight(closed: AnyArray, direction: AnyArray) -> AnyArray:
    """Return Lambda of ``closed Lambda + Lambda closed^T + d d^T = 0``."""
    from scipy.linalg import solve_continuous_lyapunov

    with judged_afterwards():  # eigenvalues may nearly mirror each other; slopes of rounding are removed by their size
        return solve_continuous_lyapunov(closed, -np.outer(direction, direction))


# --- minimisation over the scalings -----------------------------------------------------------------------------------


Searches = Callable[[DynamicScalings], LevelSearch]  # the level search of scalings of one form
Found = tuple[DynamicScalings, float]


def minimised(searches: Searches, scalings: DynamicScalings, guess: float) -> Found | None:
    """Return scalings of the same form with a smaller level, and that level; None where the start has none."""
    # min_d max_i (values_i + slopes_i^T d) + d^T H^-1 d / 2, with H by BFGS updates of the Lagrangian: where two
    # eigenvalues of X Y meet the level has a kink, at which a descent on one of them stops early.
    search, centre = searches(scalings), scalings.parameters()
    x, level = centre, search.smallest(centre, guess)
    if level is None:
        return None
    local = search.branches(x, level)
    start = H = np.eye(len(x))
    levels = [float(np.log(level.beta))]
    for _ in range(STEPS):
        if local is None or not len(x) or search.budget.over:
            break
        multipliers, predicted = _multipliers(local, H)
        direction = -H @ (multipliers @ local.slopes)
        shrink = min(1.0, LARGEST_MOVE / max(float(np.abs(direction).max()), 1e-300))
        step, found = shrink, None
        for _ in range(LINE_STEPS):  # backtracking to a share of the predicted decrease
            if search.budget.over:
                break
            s = step * direction
            inside = np.abs(x + s - centre).max(initial=0.0) <= LARGEST_RANGE
            expected = level.beta * np.exp(step * predicted)
            trial = search.smallest(x + s, expected) if inside else None
            if trial is not None and np.log(trial.beta) <= levels[-1] + DECREASE * step * predicted - 1e-9:
                found = s, trial
                break
            step *= 0.35
        if found is None:
            if H is start:
                break
            H = start
            continue
        s, level = found
        after, first = search.branches(x + s, level), len(levels) == 1
        if after is not None:
            H = _updated(start if first else H, s, _change(local, after, multipliers), first)
        x, local = x + s, after
        levels.append(float(np.log(level.beta)))
        if len(levels) > PATIENCE and levels[-1 - PATIENCE] - levels[-1] < STEP_PROGRESS:
            break
    return scalings.with_parameters(x), level.beta


def _multipliers(branches: Branches, H: AnyArray) -> tuple[AnyArray, float]:
    """Return the weights of the branches in the best step, shape (m,), and the predicted change of log beta (<= 0)."""
    values, Q = branches.values - branches.values[0], branches.slopes @ H @ branches.slopes.T
    m = len(values)
    best, best_value = np.eye(m)[0], values[0] - 0.5 * Q[0, 0]
    for size in range(1, m + 1):
        for active in combinations(range(m), size):
            a = list(active)
            kkt = np.block([[Q[np.ix_(a, a)], np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            try:
                weights = np.linalg.solve(kkt, np.append(values[a], 1.0))[:-1]
            except np.linalg.LinAlgError:
                continue
            if not np.isfinite(weights).all() or (weights < 0).any():
                continue
            value = values[a] @ weights - 0.5 * weights @ Q[np.ix_(a, a)] @ weights
            if value > best_value:
                best, best_value = np.zeros(m), value
                best[a] = weights
    # The dual value is the minimum of the model, of which -lambda^T Q lambda / 2 is the quadratic term.
    return best, float(best_value)


def _change(before: Branches, after: Branches, multipliers: AnyArray) -> AnyArray:
    """Return the change of the slope of the Lagrangian; branches are matched by their slopes."""
    result = np.zeros(before.slopes.shape[1])
    for weight, slope in zip(multipliers, before.slopes, strict=True):
        if weight > 0:
            near = int(np.argmin(np.linalg.norm(after.slopes - slope, axis=1)))
            result += weight * (after.slopes[near] - slope)
    return result


def _updated(H: AnyArray, s: AnyArray, y: AnyArray, first: bool) -> AnyArray:
    """Return the BFGS update of the inverse Hessian, damped (Powell) so that it stays positive definite."""
    if first and s @ y > 0:
        H = np.eye(len(s)) * float(s @ y) / float(y @ y)
    B_s = np.linalg.solve(H, s)
    curvature = float(s @ B_s)
    if not curvature > 0:  # no step
        return H
    if s @ y < 0.1 * curvature:
        share = 0.9 * curvature / (curvature - float(s @ y))
        y = share * y + (1 - share) * B_s
    rho = 1 / float(s @ y)
    V = np.eye(len(s)) - rho * np.outer(s, y)
    return V @ H @ V.T + rho * np.outer(s, s)


def grown(
    searches: Searches, scalings: DynamicScalings, level: float, omega: tuple[float, float], max_states: int
) -> DynamicScalings | None:
    """Return scalings of the same level with one section of D or G more where the level falls most steeply."""

    def local(trial: DynamicScalings, moves: AnyArray | None = None) -> Branches | None:
        search, x = searches(trial), trial.parameters()
        pair = None if search.budget.over else search.test(x, level)[1]
        return None if pair is None else search.branches(x, Level(level, True, pair), moves)

    base = local(scalings)
    weights = np.ones(1) if base is None else _multipliers(base, np.eye(base.slopes.shape[1]))[0]
    # Sections start with zero = pole (of G: p = q), which changes neither the level nor its other slopes; that by the
    # pole is the one by the zero with the other sign.
    candidates: list[tuple[float, DynamicScalings]] = []
    places = np.linspace(np.log(omega[0]), np.log(omega[1]), PLACES).tolist()
    for flat, tilted in scalings.enlarged(places, STEP):
        if flat.n_states > max_states:
            continue
        found = local(flat, (tilted.parameters() - flat.parameters())[None])
        if found is not None:
            slope = float(weights[: len(found.slopes)] @ found.slopes[: len(weights), 0])
            candidates.append((-(slope**2) / (flat.n_states - scalings.n_states), flat))
    return min(candidates, key=lambda pair: pair[0])[1] if candidates else None
