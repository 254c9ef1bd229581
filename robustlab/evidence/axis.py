"""Claims about mu, of a matrix and over the frequency axis, and about robustness by a norm of a loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.analysis.performance import RobustGain
from robustlab.budget import search_budget
from robustlab.delays.approximation import error_weight, pade
from robustlab.delays.model import DelayedModel
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import model_frequency
from robustlab.mu_analysis.axis.intervals import Piece, interval_scalings, joined_scalings
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin, WorstCaseGain
from robustlab.mu_analysis.axis.robustness import robust_stability
from robustlab.mu_analysis.margins.delay_margins import DelayGain, DelayProof, DelayStability, covering_set
from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
from robustlab.mu_analysis.matrix.bounds import BoxProof, MuBounds
from robustlab.mu_analysis.matrix.branch_and_bound import Box, lowest, root_box
from robustlab.mu_analysis.matrix.upper import WORK
from robustlab.norms import HinfNorm
from robustlab.norms.claims import ABOVE, Numbers, block_rows, loop_claims, matrices, model_numbers
from robustlab.norms.hinfinity import norm_claims
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, block_slices, delta_matrix
from robustlab.uncertainty.distances import CoprimeMargin, four_block
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.claim import Claim

SAME = 1e-10  # of a range: sides of boxes nearer than this are equal
TOLERANCE = 1e-12  # for the rounding of a stored approximation and of its weight, which are not exactly zero at zero
GRID = np.geomspace(1e-2, 1e4, 20_000)  # frequencies times the delay, for the search of the far end


def mu_claims(found: MuBounds) -> list[Claim]:
    """Return the claims of both bounds of each matrix."""
    if found.M is None:
        return []
    every = found.M.reshape(-1, *found.M.shape[-2:])
    rows = block_rows(found.blocks)
    claims: list[Claim] = []
    stacks = [np.reshape(a, (len(every), *np.shape(a)[-2:])) for a in (found.D, found.D_z, found.G, found.delta)]
    for k, M in enumerate(every):
        D, D_z, G, delta = (stack[k] for stack in stacks)
        upper, lower = (float(np.ravel(x)[k]) for x in (found.upper, found.lower))
        if found.proof and (proof := found.proof[k]):
            claims.append(_boxes_claim(M, found.blocks, upper, proof))
        elif np.isfinite(upper) and upper > 0:
            levels = _kept_levels(found, upper * ABOVE)
            if found.fixed:  # G is that of M with its inputs divided by the level
                G = np.repeat(_kept_levels(found, upper), [b.rows for b in found.blocks])[:, None] * G
            numbers = {"M": M, "blocks": rows, "level": levels, "D_w": D, "D_z": D_z, "G": G}
            claims.append(Claim("mu-upper", numbers))
        if lower > 0:
            levels = _kept_levels(found, lower)
            claims.append(Claim("mu-lower", {"M": M, "blocks": rows, "level": levels, "delta": delta}))
    return claims


def _boxes_claim(M: NDArray[Any], blocks: Sequence[Block], upper: float, proof: BoxProof) -> Claim:
    """Return the claim of a bound by branch and bound: no Delta below its inverse makes I - M Delta singular."""
    level = upper * ABOVE
    everywhere = [(box, Piece(0.0, np.inf, 1.0, bound)) for box, bound in proof]
    numbers = {"M": M, "blocks": block_rows(blocks), "level": _levels(blocks, level)}
    return Claim("mu-upper-boxes", {**numbers, **_boxes(blocks, everywhere, 1 / level, float)})


def _kept_levels(found: MuBounds, level: float) -> NDArray[np.float64]:
    """Return the level of each block; one for blocks of fixed size."""
    if not found.fixed:
        return np.array(level)
    return np.array([1.0 if b.name in found.fixed else level for b in found.blocks])


def margin_claims(found: Margin) -> list[Claim]:
    """Return the claims that the set ``lower`` times as large is stable, and that ``upper`` times as large is not."""
    uncertain = found.system
    if uncertain is None:
        return []
    model, blocks = uncertain.delta_channels, uncertain.blocks
    if not blocks:
        return [Claim("stable", {"A": uncertain.M.A, "dt": np.array(float(uncertain.M.dt))})]
    common: Numbers = {**model_numbers(model), "blocks": block_rows(blocks)}
    claims: list[Claim] = []
    at = partial(model_frequency, uncertain)
    if 0 < found.lower < np.inf:
        level = ABOVE / found.lower
        if found.boxes or not _symmetric(blocks):
            levels = _levels(blocks, level)
            proved = _proved(blocks, found, levels, found.lower)
            claims.append(Claim("mu-boxes", {**common, **_boxes(blocks, proved, 1 / level, at), "level": levels}))
        else:
            scalings = joined_scalings(model, blocks, found.proof, at)
            if scalings is not None:
                claims.append(Claim("mu-axis", {**common, "level": np.array(level), **scalings}))
    if found.delta and np.isfinite(found.upper):
        delta = np.asarray(delta_matrix(blocks, found.delta))
        ranges = {} if _symmetric(blocks) else {"ranges": _ranges(blocks)}
        claims.append(Claim("unstable-member", {**common, **ranges, "level": _attained(blocks, delta), "delta": delta}))
    return claims + weight_claims(blocks)


def gain_claims(found: WorstCaseGain) -> list[Claim]:
    """Return the claim that no member has a larger gain than ``upper``."""
    uncertain = found.system
    if uncertain is None or not np.isfinite(found.upper) or not found.proof:
        return []
    performance = FullBlock(PERFORMANCE, len(uncertain.inputs), len(uncertain.outputs))
    blocks, at = (*uncertain.blocks, performance), partial(model_frequency, uncertain)
    gamma = np.array(found.upper * ABOVE)
    numbers: Numbers = {**model_numbers(uncertain.M), "blocks": block_rows(blocks), "gamma": gamma}
    if found.boxes or not _symmetric(blocks):
        levels = np.append(np.ones(len(blocks) - 1), gamma)
        proved = _proved(blocks, found, levels, 1.0)
        claim = Claim("worst-gain-boxes", {**numbers, **_boxes(blocks, proved, 1.0, at)})
    else:
        claim = Claim("worst-gain", {**numbers, **interval_scalings(found.proof, at)})
    return [claim, *weight_claims(blocks)]


def robust_gain_claims(found: RobustGain) -> list[Claim]:
    """Return the claim that no member of the set ``lower`` times as large has a larger gain."""
    return gain_claims(found.proof) if found.proof is not None else []


def _symmetric(blocks: Sequence[Block]) -> bool:
    return bool((lowest(blocks) == -1).all())


def _levels(blocks: Sequence[Block], level: float) -> NDArray[np.float64]:
    """Return one for real blocks, which have their ranges, and the level for the others."""
    return np.array([1.0 if b.interval else level for b in blocks])


def _proved(
    blocks: Sequence[Block], found: Margin | WorstCaseGain, levels: NDArray[np.float64], size: float
) -> list[tuple[Box, Any]]:
    """Return the boxes in which complex blocks were as large as these levels allow, or the whole set."""
    ball = np.array([b.interval is None for b in blocks], dtype=bool)
    large = [(box, piece) for box, piece in found.boxes if (box.half[ball] * levels[ball] >= 1 - SAME).all()]
    return large or [(root_box(blocks, size), piece) for piece in found.proof]


def _boxes(
    blocks: Sequence[Block], proved: Sequence[tuple[Box, Piece]], size: float, at: Callable[[float], float]
) -> Numbers:
    """Return boxes of parameters with the intervals and scalings proved in them, for a set of this size."""
    sides = np.stack([np.stack([box.centre - box.half, box.centre + box.half], axis=1) for box, _ in proved])
    ranges = _ranges(blocks)
    for i, block in enumerate(blocks):
        if block.interval:
            sides[:, i] = _snapped(sides[:, i], size * ranges[i])
        else:
            sides[:, i] = (-1.0, 1.0)
    kept = [k for k in range(len(proved)) if (sides[k, :, 0] < size * ranges[:, 1]).all()
            and (sides[k, :, 1] > size * ranges[:, 0]).all()]  # fmt: skip
    pieces = [proved[k][1] for k in kept]
    stacks = {name: np.stack([getattr(p.bound, key) for p in pieces]).astype(complex)
              for name, key in (("D_w", "Dw"), ("D_z", "Dz"), ("G", "G"))}  # fmt: skip
    ends = {"low": np.array([at(p.low) for p in pieces]), "high": np.array([at(p.high) for p in pieces])}
    return {"box": sides[kept], "ranges": ranges, "size": np.array(size), **ends, **stacks}


def _snapped(sides: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Merge sides that differ by rounding, and move those at the ends of the set slightly outside."""
    width = whole[1] - whole[0]
    values, place = np.unique(sides, return_inverse=True)
    groups = np.concatenate([[0], np.cumsum(np.diff(values) > SAME * width)])
    first = values[np.searchsorted(groups, np.arange(groups[-1] + 1))]
    found = first[groups][place.reshape(sides.shape)]
    found[np.abs(found - whole[0]) < SAME * width] = whole[0] - SAME * width
    found[np.abs(found - whole[1]) < SAME * width] = whole[1] + SAME * width
    return found


