"""Claims of results, for `robustlab.verify`: bounds of mu, margins and gains; designs, reductions, sets and covers.

Each function returns the claims of one class of results. Of a loop the plant and K are stored: the checker forms the
loop in balls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from robustlab.analysis.performance import RobustGain
from robustlab.budget import search_budget
from robustlab.delays.approximation import error_weight, pade
from robustlab.delays.model import DelayedModel
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.intervals import (
    Piece,
    continuous,
    cover_axis,
    interval_scalings,
    joined_scalings,
    loop_axis_claims,
    model_frequency,
    seed_frequencies,
)
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin, WorstCaseGain
from robustlab.mu_analysis.axis.robustness import robust_stability
from robustlab.mu_analysis.margins.delayed_models import DelayGain, DelayProof, DelayStability, covering_set
from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
from robustlab.mu_analysis.margins.uncertainty_cover import Cover
from robustlab.mu_analysis.matrix.bounds import MuBounds
from robustlab.mu_analysis.matrix.branch_and_bound import Box, lowest, root_box
from robustlab.mu_analysis.matrix.upper import WORK
from robustlab.norms import H2Norm, HinfNorm, hinf_norm
from robustlab.norms.claims import (
    ABOVE,
    Numbers,
    above,
    band_scalings,
    block_rows,
    h2_loop_claims,
    loop_claims,
    loop_numbers,
    matrices,
    model_numbers,
    norm_matrix,
)
from robustlab.norms.hinfinity import norm_claims
from robustlab.statespace import StateSpaceModel, append
from robustlab.synthesis.dk.dk_iteration import DKSynthesis
from robustlab.synthesis.fixed_structure import FixedSynthesis
from robustlab.synthesis.goal_tuning import TunedSynthesis
from robustlab.synthesis.hinf.loop_shaping import NcfSynthesis
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.reduction.controller_reduction import ReducedController
from robustlab.synthesis.reduction.model_reduction import ReducedModel
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, block_slices, delta_matrix
from robustlab.uncertainty.elementwise import BuiltModel
from robustlab.uncertainty.gap_metric import CoprimeMargin, four_block
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.claim import Claim

_diagonal: Any = block_diag  # its types are not declared
SAME = 1e-10  # of a range: sides of boxes nearer than this are equal
TOLERANCE = 1e-12  # for the rounding of a stored approximation and of its weight, which are not exactly zero at zero
GRID = np.geomspace(1e-2, 1e4, 20_000)  # frequencies times the delay, for the search of the far end


def mu_claims(found: MuBounds) -> list[Claim]:
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
            # no Delta below the inverse of the bound by branch and bound makes I - M Delta singular
            everywhere = [(box, Piece(0.0, np.inf, 1.0, bound)) for box, bound in proof]
            boxes = _boxes(found.blocks, everywhere, 1 / (upper * ABOVE), float)
            levels = _levels(found.blocks, upper * ABOVE)
            claims.append(Claim("mu-upper-boxes", {"M": M, "blocks": rows, "level": levels, **boxes}))
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
    at = partial(model_frequency, uncertain.dt)
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
    return claims + weight_claims(uncertain)


def gain_claims(found: WorstCaseGain | RobustGain | None) -> list[Claim]:
    """Return the claim that no member has a larger gain than ``upper``; of a `RobustGain` that of its proof."""
    if isinstance(found, RobustGain):
        return gain_claims(found.proof)
    if found is None or (uncertain := found.system) is None or not np.isfinite(found.upper) or not found.proof:
        return []
    performance = FullBlock(PERFORMANCE, len(uncertain.inputs), len(uncertain.outputs))
    blocks, at = (*uncertain.blocks, performance), partial(model_frequency, uncertain.dt)
    gamma = np.array(found.upper * ABOVE)
    numbers: Numbers = {**model_numbers(uncertain.M), "blocks": block_rows(blocks), "gamma": gamma}
    if found.boxes or not _symmetric(blocks):
        levels = np.append(np.ones(len(blocks) - 1), gamma)
        proved = _proved(blocks, found, levels, 1.0)
        claim = Claim("worst-gain-boxes", {**numbers, **_boxes(blocks, proved, 1.0, at)})
    else:
        claim = Claim("worst-gain", {**numbers, **interval_scalings(found.proof, at)})
    return [claim, *weight_claims(uncertain)]


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
    return np.array([b.interval or (-1.0, 1.0) for b in blocks], dtype=float)


def _attained(blocks: Sequence[Block], delta: NDArray[Any]) -> NDArray[np.float64]:
    """Return the inverse norm of each block; huge where the norm is zero."""
    norms = [float(np.linalg.norm(delta[w, z], 2)) for w, z in block_slices(blocks)]
    return np.array([1 / n if n > 0 else 1e300 for n in norms])


def coprime_claims(found: CoprimeMargin) -> list[Claim]:
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
    if found.system is None or not found.stable:
        return []
    return _claims_of_set("delayed-stable", found.system, found.proof, [], {})


def delayed_gain_claims(found: DelayGain) -> list[Claim]:
    if found.system is None or not np.isfinite(found.upper):
        return []
    block = FullBlock("performance", found.system.n_inputs, found.system.n_outputs)
    return _claims_of_set("worst-gain", found.system, found.proof, [block], {"gamma": np.array(found.upper * ABOVE)})


def _delayed_disk_claims(found: DiskMargin, system: DelayedModel) -> list[Claim]:
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
    return [Claim(kind, {**rows, **numbers, **scalings}), *weight_claims(held)]


def weight_claims(uncertain: UncertainModel) -> list[Claim]:
    """Return for each block of a delay the claim that its weight bounds the approximation's error."""
    claims: list[Claim] = []
    for covered in dict.fromkeys(b.covers for b in uncertain.blocks if b.covers is not None):
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


