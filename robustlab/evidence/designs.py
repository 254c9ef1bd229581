"""Claims about loops with the stored controller: of the plant and K, of which the checker forms the loop in balls."""

from __future__ import annotations

import numpy as np

from robustlab.budget import search_budget
from robustlab.evidence.axis import gain_claims, margin_claims
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.intervals import cover_axis
from robustlab.mu_analysis.axis.joined_scalings import loop_axis_claims
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.constants import WORK
from robustlab.norms import H2Norm, hinf_norm
from robustlab.norms.claims import h2_loop_claims, loop_claims
from robustlab.norms.numbers import ABOVE, Numbers, loop_numbers
from robustlab.synthesis.dk.dk_design import DKSynthesis
from robustlab.synthesis.fixed_structure import FixedSynthesis
from robustlab.synthesis.goal_tuning import TunedSynthesis
from robustlab.synthesis.hinf.loop_shaping import NcfSynthesis
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.reduction.controller_reduction import ReducedController
from robustlab.uncertainty.distances.coprime import four_block
from robustlab.verification.claim import Claim


def hinf_claims(found: Synthesis) -> list[Claim]:
    """Return the claim of a stable loop with an H-infinity norm of at most ``gamma``."""
    return loop_claims(found.plant.model, found.K, found.gamma)


def h2_claims(found: Synthesis) -> list[Claim]:
    """Return the claim of a stable loop with an H2 norm of at most ``gamma``."""
    return h2_loop_claims(found.plant.model, found.K, found.gamma)


def ncf_claims(found: NcfSynthesis) -> list[Claim]:
    """Return the claims of a four-block norm of at most ``gamma`` of the shaped loop, and of a stable original loop."""
    shaped = loop_claims(four_block(found.shaped_plant), found.K_shaped, found.gamma)
    return shaped + loop_claims(found.plant.model, found.K, hinf_norm(found.closed_loop).upper)


def fixed_claims(found: FixedSynthesis) -> list[Claim]:
    """Return the claims of the norm of every plant's loop; of a set of the worst-case gain."""
    if found.worst is not None:
        if found.gamma != found.worst.upper:
            return []
        numbers = loop_numbers(found.plants[0].model, found.K)
        return [
            _of_loop(claim, numbers) if claim.kind != "delay-weight" else claim for claim in gain_claims(found.worst)
        ]
    make = loop_claims if found.objective == "hinf" else h2_loop_claims
    return [
        c for plant, gamma in zip(found.plants, found.gammas, strict=True) for c in make(plant.model, found.K, gamma)
    ]


def tuned_claims(found: TunedSynthesis) -> list[Claim]:
    """Return the claims of the value of every goal for every plant: a norm of its weighted loop."""
    return [
        claim
        for goal in found.goals
        for plant, value in zip(goal.plants, goal.values, strict=True)
        for claim in (loop_claims if goal.norm == "hinf" else h2_loop_claims)(plant.model, found.K, value)
    ]


def reduced_controller_claims(found: ReducedController) -> list[Claim]:
    """Return the claim of the loop with the reduced controller: a norm, or stability for the set."""
    if isinstance(found.evidence, Margin):
        numbers = loop_numbers(found.plant.model, found.K)
        stable = [claim for claim in margin_claims(found.evidence) if claim.kind in ("mu-axis", "mu-boxes")]
        return [_of_loop(claim, numbers) for claim in stable]
    plant = found.plant if found.scaled is None else found.scaled
    make = h2_loop_claims if isinstance(found.evidence, H2Norm) else loop_claims
    return make(plant.model, found.K, found.gamma)


def _of_loop(claim: Claim, numbers: Numbers) -> Claim:
    """Return the claim about a loop as one about its plant and controller."""
    return Claim(claim.kind, {**{name: x for name, x in claim.numbers.items() if name not in "ABCD"}, **numbers})


def dk_claims(found: DKSynthesis) -> list[Claim]:
    """Return the claim that mu of the loop is at most ``gamma`` at all frequencies, by constant D, G on intervals.

    For scalings that depend on the frequency, or a discrete loop, new intervals are computed at this level.
    """
    level, pieces = found.gamma * ABOVE, found.pieces
    if not pieces:
        loop = found.plant.close(found.K)
        mapped = continuous(loop)
        first = np.append(seed_frequencies(mapped), found.frequency if not loop.is_discrete else [])
        budget = search_budget("verify", WORK, 1.0, None)
        cover = cover_axis(mapped, found.blocks, found.gamma, first=first, budget=budget, accuracy=0.5e-6)
        if cover.open or cover.beta > level:
            return []
        pieces = tuple(cover.pieces)
    return loop_axis_claims(found.plant.model, found.K, found.blocks, level, pieces)
