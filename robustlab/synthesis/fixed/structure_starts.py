"""Starts for controllers of a given order: the best static gain, and the full-order design brought to that order.

With B_K = C_K = 0 the norm of the loop does not change with either to first order: a search that begins there stands
still. Here the static gain is kept and B_K made nonzero, so that the norm is the static one and C_K has a slope.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import AnyArray
from robustlab.budget import MILLION, Budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.h2.h2_synthesis import synthesize_h2
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.laws.controller_laws import AffineLaw, Law
from robustlab.synthesis.laws.controller_structures import StaticGain
from robustlab.synthesis.nonsmooth.design_limits import Limit
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.parameter_search import law_around, multi_start
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.reduction.model_reduction import reduce_model

__all__ = ["informed_starts"]


# Random starts of the static search; shares of the work that is left for it and for the full order, and most for that.
STATIC_STARTS = 6
STATIC_SHARE, FULL_SHARE, FULL_MOST = 0.3, 0.2, 10 * MILLION
# The full-order design may be so much worse than the best one: it is calmer then, and easier to reduce.
GAMMA_REL = {"hinf": 1.05, "h2": 1.0005}
# Poles of the states beside a static gain, in units of the plant's rate (discrete: in the z-plane).
POLES, DISCRETE_POLES = (0.3, 3.0), (0.2, 0.8)


def informed_starts(
    plants: Sequence[GeneralizedPlant],
    law: Law,
    objective: str,
    limits: Sequence[Limit],
    seed: int,
    budget: Budget,
    progress: Callable[[str], None],
) -> list[tuple[str, AnyArray]]:
    """``("static", p)`` and ``("reduced", p)``: starts of a law whose B_K and C_K are free; none for other laws.

    Parameters
    ----------
    plants
        Plants without uncertainty; the full-order design is that of the first.
    law, objective, limits, seed
        Those of the search that follows.
    budget
        At most 45 % of what is left is used here.
    progress
        Called with a line after every start of the static search.
    """
    if not isinstance(law, AffineLaw) or not _is_given_order(law):
        return []
    problem = DesignProblem(plants, law, objective, limits)
    found: list[tuple[str, AnyArray]] = []
    if _free(law)[law.sizes[0] :, law.sizes[0] :].any():
        D = _static_gain(plants, law, objective, seed, budget.share(STATIC_SHARE), progress)
        if D is not None:
            found.append(("static", _held(law, _extended(problem, law, D, 0, seed))))
    K = _reduced(plants[0], law.sizes[0], objective, budget.share(min(FULL_SHARE, FULL_MOST / max(budget.left, 1.0))))
    if K is not None:
        around, q = law_around(K)
        found.append(("reduced", _held(law, _extended(problem, law, around.packed(q), K.n_states, seed))))
    return found


def _free(law: AffineLaw) -> NDArray[np.bool_]:
    """Which entries of the packed matrices are parameters."""
    free = np.zeros(law.base.shape, dtype=bool)
    free[law.row, law.column] = True
    return free


def _is_given_order(law: AffineLaw) -> bool:
    """All of B_K, C_K and at least the tridiagonal part of A_K are parameters, one for each entry."""
    k = law.sizes[0]
    if not k or len(law.index) != len(law.parameters):
        return False
    free = _free(law)
    near = np.abs(np.subtract.outer(np.arange(k), np.arange(k))) <= 1
    return bool(free[:k, k:].all() and free[k:, :k].all() and free[:k, :k][near].all())


def _held(law: AffineLaw, theta: AnyArray) -> AnyArray:
    """Parameters whose packed matrices are theta, as far as the law has its entries and bounds."""
    p = np.zeros(len(law.parameters))
    p[law.index] = theta[law.row, law.column] / law.weight
    return np.clip(p, [q.low for q in law.parameters], [q.high for q in law.parameters])


def _static_gain(
    plants: Sequence[GeneralizedPlant],
    law: AffineLaw,
    objective: str,
    seed: int,
    budget: Budget,
    progress: Callable[[str], None],
) -> AnyArray | None:
    """The best static gain with the law's free entries of D_K; None where none stabilises all plants."""
    k, first = law.sizes[0], plants[0]
    static = StaticGain(_free(law)[k:, k:]).law(first.measurements, first.controls, first.model.dt)
    problem = DesignProblem(plants, static, objective, (), budget)

    def say(line: str) -> None:
        progress(f"static gain: {line}")

    best = multi_start(problem, [], STATIC_STARTS, seed, say)[0]
    return static.packed(best.p) if np.isfinite(best.gamma) else None


def _extended(problem: DesignProblem, law: AffineLaw, theta: AnyArray, order: int, seed: int) -> AnyArray:
    """Packed matrices of a controller of a lower order with further stable states that act on nothing yet."""
    k, n_u, n_y = law.sizes
    more = k - order
    rng = np.random.default_rng(seed)
    poles = np.linspace(*DISCRETE_POLES, more) if problem.dt else -problem.scaling.rate * np.geomspace(*POLES, more)
    full = np.zeros((k + n_u, k + n_y))
    full[:order, :order], full[:order, k:] = theta[:order, :order], theta[:order, order:]
    full[k:, :order], full[k:, k:] = theta[order:, :order], theta[order:, order:]
    full[range(order, k), range(order, k)] = poles
    full[order:k, k:] = problem.scaling.rate * rng.standard_normal((more, n_y)) * problem.scaling.y
    return full


def _reduced(plant: GeneralizedPlant, order: int, objective: str, budget: Budget) -> StateSpaceModel | None:
    """The full-order controller for the objective reduced to this order; None where either fails."""
    if budget.over:
        return None
    try:
        K = (synthesize if objective == "hinf" else synthesize_h2)(plant, objective, GAMMA_REL[objective], budget).K
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
