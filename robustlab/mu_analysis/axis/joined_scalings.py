"""Conversion of the pieces of a proof over the axis to a claim: intervals in rad/s with scalings of all blocks."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robustlab.linear_analysis.structural import strong_components
from robustlab.mu_analysis.axis.axis_model import acting, continuous
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.matrix.decomposition import depths, entries
from robustlab.mu_analysis.matrix.upper import UpperBound
from robustlab.norms.numbers import Numbers, block_rows, loop_numbers
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.verification.claim import Claim

APART = 64  # binary digits between the scalings of parts of which one acts on the other, and not back
DEEPEST = 900  # total binary digits: the range of doubles


def loop_axis_claims(
    plant: StateSpaceModel, K: StateSpaceModel, blocks: Sequence[Block], level: float, pieces: Sequence[Any]
) -> list[Claim]:
    """Return the claim that mu of the loop of P and K is at most ``level``; none where pieces cannot be joined."""
    dt = plant.dt

    def at(omega: float) -> float:
        return float(2 * np.arctan(omega) / dt) if dt else float(omega)

    scalings = joined_scalings(continuous(lower_lft(plant, K)), blocks, pieces, at)
    if scalings is None:
        return []
    numbers = {**loop_numbers(plant, K), "blocks": block_rows(blocks), "level": np.array(level)}
    return [Claim("mu-axis", {**numbers, **scalings})]


def joined_scalings(
    model: StateSpaceModel, blocks: Sequence[Block], pieces: Sequence[Any], at: Callable[[float], float]
) -> Numbers | None:
    """Return the pieces as intervals in rad/s with scalings of all blocks; None where they cannot be joined."""
    whole = _pieces_of_all_blocks(model, blocks, pieces)
    return None if whole is None else interval_scalings(whole, at)


def interval_scalings(pieces: Sequence[Any], at: Callable[[float], float]) -> Numbers:
    """Return the intervals in rad/s of the model, sorted, with their scalings."""
    ordered = sorted(pieces, key=lambda p: p.low)
    stacks = {name: np.stack([getattr(p.bound, key) for p in ordered]).astype(complex)
              for name, key in (("D_w", "Dw"), ("D_z", "Dz"), ("G", "G"))}  # fmt: skip
    ends = {"low": np.array([at(p.low) for p in ordered]), "high": np.array([at(p.high) for p in ordered])}
    return {**ends, **stacks}


def _pieces_of_all_blocks(model: StateSpaceModel, blocks: Sequence[Block], pieces: Sequence[Piece]) -> list[Any] | None:
    """Join pieces of strongly connected parts to pieces of all blocks."""
    # M is block triangular in these parts. With D of each part times 2^(-64 k), k its depth, the coupling between parts
    # is negligible; a block in no cycle has the identity.
    whole = tuple(range(len(blocks)))
    if pieces and all(p.members is None or p.members == whole for p in pieces):
        return list(pieces)
    acts = acting(model, blocks)
    counted = np.arange(len(acts)) >= model.n_states
    depth = depths(acts, strong_components(acts), counted)[model.n_states :]
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
        result.append(Piece(float(low), float(high), np.inf, UpperBound(np.inf, Dw, Dz, G)))
    return result
