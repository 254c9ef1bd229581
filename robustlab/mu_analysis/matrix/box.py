"""Boxes of perturbations: each real delta in an interval, each complex block in a ball, as one normalised model."""

# With centre c and half width h of each block Delta = C + H Delta', |Delta'| <= 1, and M' = (I - M C)^-1 M H is the
# model for Delta'. Asymmetric ranges and branch and bound are boxes whose centre is not the nominal point.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices


@dataclass(frozen=True)
class Box:
    """Centre and half width of each block, shape (n_blocks,); the centre of a complex block is zero."""

    centre: Array
    half: Array

    def halves(self, index: int) -> tuple[Box, Box]:
        """Cut the interval of one real block in its middle; return both boxes."""
        half = self.half.copy()
        half[index] /= 2
        low, high = self.centre.copy(), self.centre.copy()
        low[index] -= half[index]
        high[index] += half[index]
        return Box(low, half), Box(high, half)

    def within(self, other: Box) -> Box | None:
        """Return the intersection of both boxes; None where it has no volume."""
        low = np.maximum(self.centre - self.half, other.centre - other.half)
        high = np.minimum(self.centre + self.half, other.centre + other.half)
        return Box((low + high) / 2, (high - low) / 2) if (high > low).all() else None


def lowest(blocks: Sequence[Block]) -> Array:
    """Return the normalised lower end of each block's range: -1, or ``-below / radius`` where asymmetric."""
    return np.array([b.interval[0] if b.interval else -1.0 for b in blocks])


def root_box(blocks: Sequence[Block], size: float = 1.0) -> Box:
    """Return the whole set, scaled by ``size`` about the nominal point."""
    low, real = lowest(blocks), np.array([b.interval is not None for b in blocks], dtype=bool)
    return Box(np.where(real, size * (1 + low) / 2, 0.0), np.where(real, size * (1 - low) / 2, size))


def gauge(blocks: Sequence[Block], values: Array) -> float:
    """Return the smallest size of the set that holds these entries of Delta (moduli for complex blocks)."""
    low = lowest(blocks)
    return float(np.max(np.where(values >= 0, values, values / low), initial=0.0))


def block_entries(blocks: Sequence[Block], delta: ComplexArray) -> Array:
    """Return the value of each real block in Delta (q, p), and the size of a complex one, shape (n_blocks,)."""
    entries = []
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        part = delta[w, z]
        entries.append(float(part[0, 0].real) if block.interval else float(np.linalg.norm(part, 2)))
    return np.array(entries)


def centre_matrix(blocks: Sequence[Block], centre: Array) -> Array:
    """Return the Delta (q, p) of a box's centre."""
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    matrix = np.zeros((q, p))
    for value, block, (w, z) in zip(centre, blocks, block_slices(blocks), strict=True):
        if block.interval:
            matrix[w, z] = value * np.eye(block.rows)
    return matrix


def box_model(model: StateSpaceModel, blocks: Sequence[Block], box: Box) -> StateSpaceModel | None:
    """Return the Delta channels for a box's normalised Delta; None where the loop is ill-posed at the centre."""
    middle = centre_matrix(blocks, box.centre)
    half = np.repeat(box.half, [b.rows for b in blocks])
    if not box.centre.any():
        return StateSpaceModel(model.A, model.B * half, model.C, model.D * half)
    p = model.n_outputs
    try:
        solved = np.linalg.solve(np.eye(p) - model.D @ middle, np.hstack([model.C, model.D]))
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(solved).all():
        return None
    to_z, direct = solved[:, : model.n_states], solved[:, model.n_states :]
    # w = C z + H w' with z = to_z x + direct H w'
    into = model.B + model.B @ middle @ direct
    return StateSpaceModel(model.A + model.B @ middle @ to_z, into * half, to_z, direct * half)


def box_matrices(M: ComplexArray, blocks: Sequence[Block], boxes: Sequence[Box]) -> ComplexArray:
    """Return ``(I - M C)^-1 M H`` of M (p, q) for each box, shape (k, p, q); NaN where ill-posed at the centre."""
    p = M.shape[0]
    middle = np.stack([centre_matrix(blocks, box.centre) for box in boxes])
    half = np.stack([np.repeat(box.half, [b.rows for b in blocks]) for box in boxes])
    loop = np.eye(p) - M @ middle
    result = np.full((len(boxes), *M.shape), np.nan, dtype=complex)
    for k, matrix in enumerate(loop):
        try:
            result[k] = np.linalg.solve(matrix, M) * half[k]
        except np.linalg.LinAlgError:
            continue
    return result
