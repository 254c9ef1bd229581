"""H-infinity synthesis: the controller of smallest verified closed-loop norm, or a sane one close to it.

Nonsmooth search behind Riccati equations and LMIs: it needs no equation to be solvable, only loops to be evaluated.

Where a controller is known it is improved by descent; where none is, controllers of low and then of full order are
sought whose loop is stable. What comes out are candidates like all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from robustlab.budget import MILLION, NOT_REPEATABLE, Budget, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.norms import bilinear_to_continuous
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.lmi_synthesis import lmi_controllers
from robustlab.synthesis.hinf.search import Candidate, Portfolio, Search, portfolio, soften
from robustlab.synthesis.hinf.verification import Verified, Verifier
from robustlab.synthesis.laws.controller_laws import model_of
from robustlab.synthesis.laws.controller_structures import FixedOrder
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.parameter_search import WEIGHTS, descend, multi_start
from robustlab.synthesis.problem.assumptions import broken_assumptions, require_stabilisable
from robustlab.synthesis.problem.design import HinfSynthesis, design_budget, limiting_channels, told
from robustlab.synthesis.problem.gamma_bounds import GammaBound, place_in_s, place_in_z, pointwise_bound
from robustlab.synthesis.problem.partition import (
    GeneralizedPlant,
    PlantMatrices,
    Realisation,
    as_generalized_plant,
    require_performance,
)
from robustlab.synthesis.problem.scaling import equilibrated, paths_first

__all__ = [
    "WORK",
    "hinf",
    "synthesize",
    "descend_from",
    "is_poor",
    "stabilise",
]


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


# Work of a design: few plants need a tenth of it.
WORK = 60 * MILLION
# What a certified norm may cost where the best loop is so stiff that its norm loses digits.
CALMER = 1.001


@told_as("synth hinf")
def hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.05,
    bandwidth: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    r"""H-infinity controller ``u = K y`` with positive feedback into the lower LFT of P.

    .. math:: \min_K \|F_l(P, K)\|_\infty, \qquad F_l(P, K) = P_{11} + P_{12} K (I - P_{22} K)^{-1} P_{21}

    Two Riccati equations (Glover, Doyle; general D11, D22) on a scaled and regularised plant; linear matrix
    inequalities where they give nothing; nonsmooth descent where what was found is poor. Nothing is assumed about the
    ranks of D12 and D21 or about zeros on the axis; every controller is verified on P as given, and gamma is the
    verified norm of the loop rebuilt from the returned K.
    A discrete P is mapped by the bilinear rule and verified in discrete time.

    Parameters
    ----------
    P
        Generalised plant: `GeneralizedPlant`, StateSpaceModel, UncertainModel (with its perturbation channels as w and
        z), or python-control object; inputs [w; u], outputs [z; y], the ``n_con`` controls and ``n_meas`` measurements
        last.
    n_meas, n_con
        Numbers of measurements and controls; left out for a `GeneralizedPlant`.
    gamma_rel
        How much larger than the smallest gamma found the returned controller's may be (>= 1); within it the one with
        the slowest poles is taken. 1 asks for the smallest gamma, whose controller is often absurdly fast.
    bandwidth
        Where given, all controller poles must lie below it (modulus, rad/s; of a discrete controller those of its
        bilinear map); of the controllers allowed by ``gamma_rel`` the one of smallest gamma that obeys is taken.
    time_limit
        Time in s, asked between trials; none where left out. A controller verified by then is returned, but another
        run may find another one: the status is TIMEOUT, and ``reason`` says so.
    effort
        Multiple of the usual work. The search counts what it does, so that it ends the same way everywhere.
    progress
        Called with one short line after every stage.

    Returns
    -------
    HinfSynthesis
        Always with a stabilising, verified K.

    Raises
    ------
    InputError
        Numbers of channels that P does not have, ``gamma_rel`` below 1.
    NoTrustworthyNumber
        An unstable or marginal mode that no controller can stabilise (named), no controller could be verified, or none
        has its poles below ``bandwidth``.

    References
    ----------
    Glover, Doyle 1988; Doyle, Glover, Khargonekar, Francis 1989; Zhou, Doyle, Glover 1996, chapters 16 and 17;
    Gahinet, Apkarian 1994.

    Examples
    --------
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> design = hinf(P, n_meas=1, n_con=1, gamma_rel=1.0)
    >>> design.status.value, round(design.gamma, 3)
    ('certified', 0.732)
    """
    plant = as_generalized_plant(P, n_meas, n_con, "synth hinf")
    require_performance(plant, "synth hinf")
    budget = design_budget("synth hinf", WORK, effort, time_limit)
    return synthesize(plant, "hinf", gamma_rel, budget, bandwidth=bandwidth, progress=progress)


def synthesize(
    plant: GeneralizedPlant,
    method: str,
    gamma_rel: float,
    budget: Budget,
    weights: Mapping[str, StateSpaceModel] | None = None,
    bandwidth: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    """The search behind `hinf` and `mixsyn`; see there."""
    where = f"synth {method}"
    if not np.isfinite(gamma_rel) or gamma_rel < 1:
        raise InputError(where, f"gamma_rel is {gamma_rel}", "a number >= 1")
    if bandwidth is not None and not bandwidth > 0:
        raise InputError(where, f"bandwidth is {bandwidth}", "a positive frequency in rad/s")
    with one_thread():
        say = progress or (lambda _: None)
        return _synthesize(plant, method, gamma_rel, budget, weights or {}, bandwidth, say)


def _synthesize(
    plant: GeneralizedPlant,
    method: str,
    gamma_rel: float,
    budget: Budget,
    weights: Mapping[str, StateSpaceModel],
    bandwidth: float | None,
    say: Callable[[str], None],
) -> HinfSynthesis:
    dt = plant.model.dt
    continuous = plant
    if dt:
        continuous = GeneralizedPlant(bilinear_to_continuous(plant.model), plant.n_meas, plant.n_con)
    matrices = continuous.matrices()
    scalings = (paths_first(matrices), equilibrated(matrices))
    scaled, rate = scalings[0].apply(matrices), scalings[0].rate
    require_stabilisable(scaled, plant.model.state_names, f"synth {method}", rate)
    lower = pointwise_bound(matrices, scalings, place_in_z(dt) if dt else place_in_s)
    verifier = Verifier(plant, continuous.D22, budget)
    found = portfolio(matrices, scalings, budget, lower.value, continuous.D22)
    best, by = _best_of_all_methods(matrices, found, verifier, lower.value, budget, say)
    if best is None:
        raise NoTrustworthyNumber(
            f"synth {method}",
            f"no controller could be verified{_ended(budget)} ({len(found.candidates)} were found; {by})",
            hint="look at the plant's scaling, at poles and zeros on the imaginary axis, and at D12 and D21",
            more=broken_assumptions(scaled, plant, rate),
        )
    if not best.certified:  # so fast a controller that digits are lost: a little more gamma buys a calmer one
        soften(found.leader, best.candidate, (0.2 + 0.8 * CALMER) * best.gamma)
        best = verifier.accurate(found.candidates, best, CALMER)
    chosen = best
    if gamma_rel > 1:
        soften(found.leader, best.candidate, gamma_rel * best.gamma)
        chosen = verifier.sanest(found.candidates, best, gamma_rel)
        say(f"softened: gamma {chosen.gamma:.6g}, fastest pole {chosen.candidate.pace:.4g} rad/s")
    if bandwidth is not None and chosen.candidate.pace > bandwidth:
        chosen = verifier.within(found.candidates, best, gamma_rel, bandwidth)
    if chosen.gamma < best.gamma:  # on the way to a softer one a smaller one was found
        best = chosen
    return _finished(
        plant=plant,
        chosen=chosen,
        best=best,
        disagree=found.disagree,
        lower=lower,
        optimum=min(found.estimated_optimum(), best.gamma),
        assumptions=broken_assumptions(scaled, plant, rate),
        gamma_rel=gamma_rel,
        budget=budget,
        by=by,
        method=method,
        weights=weights,
    )


def _best_of_all_methods(
    matrices: PlantMatrices,
    found: Portfolio,
    verifier: Verifier,
    lower: float,
    budget: Budget,
    say: Callable[[str], None],
) -> tuple[Verified | None, str]:
    """The best verified controller, by Riccati equations, then LMIs, then nonsmooth search; and what gave it."""
    best, by = verifier.smallest(found.candidates), "two Riccati equations"
    say(_line("two Riccati equations", best))
    optimum, disagree = found.estimated_optimum(), found.disagree
    if best is None:
        note = _by_lmi(matrices, found.leader, budget)
        best, by = verifier.smallest(found.candidates), f"two Riccati equations gave none; {note}"
        optimum = disagree = float("nan")
        say(_line(note, best))
    if best is None:
        note = stabilise(matrices, found.leader, budget, say)
        found.leader.polish(found.leader.best)
        best, by = verifier.smallest(found.candidates), f"{by}; {note}"
        say(_line(note, best))
    scale = found.leader.scaling.gain
    if best is None or not is_poor(best.gamma, optimum, lower, disagree, scale):
        return best, by
    descended = descend_from(matrices, found.leader, best.candidate, budget)
    again = None if descended is None else verifier.smallest(found.candidates)
    if again is not None and again.certified >= best.certified and again.gamma < best.gamma:
        best, by = again, f"{by}; nonsmooth descent"
    say(_line("nonsmooth descent", best))
    return best, by


def _ended(budget: Budget) -> str:
    """Words for an error about what ended the search, where that was the budget."""
    return f": {NOT_REPEATABLE}" if budget.struck else " within the work budget" if budget.over else ""


def _line(stage: str, best: Verified | None) -> str:
    return f"{stage}: none verified yet" if best is None else f"{stage}: gamma {best.gamma:.6g}"


def _by_lmi(matrices: PlantMatrices, search: Search, budget: Budget) -> str:
    """Add the controllers of the projection LMIs to the search, and refine the best of them; how it went."""
    controllers, note = lmi_controllers(matrices, search.scaling, budget)
    for K in controllers:
        search.adopt(K)
    search.polish(search.best)
    return note


def _finished(
    *,
    plant: GeneralizedPlant,
    chosen: Verified,
    best: Verified,
    disagree: float,
    lower: GammaBound,
    optimum: float,
    assumptions: tuple[str, ...],
    gamma_rel: float,
    budget: Budget,
    by: str,
    method: str,
    weights: Mapping[str, StateSpaceModel],
) -> HinfSynthesis:
    loop = chosen.loop
    status = Status.CERTIFIED if chosen.certified else Status.INACCURATE
    text = "loop rebuilt from K is stable, its norm was verified, and P(jw), K(jw) on their own give the same"
    parts = [text if status.trustworthy else chosen.doubt]
    parts.append(f"by {by}")
    if chosen is not best:
        parts.append(
            f"the softest controller within the allowed {gamma_rel - 1:.0%} above the smallest gamma {best.gamma:.6g}"
        )
    status, reason = told(status, parts, budget)
    return HinfSynthesis(
        K=chosen.K,
        gamma=chosen.gamma,
        closed_loop=loop,
        status=status,
        peak_frequency=chosen.norm.frequency,
        reason=reason,
        limit=limiting_channels(loop, chosen.norm.frequency),
        smallest_gamma=best.gamma,
        scalings_disagree=disagree,
        lower_bound=lower,
        estimated_optimum=optimum,
        assumptions=assumptions,
        norm=chosen.norm,
        plant=plant,
        method=method,
        weights=dict(weights),
    )
