"""A start for controllers of a given order: the full-order design reduced to that order.

At B_K = C_K = 0 the gradient vanishes: further states get a nonzero B_K, so that the gradient by C_K does not.
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import MILLION, Budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.h2 import synthesize_h2
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.laws.controller_laws import Law
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.parameter_search import law_around
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.reduction.model_reduction import reduce_model

FULL_SHARE, FULL_WORK = 0.2, 10 * MILLION  # share of the remaining work for the full-order design, and most for it
FULL_HINF_REL, FULL_H2_REL = 1.05, 1.0005  # its norm over the optimum: a lower bandwidth is easier to reduce
POLES, DISCRETE_POLES = (0.3, 3.0), (0.2, 0.8)  # first and last pole of further states, in plant rates; z-plane


def informed_starts(problem: DesignProblem, seed: int) -> list[tuple[str, AnyArray]]:
    """Return ``("reduced", p)`` for a law with free B_K and C_K, from the first plant; nothing for other laws."""
    law, budget = problem.law, problem.budget
    if not law.sizes[0] or len(law.entries) != len(law.parameters):
        return []
    k = law.sizes[0]
    free = np.zeros(law.base.shape, dtype=bool)
    free[law.row, law.column] = True
    near = np.abs(np.subtract.outer(np.arange(k), np.arange(k))) <= 1
    if not (free[:k, k:].all() and free[k:, :k].all() and free[:k, :k][near].all()):
        return []
    part = budget.share(min(FULL_SHARE, FULL_WORK / max(budget.left, 1.0)))
    K = _reduced(problem.plants[0], k, problem.objective, part)
    if K is None:
        return []
    around, q = law_around(K)
    return [("reduced", _extended(problem, law, around.packed(q), K.n_states, seed))]


def _extended(problem: DesignProblem, law: Law, theta: AnyArray, order: int, seed: int) -> AnyArray:
    """Return parameters, within bounds, of a lower-order controller with further stable unobservable states."""
    k, n_u, n_y = law.sizes
    more, rng = k - order, np.random.default_rng(seed)
    poles = np.linspace(*DISCRETE_POLES, more) if problem.dt else -problem.scaling.rate * np.geomspace(*POLES, more)
    full = np.zeros((k + n_u, k + n_y))
    full[:order, :order], full[:order, k:] = theta[:order, :order], theta[:order, order:]
    full[k:, :order], full[k:, k:] = theta[order:, :order], theta[order:, order:]
    full[range(order, k), range(order, k)] = poles
    full[order:k, k:] = problem.scaling.rate * rng.standard_normal((more, n_y)) * problem.scaling.y
    p = np.zeros(len(law.parameters))
    p[law.top] = full[law.row, law.column] / law.weight
    return np.clip(p, [q.low for q in law.parameters], [q.high for q in law.parameters])


def _reduced(plant: GeneralizedPlant, order: int, objective: str, budget: Budget) -> StateSpaceModel | None:
    """Return the full-order controller for the objective reduced to this order; None where either fails."""
    if budget.over:
        return None
    try:
        hinf = objective == "hinf"
        K = (synthesize(plant, "hinf", FULL_HINF_REL, budget) if hinf else synthesize_h2(plant, FULL_H2_REL, budget)).K
    except (InputError, NoTrustworthyNumber):
        return None
    if K.n_states <= order:
        return K
    for method in ("coprime", "truncation"):
        try:
            return reduce_model(K, order, method=method).model
        except (InputError, NoTrustworthyNumber):  # too fast a controller, or too many unstable modes for truncation
            continue
    return None
