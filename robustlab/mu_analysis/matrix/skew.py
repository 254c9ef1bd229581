"""Skewed mu: smallest size of some blocks while the others keep size one.

Fan, Tits (1992); Ferreres, "A Practical Approach to Robustness Analysis with Aeronautical Applications" (1999).
"""

# nu is an upper bound where the D-G inequality of M S^-1, S = diag(1, nu) on the inputs, holds at level one. For
# given D, G the smallest such level is known in closed form (a Schur complement): minimising the D-G level of M S^-1
# and lowering nu to it in turn converges from above.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray, Mask
from robustlab.errors import InputError, did_you_mean
from robustlab.mu_analysis.matrix.branch_and_bound import Box, centre_matrix, root_box
from robustlab.mu_analysis.matrix.certificate import proves
from robustlab.mu_analysis.matrix.lower import lower_bound
from robustlab.mu_analysis.matrix.structure import entries, hermitian, relative, supply
from robustlab.mu_analysis.matrix.upper import UpperBound, upper_bounds
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

SKEW_ROUNDS = 14  # iterations of the level of skewed mu
INFLATIONS = (0.0, *(10.0**-k for k in range(13, 2, -1)))  # of a level until its D, G prove it
LARGEST_LEVEL = 1e8  # above it, for M of norm one, the fixed blocks alone count as nearly singular


def varying_inputs(blocks: Sequence[Block], fixed: Sequence[str | int]) -> Mask:
    """Return True for the inputs of M (entries of w) of varying blocks, shape (q,)."""
    names = [b.name for b in blocks]
    kept: set[str] = set()
    for given in fixed:
        is_index = isinstance(given, (int, np.integer)) and not isinstance(given, bool)
        if is_index and -len(names) <= int(given) < len(names):
            kept.add(names[int(given)])
        elif isinstance(given, str) and given in names:
            kept.add(given)
        else:
            hint = did_you_mean(given, tuple(names)) if isinstance(given, str) else None
            raise InputError("mu: fixed", f"no block {given!r}", f"some of {', '.join(names)}", hint)
    varying = [b.name not in kept for b in blocks]
    if not any(varying):
        raise InputError("mu: fixed", "all blocks are fixed", "at least one whose size is sought")
    return np.repeat(np.array(varying, dtype=bool), [b.rows for b in blocks])


def skew_upper(M: ComplexArray, blocks: Sequence[Block], varying: Mask, tol: float = 1e-4) -> tuple[float, UpperBound]:
    """Return the smallest level found that D, G prove, and these D, G for ``M / S(level)``; inf: none."""
    q, p = structure_size(blocks)
    size = float(np.linalg.norm(M, 2))
    plain = UpperBound(np.inf, np.eye(q) + 0j, np.eye(p) + 0j, np.zeros((q, p), dtype=complex))
    if not M[:, varying].any():
        # Only the fixed blocks can make the loop singular.
        bound = upper_bounds(M[None], blocks)[0]
        return (0.0, bound) if bound.beta < 1 else (np.inf, plain)
    level, best, proof = max(size, 1e-300), np.inf, plain
    for _ in range(SKEW_ROUNDS):
        scaled = divided(M, varying, level)
        bound = upper_bounds(scaled[None], blocks, tol)[0]
        ratio = _level_of(scaled, bound, varying)
        if not np.isfinite(ratio):
            if np.isfinite(best) or level > LARGEST_LEVEL * size:
                break
            level *= 8
            continue
        for inflation in INFLATIONS:  # until D, G prove the level with their rounding errors
            reached = level * ratio * (1 + inflation)
            G = np.where(varying[:, None], bound.G * (level / reached), bound.G)
            # M / level has one more rounding per entry, far within the allowance of `proves`.
            if proves(divided(M, varying, reached), bound.Dw, bound.Dz, G, 1.0):
                break
        else:
            break
        if reached >= best * (1 - tol):
            break
        level = best = reached
        proof = UpperBound(1.0, bound.Dw, bound.Dz, G)
    return best, proof


def gain_curves(
    M: ComplexArray, blocks: Sequence[Block], rng: np.random.Generator, starts: int, tol: float
) -> tuple[Array, Array, list[Gain | None]]:
    """Return for each matrix the largest gain found, the proved level of its last block, and the gain's Delta."""
    last, box = np.arange(M.shape[2]) >= M.shape[2] - blocks[-1].rows, root_box(blocks)
    found = [largest_gain(m, blocks, box, rng, starts) for m in M]
    upper = np.array([skew_upper(m, blocks, last, tol)[0] for m in M])
    return np.array([0.0 if g is None else g.value for g in found]), upper, found


