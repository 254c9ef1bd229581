"""Claims about mu, of a matrix and over the frequency axis, from the pieces that the methods have found."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.evidence.delays import weight_claims
from robustlab.evidence.numbers import ABOVE, Numbers, block_rows, model_numbers
from robustlab.linear_analysis.structural import strong_components
from robustlab.mu_analysis.axis.axis_model import model_frequency
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.robust_gain import RobustGain, output_unit
from robustlab.mu_analysis.axis.worst_gain import PERFORMANCE, WorstCaseGain
from robustlab.mu_analysis.matrix.bounds import BoxProof, MuBounds
from robustlab.mu_analysis.matrix.box import Box, lowest, root_box
from robustlab.mu_analysis.matrix.decomposition import entries
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, FullBlock, block_slices, delta_matrix
from robustlab.verification.claim import Claim

APART = 64  # binary digits between the scalings of parts of which one acts on the other, and not back
SAME = 1e-10  # of a range: faces nearer than this are one face
DEEPEST = 900  # binary digits in all: beyond them doubles end


def mu_claims(found: MuBounds) -> list[Claim]:
    """Both bounds of each matrix."""
    if found.M is None:
        return []
    matrices = found.M.reshape(-1, *found.M.shape[-2:])
    rows = block_rows(found.blocks)
    claims: list[Claim] = []
    stacks = [np.reshape(a, (len(matrices), *np.shape(a)[-2:])) for a in (found.D, found.D_z, found.G, found.delta)]
    for k, M in enumerate(matrices):
        D, D_z, G, delta = (stack[k] for stack in stacks)
        scaled, lower = (float(np.ravel(x)[k]) for x in (found.scaled, found.lower))
        if found.proof and (proof := found.proof[k]):
            claims.append(_boxes_claim(M, found.blocks, float(np.ravel(found.upper)[k]), proof))
        elif np.isfinite(scaled) and scaled > 0:
            levels = _kept_levels(found, scaled * ABOVE)
            if found.fixed:  # G is that of M with its inputs divided by the level
                G = np.repeat(_kept_levels(found, scaled), [b.rows for b in found.blocks])[:, None] * G
            numbers = {"M": M, "blocks": rows, "level": levels, "D_w": D, "D_z": D_z, "G": G}
            claims.append(Claim("mu-upper", numbers))
        if lower > 0:
            levels = _kept_levels(found, lower)
            claims.append(Claim("mu-lower", {"M": M, "blocks": rows, "level": levels, "delta": delta}))
    return claims


def _boxes_claim(M: NDArray[Any], blocks: Sequence[Block], upper: float, proof: BoxProof) -> Claim:
    """The bound that branch and bound has lowered: no Delta smaller than one over it makes I - M Delta singular."""
    level = upper * ABOVE
    everywhere = [(box, Piece(0.0, np.inf, 1.0, bound)) for box, bound in proof]
    numbers = {"M": M, "blocks": block_rows(blocks), "level": _levels(blocks, level)}
    return Claim("mu-upper-boxes", {**numbers, **_boxes(blocks, everywhere, 1 / level, float)})


def _kept_levels(found: MuBounds, level: float) -> NDArray[np.float64]:
    """The level of the blocks whose size is sought, one of those that keep theirs."""
    if not found.fixed:
        return np.array(level)
    return np.array([1.0 if b.name in found.fixed else level for b in found.blocks])


def margin_claims(found: Margin) -> list[Claim]:
    """That the set ``lower`` times as large is stable, and that one ``upper`` times as large is not."""
    uncertain = found.system
    if uncertain is None:
        return []
    model, blocks = uncertain.delta_channels, uncertain.blocks
    if not blocks:
        return [Claim("stable", {"A": uncertain.M.A, "dt": np.array(float(uncertain.M.dt))})]
    common: Numbers = {**model_numbers(model), "blocks": block_rows(blocks)}
    claims: list[Claim] = []
    at = _frequencies(uncertain)
    if 0 < found.lower < np.inf:
        level = ABOVE / found.lower
        if found.boxes or not _symmetric(blocks):
            levels = _levels(blocks, level)
            proved = _large_enough(blocks, found.boxes, levels) or _whole_box(blocks, found.lower, found.proof)
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
    """That no member has a larger gain than ``upper``."""
    uncertain = found.system
    if uncertain is None or not np.isfinite(found.upper) or not found.proof:
        return []
    performance = FullBlock(PERFORMANCE, len(uncertain.inputs), len(uncertain.outputs))
    blocks, at = (*uncertain.blocks, performance), _frequencies(uncertain)
    gamma = np.array(found.upper * ABOVE)
    numbers: Numbers = {**model_numbers(uncertain.M), "blocks": block_rows(blocks), "gamma": gamma}
    if found.boxes or not _symmetric(blocks):
        levels = np.append(np.ones(len(blocks) - 1), gamma)
        proved = _large_enough(blocks, found.boxes, levels) or _whole_box(blocks, 1.0, found.proof)
        claim = Claim("worst-gain-boxes", {**numbers, **_boxes(blocks, proved, 1.0, at)})
    else:
        claim = Claim("worst-gain", {**numbers, **_scalings(found.proof, at)})
    return [claim, *weight_claims(blocks)]


def robust_gain_claims(found: RobustGain) -> list[Claim]:
    """That no member of the set ``lower`` times as large has a gain above ``level``, by the main loop theorem."""
    uncertain = found.system
    if uncertain is None or not 0 < found.lower < np.inf or not found.proof:
        return []
    performance = FullBlock(PERFORMANCE, len(uncertain.inputs), len(uncertain.outputs))
    blocks = (*uncertain.blocks, performance)
    level = np.append(_levels(uncertain.blocks, ABOVE / found.lower), found.level * ABOVE)
    around = [(_around(blocks, piece.beta, found.level), piece) for piece in found.proof if isinstance(piece, Piece)]
    proved = around or _large_enough(blocks, found.boxes, level)
    unit = np.append(np.ones(len(uncertain.blocks)), output_unit(found.level) ** -2.0)
    proved = [(box, _in_units(blocks, piece, unit)) for box, piece in proved]
    numbers = {**model_numbers(uncertain.M), "blocks": block_rows(blocks), "level": level}
    return [Claim("mu-boxes", {**numbers, **_boxes(blocks, proved, found.lower / ABOVE, _frequencies(uncertain))})]


def _around(blocks: Sequence[Block], beta: float, level: float) -> Box:
    """The box about the nominal point in which scalings of the level ``beta`` of the set's blocks hold."""
    wider = np.maximum(1.0, -lowest(blocks)) / beta
    return Box(np.zeros(len(blocks)), np.append(wider[:-1], 1 / level))


