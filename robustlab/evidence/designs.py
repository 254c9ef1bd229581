"""Claims about loops with the controller as it is stored, about reduced models, and about sets.

What is claimed of a design is claimed of its plant and its K; the checker closes the loop itself, in balls.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from robustlab.budget import search_budget
from robustlab.evidence.axis import joined_scalings, margin_claims
from robustlab.evidence.norms import above, gramian_claims, norm_claims, proof_of_norm
from robustlab.evidence.numbers import ABOVE, Numbers, block_rows, loop_numbers, matrices, model_numbers
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.intervals import cover_axis
from robustlab.mu_analysis.axis.stability import margin_within
from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
from robustlab.mu_analysis.tuning import TUNING
from robustlab.norms import HinfNorm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dk_design import DKSynthesis
from robustlab.synthesis.fixed.fixed_structure import FixedSynthesis
from robustlab.synthesis.h2.h2_synthesis import H2Synthesis
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.uncertainty.built import BuiltModel
from robustlab.verification.claim import Claim


def _loop(found: Synthesis) -> tuple[StateSpaceModel, Numbers]:
    """The loop with the states of the plant, then those of K, and what it is made of."""
    plant = found.plant
    return plant.close(found.K), loop_numbers(plant.model, plant.n_meas, plant.n_con, found.K)


def hinf_claims(found: Synthesis) -> list[Claim]:
    """That plant and controller make a stable loop with an H-infinity norm of at most ``gamma``."""
    loop, numbers = _loop(found)
    level = above(found.gamma)
    return [
        Claim("loop-norm", {**numbers, "gamma": np.array(level), **proof_of_norm(loop, level, found.gamma, numbers)})
    ]


def h2_claims(found: H2Synthesis) -> list[Claim]:
    """That plant and controller make a stable loop with an H2 norm of at most ``gamma``."""
    loop, numbers = _loop(found)
    return gramian_claims(loop, found.gamma, numbers)


def fixed_claims(found: FixedSynthesis) -> list[Claim]:
    """As of the other designs, for one plant; of a set the worst-case gain."""
    if found.worst is not None:
        return [] if found.gamma != found.worst.upper else _worst(found)
    if len(found.gammas) > 1:
        return []
    if found.objective == "hinf":
        return hinf_claims(found)
    loop, numbers = _loop(found)
    return gramian_claims(loop, found.gamma, numbers)


def _worst(found: FixedSynthesis) -> list[Claim]:
    from robustlab.evidence.axis import gain_claims

    return gain_claims(found.worst) if found.worst is not None else []


def dk_claims(found: DKSynthesis) -> list[Claim]:
    """That mu of the loop is at most ``gamma`` at all frequencies, by constant D, G on intervals.

    Where the design rests on scalings that depend on the frequency, or the loop is discrete, intervals are sought anew
    at the level claimed.
    """
    loop, numbers = _loop(found)
    mapped = continuous(loop)
    level = found.gamma * ABOVE
    pieces = found.pieces
    if not pieces:
        first = np.append(seed_frequencies(mapped), found.frequency if not loop.is_discrete else [])
        budget = search_budget("verify", TUNING.work, 1.0, None)
        cover = cover_axis(mapped, found.blocks, found.gamma, first=first, budget=budget, accuracy=0.5e-6)
        if cover.open or cover.beta > level:
            return []
        pieces = tuple(cover.pieces)

    def at(omega: float) -> float:
        return float(2 * np.arctan(omega) / loop.dt) if loop.is_discrete else float(omega)

    scalings = joined_scalings(mapped, found.blocks, pieces, at)
    if scalings is None:
        return []
    return [Claim("mu-axis", {**numbers, "blocks": block_rows(found.blocks), "level": np.array(level), **scalings})]


def reduction_claims(found: ReducedModel) -> list[Claim]:
    """That the two models differ by no more than ``error`` at all frequencies."""
    whole = found.error if found.difference is None else found.difference
    if not isinstance(whole, HinfNorm) or not np.isfinite(whole.upper) or found.left_out:
        return []
    full, small = found.full, found.model
    n, k = full.n_states, small.n_states
    apart = StateSpaceModel(
        np.block([[full.A, np.zeros((n, k))], [np.zeros((k, n)), small.A]]), np.vstack([full.B, small.B]),
        np.hstack([full.C, -small.C]), full.D - small.D, full.dt,
    )  # fmt: skip
    if not apart.is_stable():
        return []
    level = above(whole.upper)
    numbers = {**matrices(full, "{}1"), **matrices(small, "{}2"), "dt": np.array(float(full.dt))}
    proof = proof_of_norm(apart, level, whole.upper)
    return [Claim("difference-norm", {**numbers, "gamma": np.array(level), **proof})]


def disk_claims(found: DiskMargins) -> list[Claim]:
    """Those of all loops at once, then of each loop."""
    parts = {id(part): part for part in (found.simultaneous, *found.channels.values()) if isinstance(part, DiskMargin)}
    return [claim for part in parts.values() for claim in one_disk_claims(part)]


def one_disk_claims(found: DiskMargin) -> list[Claim]:
    """That no deltas below ``lower`` in the factors' disks destabilise: of one loop a norm, of several mu."""
    uncertain = found.system
    if uncertain is None or not 0 < found.lower < np.inf:
        return []
    if len(uncertain.blocks) == 1:
        norm = HinfNorm(0.0, 1 / found.lower, np.nan, found.status, system=uncertain.delta_channels)
        return norm_claims(norm)
    budget = search_budget("verify", TUNING.work, 1.0, None)
    margin = margin_within(uncertain, budget, accuracy=1e-4)
    return [claim for claim in margin_claims(margin) if claim.kind == "mu-axis"]


def set_claims(found: BuiltModel) -> list[Claim]:
    """That the set is the nominal model at Delta = 0 and the perturbed one at Delta = I, entry by entry.

    Where a difference of two entries is no double, the set can only come as near as half of its last digit; then the
    claim says how near.
    """
    if found.ends is None or any(b.interval != (-1.0, 1.0) for b in found.model.blocks):
        return []
    nominal, perturbed = found.ends
    numbers = {
        **{key: value for key, value in model_numbers(found.model.M).items() if key != "dt"},
        **matrices(nominal, "{}0"), **matrices(perturbed, "{}1"), "blocks": block_rows(found.model.blocks),
    }  # fmt: skip
    pairs = [
        pair for name in "ABCD"
        for pair in zip(*(getattr(end, name).ravel().tolist() for end in found.ends), strict=True)
    ]  # fmt: skip
    off = max((abs(float(Fraction(y) - Fraction(x) - Fraction(y - x))) for x, y in pairs), default=0.0)
    return [Claim("set", numbers if off == 0 else {**numbers, "tolerance": np.array(off)})]
