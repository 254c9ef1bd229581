"""The gain of a matrix closed by Delta, how it changes with Delta, and the ascent to a large one."""

# F = M22 + M21 Delta (I - M11 Delta)^-1 M12, d sigma_max(F) = Re l dDelta r with l = u^* M21 (I - Delta M11)^-1 and r
# = (I - M11 Delta)^-1 M12 v. The channels of the performance are the last block of M.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import ComplexArray
from robustlab.mu_analysis.matrix.box import Box, centre_matrix
from robustlab.uncertainty.blocks import Block, block_slices

ASCENTS = 40  # steps of an ascent
RISE = 1e-7  # an ascent ends where a step gains less than this share


@dataclass(frozen=True)
class Gain:
    """``sigma_max`` with its u and v, the Delta (q, p) of the other blocks, and the directions l (q,), r (p,)."""

    value: float
    delta: ComplexArray
    left: ComplexArray
    right: ComplexArray
    u: ComplexArray
    v: ComplexArray

    def closing_block(self) -> ComplexArray:
        """The performance block of size ``1 / value`` that makes the whole loop singular."""
        return np.outer(self.v, np.conj(self.u)) / self.value


def gain_at(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> Gain | None:
    """The gain with the given Delta of all blocks but the last; None where the loop is singular."""
    w, z = block_slices(blocks)[-1]
    q, p = w.start, z.start
    try:
        inside = np.linalg.solve(np.eye(p) - M[:p, :q] @ delta, M[:p, q:])
        outside = np.linalg.solve((np.eye(q) - delta @ M[:p, :q]).T, M[p:, :q].T).T
        closed = M[p:, q:] + outside @ delta @ M[:p, q:]
        if not np.isfinite(closed).all():
            return None
        u, sigma, vh = np.linalg.svd(closed)
    except np.linalg.LinAlgError:
        return None
    return Gain(float(sigma[0]), delta, np.conj(u[:, 0]) @ outside, inside @ np.conj(vh[0]), u[:, 0], np.conj(vh[0]))


def ascend(
    M: ComplexArray, blocks: Sequence[Block], start: ComplexArray, box: Box, steps: int = ASCENTS
) -> Gain | None:
    """A large gain with every block inside the box, from a Delta (q, p): each step aligns all blocks with l and r."""
    best = gain_at(M, blocks, start)
    for _ in range(steps if best is not None else 0):
        assert best is not None
        aim = _aligned(blocks, best, box)
        step, better = 1.0, None
        while step > 1e-3:
            trial = gain_at(M, blocks, best.delta + step * (aim - best.delta))
            if trial is not None and trial.value > best.value:
                better = trial
                break
            step /= 3
        if better is None:
            return best
        rise = better.value / best.value - 1 if best.value > 0 else 1.0
        best = better
        if rise < RISE and step == 1.0:
            break
    return best


def largest_gain(
    M: ComplexArray, blocks: Sequence[Block], box: Box, rng: np.random.Generator, starts: int = 12
) -> Gain | None:
    """The largest gain of ascents from the centre of the box and from random corners."""
    others = blocks[:-1]
    best: Gain | None = None
    for k in range(starts if others else 1):
        delta = centre_matrix(others, box.centre[:-1]).astype(complex)
        if k:
            for block, (w, z), half in zip(others, block_slices(others), box.half[:-1], strict=True):
                if block.interval:
                    delta[w, z] += half * rng.choice([-1.0, 1.0]) * np.eye(block.rows)
                else:
                    delta[w, z] = half * block.extreme(rng, lambda n: rng.standard_normal((n, 2)) @ np.array([1, 1j]))
        found = ascend(M, blocks, delta, box)
        if found is not None and (best is None or found.value > best.value):
            best = found
    return best


def _aligned(blocks: Sequence[Block], gain: Gain, box: Box) -> ComplexArray:
    """The Delta of the box that raises the gain most, to first order."""
    others = blocks[:-1]
    delta = centre_matrix(others, box.centre[:-1]).astype(complex)
    for block, (w, z), half in zip(others, block_slices(others), box.half[:-1], strict=True):
        aligned = block.aligned(gain.left[w], gain.right[z], half)
        delta[w, z] = gain.delta[w, z] if aligned is None else delta[w, z] + aligned
    return delta