def _in_units(blocks: Sequence[Block], piece: Piece, factors: NDArray[np.float64]) -> Piece:
    """The piece with the D of each block times its factor."""
    w, z = (np.repeat(factors, [getattr(b, side) for b in blocks])[:, None] for side in ("rows", "cols"))
    bound = replace(piece.bound, Dw=w * piece.bound.Dw, Dz=z * piece.bound.Dz)
    return replace(piece, bound=bound)


def joined_scalings(
    model: StateSpaceModel, blocks: Sequence[Block], pieces: Sequence[Any], at: Callable[[float], float]
) -> Numbers | None:
    """Pieces of a proof as intervals in rad/s with scalings of all blocks; None where they cannot be joined.

    ``at``: what a frequency of the pieces is in rad/s.
    """
    whole = _of_the_whole(model, blocks, pieces)
    return None if whole is None else _scalings(whole, at)


def _symmetric(blocks: Sequence[Block]) -> bool:
    return bool((lowest(blocks) == -1).all())


def _levels(blocks: Sequence[Block], level: float) -> NDArray[np.float64]:
    """One of real blocks, whose ranges are told in the user's unit, and the level of the others."""
    return np.array([1.0 if b.interval else level for b in blocks])


def _large_enough(
    blocks: Sequence[Block], proved: Sequence[tuple[Box, Piece]], levels: NDArray[np.float64]
) -> list[tuple[Box, Piece]]:
    """The boxes in which complex blocks were as large as these levels allow: a search passes smaller ones, too."""
    ball = np.array([b.interval is None for b in blocks], dtype=bool)
    return [(box, piece) for box, piece in proved if (box.half[ball] * levels[ball] >= 1 - SAME).all()]


def _whole_box(blocks: Sequence[Block], size: float, proof: Sequence[Any]) -> list[tuple[Box, Piece]]:
    """Pieces of a set of this size in one box."""
    box = root_box(blocks, size)
    return [(box, piece) for piece in proof]


def _boxes(
    blocks: Sequence[Block], proved: Sequence[tuple[Box, Piece]], size: float, at: Callable[[float], float]
) -> Numbers:
    """Boxes of parameters with the intervals and scalings that were proved in them, for a set of this size."""
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
    """Faces that differ by rounding brought to one number, those at the ends of the set a little beyond them."""
    width = whole[1] - whole[0]
    values, place = np.unique(sides, return_inverse=True)
    groups = np.concatenate([[0], np.cumsum(np.diff(values) > SAME * width)])
    first = values[np.searchsorted(groups, np.arange(groups[-1] + 1))]
    found = first[groups][place.reshape(sides.shape)]
    found[np.abs(found - whole[0]) < SAME * width] = whole[0] - SAME * width
    found[np.abs(found - whole[1]) < SAME * width] = whole[1] + SAME * width
    return found


def _frequencies(uncertain: Any) -> Callable[[float], float]:
    return lambda omega: model_frequency(uncertain, omega)


