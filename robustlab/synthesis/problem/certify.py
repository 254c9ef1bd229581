"""The certificate of every design: P and K as stored make a loop with the norm found, proved in ball arithmetic.

The rebuilt loop, a realisation in floating point, carries the rounding of its products; where K has large entries it
may be that of another loop. The checker (`robustlab.verification`) closes P and K itself and uses nothing of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustlab.norms import H2Norm, HinfNorm, h2_by_gramians, hinf_norm
from robustlab.norms.bounded_real import norm_matrix
from robustlab.norms.claims import above, h2_loop_claims
from robustlab.norms.numbers import loop_numbers
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.verification.balls import midpoints, precision
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome
from robustlab.verification.models import loop as closed_in_balls

# Shares above the gain at the peak at which a proof is tried. The last is the most that a certificate may cost, and
# from there on the norm of the rebuilt loop and that of P and K are two numbers.
SHARES = (1e-4, 1e-3)
AGREEMENT = SHARES[-1]
# Enough for a counterexample, and for some boxes.
EFFORT = 400
BITS = 192


class Certificate(NamedTuple):
    """What the norm of a loop is proved to be at most, and why it is not certified (empty: it is)."""

    gamma: float
    doubt: str


def certified(
    plant: GeneralizedPlant,
    K: StateSpaceModel,
    norm: HinfNorm | H2Norm,
    level: float | None = None,
    effort: int = EFFORT,
) -> Certificate:
    """The certificate of the norm of the loop of P and K; where that loop has a larger norm, this is shown.

    ``norm``: that of the loop rebuilt in floating point.
    ``level``: what is to be proved, at least the norm; left out: the norm, or a little more.
    ``effort``: of the checker at 20 states, where no matrix proves the norm.
    """
    shown = norm.value if isinstance(norm, H2Norm) else norm.upper if level is None else level
    if not np.isfinite(shown):
        return Certificate(shown, norm.reason)
    true = closed_exactly(plant, K)
    if isinstance(norm, H2Norm):
        claims = h2_loop_claims(plant.model, K, shown * (1 + AGREEMENT))
    else:
        numbers = loop_numbers(plant.model, K)
        levels = [shown]
        if level is None and true.n_states:
            levels = sorted({shown, *(norm.lower * (1 + share) for share in SHARES)})
        for shown in levels:
            if norm_matrix(true, above(shown), min(norm.lower, shown), numbers):  # only what the checker has proved
                return Certificate(shown, "")
        claims = [Claim("loop-norm", {**numbers, "gamma": np.array(above(shown))})]
    answers = [check(claim, effort=round(effort * max(1.0, (true.n_states / 20) ** 3))) for claim in claims]
    if answers and all(answer.outcome is Outcome.PROVED for answer in answers):
        return Certificate(shown, "")
    larger = h2_by_gramians(true).value if isinstance(norm, H2Norm) else hinf_norm(true).upper
    if shown * (1 + AGREEMENT) < larger < np.inf:
        text = f"P and K closed exactly have the norm {larger:.6g}, the rebuilt loop {shown:.6g}: digits were lost"
        return Certificate(larger, text)
    where = answers[0].where if answers else "no Gramian was found"
    return Certificate(shown, f"not proved in ball arithmetic of P and K as they are: {where}")


def closed_exactly(plant: GeneralizedPlant, K: StateSpaceModel) -> StateSpaceModel:
    """The loop of P and K, each entry rounded once."""
    with precision(BITS):
        exact = closed_in_balls(Claim("", loop_numbers(plant.model, K)))
        return StateSpaceModel(*(midpoints(X) for X in (exact.A, exact.B, exact.C, exact.D)), plant.model.dt)
