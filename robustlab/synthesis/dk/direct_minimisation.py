"""Direct minimisation of the smallest level over the parameters of scalings of growing order.

K is eliminated by the two Riccati equations (`riccati_level`). Minimax by sequential quadratic programming: Fletcher,
*Practical Methods of Optimization* (1987), section 14.4.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings
from robustlab.synthesis.dk.riccati_level import Branches
from robustlab.synthesis.dk.robust_problem import RobustProblem

DECREASE = 1e-3  # share of the predicted decrease that a step must reach (Armijo)
LINE_STEPS = 10  # trials of one line search
FIRST_SCALE = 1.0  # inverse Hessian before the first update
STEPS = 60  # of one minimisation
STEP_PROGRESS = 2e-5  # relative progress in ...
PATIENCE = 5  # ... this number of steps below which a minimisation ends
LARGEST_MOVE = 1.0  # largest change of a logarithmic parameter in one step
LARGEST_RANGE = 16.0  # largest distance of a logarithmic parameter from the start: they may diverge
PLACES = 9  # frequencies tried for a new section
SHORT = 10  # minimisation steps for a candidate for a new section ...
PURSUED = 4  # ... and number of steepest candidates that are minimised


def minimised(
    problem: RobustProblem, scalings: DynamicScalings, guess: float, steps: int = STEPS
) -> tuple[DynamicScalings, float] | None:
    """Return scalings of the same form with a smaller level, and that level; None where the start has none."""
    # min_d max_i (values_i + slopes_i^T d) + d^T H^-1 d / 2, with H by BFGS updates of the Lagrangian: where two
    # eigenvalues of X Y meet the level has a kink, at which a descent on one of them stops early.
    search, centre = problem.search(scalings), scalings.parameters()
    x, level = centre, search.smallest(centre, guess)
    if level is None:
        return None
    local = search.branches(x, level)
    start = H = np.eye(len(x)) * FIRST_SCALE
    levels = [float(np.log(level.beta))]
    for _ in range(steps):
        if local is None or not len(x) or problem.budget.over:
            break
        multipliers, predicted = _multipliers(local, H)
        direction = -H @ (multipliers @ local.slopes)
        shrink = min(1.0, LARGEST_MOVE / max(float(np.abs(direction).max()), 1e-300))
        step, found = shrink, None
        for _ in range(LINE_STEPS):  # backtracking to a share of the predicted decrease
            if problem.budget.over:
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
            if value > best_value or size == 1 == m:
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
    if s @ y < 0.1 * curvature:
        share = 0.9 * curvature / (curvature - float(s @ y))
        y = share * y + (1 - share) * B_s
    rho = 1 / float(s @ y)
    V = np.eye(len(s)) - rho * np.outer(s, y)
    return V @ H @ V.T + rho * np.outer(s, s)


def grown(
    problem: RobustProblem, scalings: DynamicScalings, level: float, omega: tuple[float, float], max_states: int
) -> tuple[DynamicScalings, float] | None:
    """Return scalings with one section of D or G more; None where no place for it lowers the level."""
    # Sections start with zero = pole (of G: p = q), which does not change the level.
    candidates: list[tuple[float, DynamicScalings]] = []
    places = np.linspace(np.log(omega[0]), np.log(omega[1]), PLACES).tolist()
    for trial in scalings.enlarged(places):
        if problem.budget.over:
            return None
        if trial.n_states > max_states:
            continue
        search, x = problem.search(trial), trial.parameters()
        reached = search.smallest(x, level)
        local = None if reached is None else search.branches(x, reached)
        if local is not None:
            _, predicted = _multipliers(local, np.eye(len(x)) * FIRST_SCALE)
            candidates.append((predicted / (trial.n_states - scalings.n_states), trial))
    candidates.sort(key=lambda pair: pair[0])
    best: tuple[DynamicScalings, float] | None = None
    for _, trial in candidates[:PURSUED]:
        found = minimised(problem, trial, level, SHORT)
        if found is not None and (best is None or found[1] < best[1]):
            best = found
    return best
