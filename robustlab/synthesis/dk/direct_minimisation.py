"""Direct minimisation of the smallest level over the parameters of the scalings, of growing order.

K is eliminated by the two Riccati equations (`riccati_level`). Minimax by sequential quadratic programming: Fletcher,
*Practical Methods of Optimization* (1987), section 14.4.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings
from robustlab.synthesis.dk.riccati_level import Branches, Level
from robustlab.synthesis.dk.robust_problem import RobustProblem

DECREASE = 1e-3  # share of the promised decrease that a step has to bring (Armijo)
LINE_STEPS = 10  # trials of one line search
FIRST_SCALE = 1.0  # of the inverse Hessian before the first update
STEPS = 60  # of one minimisation
STEP_PROGRESS = 2e-5  # relative progress in ...
PATIENCE = 5  # ... so many steps below which a minimisation ends
LARGEST_MOVE = 1.0  # of a logarithmic parameter in one step
LARGEST_RANGE = 16.0  # logarithmic parameters further from the start are refused: they would run away
PLACES = 9  # places of a new section over frequency
SHORT = 10  # steps by which a candidate for a new section is followed ...
PURSUED = 4  # ... and so many of the steepest candidates


class _Objective:
    """``log beta`` by theta, for scalings of one form, as the largest of several smooth branches."""

    def __init__(self, problem: RobustProblem, scalings: DynamicScalings) -> None:
        self.budget = problem.budget
        self.search, self.centre = problem.search(scalings), scalings.parameters()

    def level(self, theta: AnyArray, guess: float) -> Level | None:
        """The smallest level; None outside the range, or where there is none."""
        if np.abs(theta - self.centre).max(initial=0.0) > LARGEST_RANGE:
            return None
        return self.search.smallest(theta, guess)


def minimised(
    problem: RobustProblem, scalings: DynamicScalings, guess: float, steps: int | None = None
) -> tuple[DynamicScalings, float] | None:
    """Scalings of the same form with a smaller level, and that level; None where the start has none."""
    objective = _Objective(problem, scalings)
    x = scalings.parameters()
    level = objective.level(x, guess)
    if level is None:
        return None
    local = objective.search.branches(x, level)
    start = H = np.eye(len(x)) * FIRST_SCALE
    levels = [float(np.log(level.beta))]
    for _ in range(STEPS if steps is None else steps):
        if local is None or not len(x) or problem.budget.over:
            break
        multipliers, predicted = _multipliers(local, H)
        direction = -H @ (multipliers @ local.slopes)
        shrink = min(1.0, LARGEST_MOVE / max(float(np.abs(direction).max()), 1e-300))
        step = _line_search(objective, x, level, shrink * direction, shrink * predicted)
        if step is None:
            if H is start:
                break
            H = start
            continue
        s, level = step
        after = objective.search.branches(x + s, level)
        if after is not None:
            H = _updated(start if len(levels) == 1 else H, s, _change(local, after, multipliers), len(levels) == 1)
        x, local = x + s, after
        levels.append(float(np.log(level.beta)))
        if len(levels) > PATIENCE and levels[-1 - PATIENCE] - levels[-1] < STEP_PROGRESS:
            break
    return scalings.with_parameters(x), level.beta


def _multipliers(branches: Branches, H: AnyArray) -> tuple[AnyArray, float]:
    """Weights of the branches in the best step, shape (m,), and the change of log beta that it promises (<= 0)."""
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
            if value > best_value or size == 1 == m:
                best, best_value = np.zeros(m), value
                best[a] = weights
    # The dual is the smallest of the model; -lambda^T Q lambda / 2 of it is the quadratic term.
    return best, float(best_value)


def _line_search(
    objective: _Objective, x: AnyArray, level: Level, direction: AnyArray, predicted: float
) -> tuple[AnyArray, Level] | None:
    """The longest step of a falling sequence that reaches a share of the promised decrease; None where none does."""
    start, t = float(np.log(level.beta)), 1.0
    for _ in range(LINE_STEPS):
        if objective.budget.over:
            return None
        found = objective.level(x + t * direction, level.beta)
        if found is not None and np.log(found.beta) <= start + DECREASE * t * predicted - 1e-9:
            return t * direction, found
        t *= 0.35
    return None


def _change(before: Branches, after: Branches, multipliers: AnyArray) -> AnyArray:
    """Change of the slope of the Lagrangian; branches are recognised by their slopes."""
    result = np.zeros(before.slopes.shape[1])
    for weight, slope in zip(multipliers, before.slopes, strict=True):
        if weight > 0:
            near = int(np.argmin(np.linalg.norm(after.slopes - slope, axis=1)))
            result += weight * (after.slopes[near] - slope)
    return result


def _updated(H: AnyArray, s: AnyArray, y: AnyArray, first: bool) -> AnyArray:
    """BFGS update of the inverse Hessian, damped so that it stays positive definite."""
    if first and s @ y > 0:
        H = np.eye(len(s)) * float(s @ y) / float(y @ y)
    B_s = np.linalg.solve(H, s)
    curvature = float(s @ B_s)
    if s @ y < 0.1 * curvature:  # Powell
        share = 0.9 * curvature / (curvature - float(s @ y))
        y = share * y + (1 - share) * B_s
    rho = 1 / float(s @ y)
    V = np.eye(len(s)) - rho * np.outer(s, y)
    return V @ H @ V.T + rho * np.outer(s, s)


def grown(
    problem: RobustProblem, scalings: DynamicScalings, level: float, omega: tuple[float, float], max_states: int
) -> tuple[DynamicScalings, float] | None:
    """Scalings one section of D or G larger; None where no place for it lowers the level."""
    candidates: list[tuple[float, DynamicScalings]] = []
    for trial in _candidates(scalings, np.linspace(np.log(omega[0]), np.log(omega[1]), PLACES)):
        if problem.budget.over:
            return None
        if trial.n_states > max_states:
            continue
        objective = _Objective(problem, trial)
        reached = objective.level(trial.parameters(), level)
        local = None if reached is None else objective.search.branches(trial.parameters(), reached)
        if local is not None:
            _, promised = _multipliers(local, np.eye(local.slopes.shape[1]) * FIRST_SCALE)
            candidates.append((promised / (trial.n_states - scalings.n_states), trial))
    candidates.sort(key=lambda pair: pair[0])
    best: tuple[DynamicScalings, float] | None = None
    for _, trial in candidates[:PURSUED]:
        found = minimised(problem, trial, level, SHORT)
        if found is not None and (best is None or found[1] < best[1]):
            best = found
    return best


def _candidates(scalings: DynamicScalings, places: AnyArray) -> list[DynamicScalings]:
    """All enlargements by one section of a factor or of a G."""
    found: list[DynamicScalings] = []
    for i, part in enumerate(scalings.parts):
        for k, factor in enumerate(part.factors):
            for at in places:
                found.append(scalings.with_part(i, part.with_factor(k, factor.with_section(float(at), float(at)))))
        for k, pair in enumerate(part.g):
            for at in places:
                found.append(scalings.with_part(i, part.with_pair(k, pair.with_section(float(at), float(at)))))
    return found
