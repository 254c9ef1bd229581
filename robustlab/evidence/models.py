"""Claims about loops with the stored controller, reduced models, sets with two given end points, and covers.

Of a loop the plant and K are stored: the checker forms the loop in balls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from robustlab.budget import search_budget
from robustlab.evidence.axis import gain_claims, margin_claims
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.intervals import cover_axis, loop_axis_claims
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.margins.cover import Cover
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
from robustlab.statespace import StateSpaceModel, append
from robustlab.synthesis.dk.dk_design import DKSynthesis
from robustlab.synthesis.fixed_structure import FixedSynthesis
from robustlab.synthesis.goal_tuning import TunedSynthesis
from robustlab.synthesis.hinf.loop_shaping import NcfSynthesis
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.reduction.controller_reduction import ReducedController
from robustlab.synthesis.reduction.model_reduction import ReducedModel
from robustlab.uncertainty.distances import four_block
from robustlab.uncertainty.elementwise import BuiltModel
from robustlab.verification.claim import Claim

ROUNDING = 1e-14  # of the largest entry: allowance in addition to a member's stated error


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
    """Return the claim about the weighted difference: all models as one u = K y, around a plant of wires.

    The first weight (or w) drives both models, their difference drives the second.
    """
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
    pairs = [
        pair for name in "ABCD"
        for pair in zip(*(getattr(end, name).ravel().tolist() for end in found.ends), strict=True)
    ]  # fmt: skip
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


def _diagonal(*parts: Any) -> Any:
    return block_diag(*parts)