ROUNDING = 1e-14  # of the largest entry: allowance in addition to a member's stated error


def hinf_claims(found: Synthesis) -> list[Claim]:
    return loop_claims(found.plant.model, found.K, found.gamma)


def h2_claims(found: Synthesis) -> list[Claim]:
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
        return [c if c.kind == "delay-weight" else _of_loop(c, numbers) for c in gain_claims(found.worst)]
    return _every_plant(found.K, found.plants, found.gammas, found.objective)


def tuned_claims(found: TunedSynthesis) -> list[Claim]:
    return [c for goal in found.goals for c in _every_plant(found.K, goal.plants, goal.values, goal.norm)]


def _every_plant(K: StateSpaceModel, plants: Sequence[Any], values: Sequence[float], norm: str) -> list[Claim]:
    make = loop_claims if norm == "hinf" else h2_loop_claims
    return [claim for plant, value in zip(plants, values, strict=True) for claim in make(plant.model, K, value)]


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


def reduction_claims(found: ReducedModel) -> list[Claim]:
    """Return the claim of the error norm, weighted or not; none for that of coprime factors."""
    if found.left_out:
        return []
    if found.weights != (None, None):
        return _weighted(found)
    return _difference(found, found.error) if found.method not in ("coprime", "minimal") else []


def _difference(found: ReducedModel, norm: HinfNorm) -> list[Claim]:
    """Return the claim about full minus reduced model; of the gain alone if it is not stable."""
    if not np.isfinite(norm.upper):
        return []
    full, small, level = found.full, found.model, above(norm.upper)
    numbers: Numbers = {**matrices(full, "{}1"), **matrices(small, "{}2"), "dt": np.array(float(full.dt))}
    B, C = np.vstack([full.B, small.B]), np.hstack([full.C, -small.C])
    error = StateSpaceModel(_diagonal(full.A, small.A), B, C, full.D - small.D, full.dt)
    if error.is_stable():
        proof = norm_matrix(error, level, norm.upper)
        return [Claim("difference-norm", {**numbers, "gamma": np.array(level), **proof})]
    scalings = band_scalings(full.n_inputs, full.n_outputs, (0.0, np.inf))
    return [Claim("mu-axis", {**numbers, "level": np.array(level), **scalings})]


def _weighted(found: ReducedModel) -> list[Claim]:
    """Return the claim about the weighted difference: all models as one u = K y, around a plant of wires."""
    full, small = found.full, found.model
    m, p, dt = full.n_inputs, full.n_outputs, full.dt
    first, last = (
        StateSpaceModel([], [], [], np.eye(size), dt) if weight is None else weight
        for weight, size in zip(found.weights, (m, p), strict=True)
    )
    parts = [full, small, first, last]
    K = append(*(g.renamed([f"{i} in {k}" for k in range(g.n_inputs)], [f"{i} out {k}" for k in range(g.n_outputs)])
                 for i, g in enumerate(parts)))  # fmt: skip
    w, z = first.n_inputs, last.n_outputs
    u = np.cumsum([w, p, p, m])  # positions of the outputs of each part among the inputs of the wiring
    y = np.cumsum([z, m, m, w])
    D = np.zeros((z + K.n_inputs, w + K.n_outputs))
    D[:z, u[3] :] = np.eye(z)
    D[y[0] : y[1], u[2] : u[3]] = D[y[1] : y[2], u[2] : u[3]] = np.eye(m)
    D[y[2] : y[3], :w] = np.eye(w)
    D[y[3] :, u[0] : u[1]], D[y[3] :, u[1] : u[2]] = np.eye(p), -np.eye(p)
    if not K.is_stable():
        return []
    return loop_claims(StateSpaceModel([], [], [], D, dt), K, found.error.upper)