def skew_lower(
    M: ComplexArray, blocks: Sequence[Block], varying: Mask, seed: int = 0, rounds: int = 10
) -> tuple[float, ComplexArray | None]:
    """Return ``(1 / size of the varying blocks, Delta)`` of the smallest Delta found with fixed blocks within one."""
    level = size = float(np.linalg.norm(M, 2))
    slices = block_slices(blocks)
    moving = [i for i, (w, _) in enumerate(slices) if varying[w.start]]
    if len(moving) == 1 and blocks[moving[0]].is_ball:
        return _largest_gain(M, blocks, moving[0], seed)
    best: tuple[float, ComplexArray | None] = (0.0, None)
    failed = np.inf
    for _ in range(rounds):
        if level <= 1e-9 * size:
            break
        value, delta = lower_bound(divided(M, varying, level), blocks, seed, restarts=8, steps=30)
        if delta is not None and value >= 1 - 1e-12:
            scaled = np.where(varying[:, None], delta / level, delta)
            reached = 1 / max(blocks[i].norm(scaled[slices[i]]) for i in moving)
            if reached <= best[0] * (1 + 1e-9):
                break
            best = reached, scaled
            level = max(reached, level) * 1.0001
        else:
            failed = level
            level *= value or 0.25
        if best[0] and np.isfinite(failed):
            level = np.sqrt(best[0] * failed)
    return best


def _largest_gain(
    M: ComplexArray, blocks: Sequence[Block], moving: int, seed: int
) -> tuple[float, ComplexArray | None]:
    """Solve for one varying full block: its level is the largest gain of the channels that it closes."""
    order = [*(i for i in range(len(blocks)) if i != moving), moving]
    (w, z), ordered = entries(blocks, order), [blocks[i] for i in order]
    gain = largest_gain(M[z[:, None], w], ordered, root_box(ordered), np.random.default_rng(seed))
    if gain is None or gain.value == 0:
        return 0.0, None
    last_w, last_z = block_slices(ordered)[-1]
    whole, back = np.zeros((2, *structure_size(blocks)), dtype=complex)
    whole[: last_w.start, : last_z.start] = gain.delta
    whole[last_w, last_z] = np.outer(gain.v, np.conj(gain.u)) / gain.value  # makes the loop singular
    back[w[:, None], z] = whole
    return 1 / float(np.linalg.norm(whole[last_w, last_z], 2)), back


def divided(M: AnyArray, varying: Mask, level: float) -> AnyArray:
    """Divide the columns of the varying inputs of M, or of a stack, by the level."""
    return np.where(varying, M / level, M)


def _level_of(M: ComplexArray, bound: UpperBound, varying: Mask) -> float:
    """Return the factor on the level at which D, G hold with equality; inf where the fixed part never does."""
    needed, fixed = supply(M, bound.Dz, bound.G), ~varying
    try:
        rest = needed[varying][:, varying]
        if fixed.any():
            inner = bound.Dw[fixed][:, fixed] - needed[fixed][:, fixed]
            factor = np.linalg.cholesky((inner + hermitian(inner)) / 2)
            half = np.linalg.solve(factor, needed[fixed][:, varying])
            rest = rest + hermitian(half) @ half
        value = float(np.linalg.eigvalsh(relative(bound.Dw[varying][:, varying], rest))[-1])
    except np.linalg.LinAlgError:
        return float("inf")
    return float(np.sqrt(max(value, 1e-30))) if np.isfinite(value) else float("inf")


# --- gain of a matrix closed by Delta, its derivative, and ascent ----------------------------------------------------
#
# F = M22 + M21 Delta (I - M11 Delta)^-1 M12, d sigma_max(F) = Re l dDelta r with l = u^* M21 (I - Delta M11)^-1 and r
# = (I - M11 Delta)^-1 M12 v. The performance channels are the last block of M.

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


def gain_at(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> Gain | None:
    """Return the gain with the given Delta of all blocks but the last; None where the loop is singular."""
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
    """Ascend to a large gain inside the box from a Delta (q, p): each step aligns all blocks with l and r."""
    best = gain_at(M, blocks, start)
    for _ in range(steps):
        if best is None:
            break
        aim = centre_matrix(blocks[:-1], box.centre[:-1]).astype(complex)  # raises the gain most, to first order
        for block, (w, z), half in zip(blocks[:-1], block_slices(blocks[:-1]), box.half[:-1], strict=True):
            aligned = block.aligned(best.left[w], best.right[z], half)
            aim[w, z] = best.delta[w, z] if aligned is None else aim[w, z] + aligned
        before = best
        for step in 3.0 ** -np.arange(7):
            trial = gain_at(M, blocks, before.delta + step * (aim - before.delta))
            if trial is not None and trial.value > before.value:
                best = trial
                break
        if best.value <= before.value * (1 + RISE):
            break
    return best


def largest_gain(
    M: ComplexArray, blocks: Sequence[Block], box: Box, rng: np.random.Generator, starts: int = 12
) -> Gain | None:
    """Return the largest gain of ascents from the centre of the box and from random corners."""
    others, found = blocks[:-1], []
    for k in range(starts if others else 1):
        delta = centre_matrix(others, box.centre[:-1]).astype(complex)
        for block, (w, z), half in zip(others, block_slices(others), box.half[:-1], strict=True):
            if k and block.interval:
                delta[w, z] += half * rng.choice([-1.0, 1.0]) * np.eye(block.rows)
            elif k:
                delta[w, z] = half * block.extreme(rng, lambda n: rng.standard_normal((n, 2)) @ np.array([1, 1j]))
        found.append(ascend(M, blocks, delta, box))
    return max((g for g in found if g is not None), key=lambda g: g.value, default=None)