def _ranges(blocks: Sequence[Block]) -> NDArray[np.float64]:
    """Return the ends of each real block's range in Delta, for a set of size one; -1, 1 of other blocks."""
    return np.array([b.interval or (-1.0, 1.0) for b in blocks], dtype=float)


def _attained(blocks: Sequence[Block], delta: NDArray[Any]) -> NDArray[np.float64]:
    """Return the inverse norm of each block; huge where the norm is zero."""
    norms = [float(np.linalg.norm(delta[w, z], 2)) for w, z in block_slices(blocks)]
    return np.array([1 / n if n > 0 else 1e300 for n in norms])


def coprime_claims(found: CoprimeMargin) -> list[Claim]:
    """Return the claim of a stable loop with a four-block norm of at most one over ``lower``."""
    if found.plant is None or found.K is None or not found.lower > 0:
        return []
    return loop_claims(four_block(found.plant), found.K, 1 / found.lower)


def disk_claims(found: DiskMargins) -> list[Claim]:
    """Return the claims of all loops at once, then of each loop."""
    parts = {id(part): part for part in (found.simultaneous, *found.channels.values()) if isinstance(part, DiskMargin)}
    return [claim for part in parts.values() for claim in one_disk_claims(part)]


def one_disk_claims(found: DiskMargin) -> list[Claim]:
    """Return the claim that no deltas below ``lower`` destabilise: for one loop a norm, for several mu."""
    system = found.system
    if system is None or not 0 < found.lower < np.inf:
        return []
    if isinstance(system, DelayedModel):
        return _delayed_disk_claims(found, system)
    if len(system.blocks) == 1:
        norm = HinfNorm(0.0, 1 / found.lower, np.nan, found.status, system=system.delta_channels)
        return norm_claims(norm)
    budget = search_budget("verify", WORK, 1.0, None)
    margin = robust_stability(system, accuracy=1e-4, budget=budget)
    return [claim for claim in margin_claims(margin) if claim.kind == "mu-axis"]


