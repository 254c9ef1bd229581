"""Nonsmooth search behind Riccati equations and LMIs: it needs no equation to be solvable, only loops to be evaluated.

Where a controller is known it is improved by descent; where none is, controllers of low and then of full order are
sought whose loop is stable. What comes out are candidates like all others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robustlab.budget import MILLION, Budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.search import Candidate, Search
from robustlab.synthesis.laws.controller_laws import model_of
from robustlab.synthesis.laws.controller_structures import FixedOrder
from robustlab.synthesis.nonsmooth.descent import WEIGHTS, descend
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.structure_search import multi_start
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation

__all__ = ["descend_from", "is_poor", "stabilise"]

# A gamma this far above the estimated optimum, or above the proved lower bound where that is unknown and the two
# scalings do not agree, is worth a descent.
POOR = 1.02
# In a plant scaled to order one, a gain below this says that the infimum is zero: ratios mean nothing there.
NEAR_ZERO = 1e-4
# Descents get this share of the work left, and at most so much: beyond that they creep.
SHARE_OF_WORK, MOST_WORK = 0.25, 15 * MILLION
# Random starts for each order; larger weights of the barrier where the start may be far from an optimum.
STARTS, SEED, FAR = 3, 0, (3.0, 1.0, *WEIGHTS)


def is_poor(gamma: float, optimum: float, lower: float, disagree: float, scale: float = 1.0) -> bool:
    """Whether a verified gamma is so far above what is possible that a descent is worth its time.

    Parameters
    ----------
    gamma
        The smallest verified one.
    optimum
        Estimated optimum; NaN where unknown.
    lower
        Proved lower bound, often far below the optimum.
    disagree
        Relative difference of what two scalings reached; NaN where one of them gave none.
    scale
        Factor from gamma to the gain of the plant scaled to order one.
    """
    if gamma <= POOR * lower or gamma * scale <= NEAR_ZERO:
        return False
    return gamma > POOR * optimum if np.isfinite(optimum) else not disagree <= POOR - 1


def descend_from(p: PlantMatrices, search: Search, start: Candidate, budget: Budget) -> Candidate | None:
    """The candidate that nonsmooth descent reaches from one of the search; None where it reaches nothing better.

    The search adopts it, so that it is verified and softened like every other.
    """
    if budget.over:
        return None
    part = budget.share(min(SHARE_OF_WORK, MOST_WORK / budget.left))
    K0 = StateSpaceModel(*start.K)
    try:
        K = descend(p, K0, part, FAR)
    except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):  # entries overflow on the way
        return None
    if K is K0:
        return None
    found = search.adopt(Realisation(K.A, K.B, K.C, K.D))
    return found if found is not None and found.gamma < start.gamma else None


def stabilise(p: PlantMatrices, search: Search, budget: Budget, say: Callable[[str], None]) -> str:
    """Add controllers found by minimising the loop's spectral abscissa, then its norm; how it went in words.

    Static gains first, then 2 states, then as many as the plant has: low orders are quick, and often enough.
    """
    plant = GeneralizedPlant(p.model(), p.sizes[4], p.sizes[2])
    n = p.sizes[0]
    for order in sorted({0, min(2, n), n}):
        if budget.over:
            return "no work was left for a nonsmooth search"
        part = budget.share(0.5)
        try:
            law = FixedOrder(order).law(plant.measurements, plant.controls, 0.0)
            starts = multi_start(DesignProblem([plant], law, "hinf", (), part), [], STARTS, SEED, say)
        except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):
            continue
        for start in (s for s in starts if np.isfinite(s.gamma)):
            K = model_of(law, start.p, 0.0, plant.measurements, plant.controls)
            if search.adopt(Realisation(K.A, K.B, K.C, K.D)) is not None:
                return f"a nonsmooth search over controllers with {order} states"
    return "a nonsmooth search stabilised it with no order either"