def set_claims(found: BuiltModel) -> list[Claim]:
    """Return the claim that the set is the nominal model at Delta = 0 and the perturbed one at Delta = I.

    If a difference of two entries is no double, the claim has the rounding as its tolerance.
    """
    if found.ends is None or any(b.interval != (-1.0, 1.0) for b in found.model.blocks):
        return []
    nominal, perturbed = found.ends
    numbers = {
        **{key: value for key, value in model_numbers(found.model.M).items() if key != "dt"},
        **matrices(nominal, "{}0"), **matrices(perturbed, "{}1"), "blocks": block_rows(found.model.blocks),
    }  # fmt: skip
    first, last = (np.concatenate([getattr(end, name).ravel() for name in "ABCD"]).tolist() for end in found.ends)
    pairs = zip(first, last, strict=True)
    off = max((abs(float(Fraction(y) - Fraction(x) - Fraction(y - x))) for x, y in pairs), default=0.0)
    return [Claim("set", numbers if off == 0 else {**numbers, "tolerance": np.array(off)})]


def cover_claims(found: Cover) -> list[Claim]:
    """Return the claims that each model is a member: at its parameters, or (``additive``) by an H-infinity norm."""
    if len(found.deltas) != len(found.models):
        return []
    if found.form == "additive":
        return _error_norms(found)
    blocks = found.model.blocks
    return _members(found, blocks) if all(b.interval for b in blocks) else []


def _members(found: Cover, blocks: Sequence[Any]) -> list[Claim]:
    """Return the claims that each model is the member at its parameters, every entry to within a tolerance."""
    common: Numbers = {
        **{key: value for key, value in model_numbers(found.model.M).items() if key != "dt"},
        **matrices(found.model.nominal, "{}0"), "blocks": block_rows(blocks),
        "ranges": np.array([b.interval for b in blocks], dtype=float).reshape(-1, 2),
    }  # fmt: skip
    claims: list[Claim] = []
    for model, deltas, miss in zip(found.models, found.deltas, found.misses, strict=True):
        size = max(float(np.abs(getattr(model, x)).max(initial=0.0)) for x in "ABCD")
        delta = np.array([complex(b.entry(deltas[b.name])).real for b in blocks])
        tolerance = np.array((miss + ROUNDING) * size)
        claims.append(Claim("set", {**common, **matrices(model, "{}1"), "delta": delta, "tolerance": tolerance}))
    return claims


def _error_norms(found: Cover) -> list[Claim]:
    r"""Return the claims that :math:`w^{-1} (G_i - G)` of each model is stable with a norm of at most one."""
    if found.fit is None:
        return []
    weight, M, (q, p) = found.fit.weight, found.model.M, found.model.delta_shape
    n = M.n_states - weight.n_states * found.model.nominal.n_inputs
    centre = StateSpaceModel(M.A[:n, :n], M.B[:n, q:], M.C[p:, :n], M.D[p:, q:], M.dt)
    return [
        _inside(model, centre, weight, size)
        for i, (model, size) in enumerate(zip(found.models, found.sizes, strict=True), 1) if i != found.nominal
    ]  # fmt: skip


def _inside(model: StateSpaceModel, centre: StateSpaceModel, weight: StateSpaceModel, size: float) -> Claim:
    r"""Return the claim about the error times the weight's inverse, as a loop with the models' own entries.

    In each channel :math:`w v = r` is :math:`d v = r - C_w x_w`. With K = 1/s, s the power of two next to d, and the
    direct term s - d (exact: they are within a factor of two) it is :math:`y = r - C_w x_w + (s - d) v`, v = K y. K
    returns v twice, to separate the direct terms of both models.
    """
    m, p, n = model.n_inputs, model.n_outputs, model.n_states + centre.n_states
    d = float(weight.D[0, 0])
    s = math.copysign(2.0 ** round(math.log2(abs(d))), d)
    one = np.eye(m)
    A_w, B_w, C_w = (np.kron(one, X) for X in (weight.A, weight.B, weight.C))
    A, k = _diagonal(model.A, centre.A, A_w), len(A_w)
    B = np.vstack([_diagonal(model.B, centre.B), np.hstack([B_w, np.zeros((k, m))])])
    C = np.block([[model.C, -centre.C, np.zeros((p, k))], [np.zeros((m, n)), -C_w]])
    D = np.block([[np.zeros((p, m)), model.D, -centre.D], [one, (s - d) * one, np.zeros((m, m))]])
    P = StateSpaceModel(A, np.hstack([np.zeros((n + k, m)), B]), C, D, model.dt)
    K = StateSpaceModel([], [], [], np.vstack([one, one]) / s, model.dt)
    v_x, both = np.hstack([np.zeros((m, n)), -C_w]) / d, B[:, :m] + B[:, m:]
    direct = model.D - centre.D
    loop = StateSpaceModel(A + both @ v_x, both / d, C[:p] + direct @ v_x, direct / d, model.dt)
    level = 1.0 if size < 1.0 else above(size)
    numbers = loop_numbers(P, K)
    return Claim("loop-norm", {**numbers, "gamma": np.array(level), **norm_matrix(loop, level, size, numbers)})