def delayed_stability_claims(found: DelayStability) -> list[Claim]:
    """Return the claim, if proved, that every member of the set, which contains the delayed model, is stable."""
    if found.system is None or not found.stable:
        return []
    return _claims_of_set("delayed-stable", found.system, found.proof, [], {})


def delayed_gain_claims(found: DelayGain) -> list[Claim]:
    """Return the claim that no member has a gain above ``upper``."""
    if found.system is None or not np.isfinite(found.upper):
        return []
    block = FullBlock("performance", found.system.n_inputs, found.system.n_outputs)
    return _claims_of_set("worst-gain", found.system, found.proof, [block], {"gamma": np.array(found.upper * ABOVE)})


def _delayed_disk_claims(found: DiskMargin, system: DelayedModel) -> list[Claim]:
    """Return the claim of the bound of mu of the deltas, with the blocks of the delays."""
    if found.proof is None:
        return []
    blocks = [ComplexScalar(name) for name in found.factor] or [ComplexScalar("delta")]
    delays = len(covering_set(system, found.proof.order).blocks)
    level = np.array([1.0] * delays + [ABOVE / found.lower] * len(blocks))
    return _claims_of_set("mu-axis", system, found.proof, blocks, {"level": level})


def _claims_of_set(
    kind: str, model: DelayedModel, proof: DelayProof | None, blocks: Sequence[Block], numbers: Numbers
) -> list[Claim]:
    """Return the claim about the set that contains the model, and that its weights cover the delays."""
    if proof is None:
        return []
    held = covering_set(model, proof.order, blocks)
    M = held.delta_channels
    scalings = joined_scalings(M, held.blocks, proof.pieces, float)
    if scalings is None:
        return []
    rows = {**model_numbers(M), "blocks": block_rows(held.blocks)}
    return [Claim(kind, {**rows, **numbers, **scalings}), *weight_claims(held.blocks)]


def delay_claims(found: UncertainModel) -> list[Claim]:
    """Return the claims that the weights of the set's delays cover them."""
    return weight_claims(found.blocks)


def weight_claims(blocks: Sequence[Block]) -> list[Claim]:
    """Return for each block of a delay the claim that its weight bounds the approximation's error."""
    claims: list[Claim] = []
    for covered in dict.fromkeys(b.covers for b in blocks if b.covers is not None):
        tau, spread, order, slope = covered
        R, W = pade(tau, order), error_weight(order, slope, spread / tau).scaled(tau)
        low, high = max(tau - spread, 0.0), tau + spread
        numbers = {**matrices(R, "R_{}"), **matrices(W, "W_{}"), "dt": np.array(0.0), "range": np.array([low, high])}
        more = {"far": np.array(_far(R, W, 0.5 * (low + high))), "tolerance": np.array(TOLERANCE)}
        claims.append(Claim("delay-weight", {**numbers, **more}))
    return claims


def _far(R: StateSpaceModel, W: StateSpaceModel, middle: float) -> float:
    """Return a frequency above which the weight exceeds 1 + |R|."""
    omega = GRID / middle
    r, w = (frequency_response(G, omega)[:, 0, 0] for G in (R, W))
    short = np.abs(w) ** 2 <= 2.0 + 2.0 * np.abs(r) ** 2
    return 1.001 * float(omega[np.flatnonzero(short)[-1] + 1] if short.any() else omega[0])