def _ranges(blocks: Sequence[Block]) -> NDArray[np.float64]:
    """The ends of each real block's range in Delta, for a set of size one; -1, 1 of other blocks."""
    return np.array([b.interval or (-1.0, 1.0) for b in blocks], dtype=float)


def _attained(blocks: Sequence[Block], delta: NDArray[Any]) -> NDArray[np.float64]:
    """One over the norm of each block; huge where it is zero."""
    norms = [float(np.linalg.norm(delta[w, z], 2)) for w, z in block_slices(blocks)]
    return np.array([1 / n if n > 0 else 1e300 for n in norms])


def _scalings(pieces: Sequence[Any], at: Callable[[float], float]) -> Numbers:
    """The intervals in rad/s of the model, sorted, with their scalings."""
    ordered = sorted(pieces, key=lambda p: p.low)
    stacks = {name: np.stack([getattr(p.bound, key) for p in ordered]).astype(complex)
              for name, key in (("D_w", "Dw"), ("D_z", "Dz"), ("G", "G"))}  # fmt: skip
    ends = {"low": np.array([at(p.low) for p in ordered]), "high": np.array([at(p.high) for p in ordered])}
    return {**ends, **stacks}


class _Bound:
    """Scalings put together from those of parts."""

    def __init__(self, Dw: NDArray[Any], Dz: NDArray[Any], G: NDArray[Any]) -> None:
        self.Dw, self.Dz, self.G = Dw, Dz, G


class _Joined:
    """An interval with scalings of all blocks."""

    def __init__(self, low: float, high: float, bound: _Bound) -> None:
        self.low, self.high, self.bound = low, high, bound


def _of_the_whole(model: StateSpaceModel, blocks: Sequence[Block], pieces: Sequence[Piece]) -> list[Any] | None:
    r"""Pieces of parts that act on each other in a cycle, as pieces of all blocks.

    Parts of which one acts on the other, and not back, have a triangular M. With D of each part times
    :math:`2^{-64 k}`, k its depth, what it does to those behind it counts for nothing; a block in no cycle has the
    identity.
    """
    whole = tuple(range(len(blocks)))
    if pieces and all(p.members is None or p.members == whole for p in pieces):
        return list(pieces)
    depth = _depths(model, blocks)
    if depth.max(initial=0) * APART > DEEPEST:
        return None
    parts: dict[tuple[int, ...], list[Piece]] = {}
    for p in pieces:
        parts.setdefault(p.members or whole, []).append(p)
    cuts = np.unique([end for p in pieces for end in (p.low, p.high)] + [0.0, np.inf])
    q, p_ = model.n_inputs, model.n_outputs
    result: list[Any] = []
    for low, high in itertools.pairwise(cuts):
        Dw, Dz, G = np.eye(q, dtype=complex), np.eye(p_, dtype=complex), np.zeros((q, p_), dtype=complex)
        for i, (w, z) in enumerate(block_slices(blocks)):
            Dw[w, w] *= 2.0 ** (-APART * depth[i])
            Dz[z, z] *= 2.0 ** (-APART * depth[i])
        for members, own in parts.items():
            piece = next((x for x in own if x.low <= low and x.high >= high), None)
            if piece is None:
                return None
            w, z = entries(blocks, np.array(members))
            scale = 2.0 ** (-APART * depth[members[0]]) / 2.0 ** np.round(np.log2(np.abs(piece.bound.Dw).max()))
            Dw[w[:, None], w], Dz[z[:, None], z] = scale * piece.bound.Dw, scale * piece.bound.Dz
            G[w[:, None], z] = scale * piece.bound.G
        result.append(_Joined(float(low), float(high), _Bound(Dw, Dz, G)))
    return result


def _depths(model: StateSpaceModel, blocks: Sequence[Block]) -> NDArray[np.int64]:
    """How many parts lie before each block: the longest way by which others act on it and it does not on them."""
    n = model.n_states
    into, out = np.zeros((model.n_inputs, len(blocks))), np.zeros((len(blocks), model.n_outputs))
    for i, (w, z) in enumerate(block_slices(blocks)):
        into[w, i], out[i, z] = 1, 1
    B, C, D = (model.B != 0) @ into, out @ (model.C != 0), out @ (model.D != 0) @ into
    acts = np.block([[model.A != 0, B], [C, D]]) > 0
    labels = strong_components(acts)
    count = int(labels.max(initial=-1)) + 1
    edges = np.zeros((count, count), dtype=bool)  # from the second to the first
    for to, source in np.argwhere(acts):
        edges[labels[to], labels[source]] |= labels[to] != labels[source]
    holds = np.zeros(count, dtype=np.int64)
    holds[labels[n:]] = 1
    depth = np.zeros(count, dtype=np.int64)
    for _ in range(count):  # the longest way: at most so many rounds
        deeper = np.where(edges, depth + holds, 0).max(axis=1, initial=0)
        if (deeper <= depth).all():
            break
        depth = np.maximum(depth, deeper)
    return depth[labels[n:]]
