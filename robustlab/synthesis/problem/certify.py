"""The certificate of every design: the norm of the loop of P and K as stored, proved in ball arithmetic.

The rebuilt loop carries rounding: the checker (`robustlab.verification`) closes P and K itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balancing_exponents, lyapunov
from robustlab.norms import H2Norm, HinfNorm, h2_by_gramians, hinf_norm
from robustlab.norms.claims import Numbers, above, gramian_claims, h2_loop_claims, loop_numbers, norm_matrix
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.verification.balls import midpoints, precision
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome
from robustlab.verification.models import loop as closed_in_balls

# Shares above the gain at the peak at which a proof is tried. The last is the largest loss for a certificate; norms of
# the rebuilt loop and of P and K that differ by more disagree.
SHARES = (1e-4, 1e-3)
AGREEMENT = SHARES[-1]
# Effort of the checker at 20 states where no matrix proves the norm: enough for a counterexample, and for some boxes.
EFFORT = 400
BITS = 192
# A direct term from w to z below this share of D11 is rounding of the cancellation by D_K.
CANCELLED = 1e-10


class Certificate(NamedTuple):
    """An upper bound of the norm of a loop, and why it is not certified (empty if it is)."""

    gamma: float
    doubt: str


def certified(
    plant: GeneralizedPlant,
    K: StateSpaceModel,
    norm: HinfNorm | H2Norm,
    level: float | None = None,
    effort: int = EFFORT,
) -> Certificate:
    """Prove the norm of the loop of P and K; if that loop has a larger norm, return the larger one with a doubt."""
    value = norm.value if isinstance(norm, H2Norm) else norm.upper if level is None else level
    if not np.isfinite(value):
        return Certificate(value, norm.reason)
    numbers = loop_numbers(plant.model, K)
    work = round(effort * max(1.0, ((plant.model.n_states + K.n_states) / 20) ** 3))
    quick = _plain_gramian(plant.model, K, numbers, value) if isinstance(norm, H2Norm) else None
    if norm.status.trustworthy and quick is not None and check(quick, effort=work).outcome is Outcome.PROVED:
        return Certificate(value, "")
    true = closed_exactly(plant, K)
    if isinstance(norm, H2Norm):
        if not norm.status.trustworthy or not true.n_states:
            return _in_floats(true, norm, value, norm.reason)
        where = "no Gramian was found"
        for gamma in (value, value * (1 + AGREEMENT)):
            for claim in _h2_claims(plant, K, true, gamma):
                found = check(claim, effort=work)
                where = found.where
                if found.outcome is Outcome.PROVED:
                    return Certificate(gamma, "")
    else:
        levels = [value]
        if level is None and true.n_states:
            levels = sorted({value, *(norm.lower * (1 + share) for share in SHARES)})
        for gamma in levels:
            if norm_matrix(true, above(gamma), min(norm.lower, gamma), numbers):  # checked there
                return Certificate(gamma, "")
        found = check(Claim("loop-norm", {**numbers, "gamma": np.array(above(levels[-1]))}), effort=work)
        where = found.where
        if found.outcome is Outcome.PROVED:
            return Certificate(levels[-1], "")
    return _in_floats(true, norm, value, f"not proved in ball arithmetic of P and K as they are: {where}")


def _plain_gramian(plant: StateSpaceModel, K: StateSpaceModel, numbers: Numbers, value: float) -> Claim | None:
    """Return the claim of an H2 norm by an enlarged Gramian in doubles, half the work where it is enough."""
    loop, level = lower_lft(plant, K), above(value)
    if not loop.n_states or (loop.D.any() and not loop.dt):
        return None
    t = np.exp2(balancing_exponents(loop.A, loop.B, loop.C).astype(float))
    A, B, C = loop.A / t[:, None] * t, loop.B / t[:, None], loop.C * t
    try:
        P, unit = (lyapunov(A.T, Q, loop.is_discrete) for Q in (C.T @ C, np.eye(len(A))))
    except NoTrustworthyNumber:
        return None
    cost = float((B * (unit @ B)).sum())
    P = P + (0.5 * (level**2 - value**2) / cost if cost > 0 else 1.0) * unit
    return Claim("gramian", {**numbers, "value": np.array(level), "P": 0.5 * (P + P.T) / t[:, None] / t})


def closed_exactly(plant: GeneralizedPlant, K: StateSpaceModel) -> StateSpaceModel:
    """Return the loop of P and K, each entry rounded once."""
    with precision(BITS):
        exact = closed_in_balls(Claim("", loop_numbers(plant.model, K)))
        A, B, C, D = (midpoints(X) for X in (exact.A, exact.B, exact.C, exact.D))
        return StateSpaceModel(A, B, C, D, plant.model.dt)


def _in_floats(true: StateSpaceModel, norm: HinfNorm | H2Norm, value: float, doubt: str) -> Certificate:
    """Return the doubt, or the norm of the loop of P and K where it is larger than that of the rebuilt loop."""
    larger = h2_by_gramians(true).value if isinstance(norm, H2Norm) else hinf_norm(true).upper
    if not value * (1 + AGREEMENT) < larger < np.inf:
        return Certificate(value, doubt)
    text = f"P and K closed exactly have the norm {larger:.6g}, the rebuilt loop {value:.6g}: digits were lost"
    return Certificate(larger, text)


def _h2_claims(plant: GeneralizedPlant, K: StateSpaceModel, true: StateSpaceModel, level: float) -> list[Claim]:
    """Return the claims of the loop; of its rounded matrices without D if D_K cancels D11 up to rounding."""
    D11 = plant.model.D[: plant.n_z, : plant.n_w]
    cancelled = CANCELLED * max(np.abs(D11).max(initial=0.0), np.abs(K.D).max(initial=0.0))
    if true.dt or not 0 < np.abs(true.D).max(initial=0.0) <= cancelled:
        return h2_loop_claims(plant.model, K, level)
    return gramian_claims(StateSpaceModel(true.A, true.B, true.C, np.zeros_like(true.D)), level)
