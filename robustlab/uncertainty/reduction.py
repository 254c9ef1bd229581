r"""Kalman reduction of LFTs in n variables: repetitions that cannot be reached or do not show are removed.

All scalar blocks together are seen from outside (states, full blocks, inputs, outputs) as

.. math:: F(\Delta) = D + C \, \Delta \, (I - A \Delta)^{-1} B, \qquad
          \Delta = \mathrm{diag}(\delta_1 I_{r_1}, \dots, \delta_k I_{r_k})

the same form as a transfer function in ``1/s``. The smallest subspaces :math:`V_i` with :math:`B_i \subset V_i` and
:math:`A_{ij} V_j \subset V_i` hold all that can be reached; by duality, what they miss in the transposed system does
not show. Both parts go without changing F, for any Delta, real, complex or dynamic. The reduction of each block alone
(k = 1) misses a channel that only another unreachable channel feeds; it comes first, as it leaves the other blocks as
they are.

References
----------
Beck, Doyle, "A necessary and sufficient minimality condition for uncertain systems", IEEE TAC 44 (1999); D'Andrea,
Khatri, "Kalman decomposition of linear fractional transformation representations" (1997).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array, Indices
from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices, delta_matrix
from robustlab.uncertainty.upper_lft import balancing_scale, closed_response

# A reduced block must give the same F(delta) to this share of the entries' natural magnitude, or it is not reduced.
UNCHANGED = 1e-10
# A difference below this share of the summands is their rounding, where F itself is what is left when they cancel.
CANCELLED = 1e-13
# Deltas and frequencies at which a reduced set is compared, and how well channels and responses must agree.
POINTS = 8
PROVED = 1e-9


class Reduced(NamedTuple):
    """M and blocks after a reduction, or as given where it did not stand the comparison; see `Reduction`."""

    M: StateSpaceModel
    blocks: tuple[Block, ...]
    invariance: float
    difference: float
    points: int
    proved: bool


def reduced(M: StateSpaceModel, blocks: Sequence[Block], tolerance: float, seed: int = 0) -> Reduced:
    """Block by block, then all blocks jointly, until nothing goes; and the evidence."""
    if not 0 < tolerance < 1:
        raise InputError("reduce_model", f"tolerance {tolerance}", "a number between 0 and 1")
    given = M, tuple(blocks)
    invariance = 0.0
    while True:
        M, blocks = reduce_blocks(M, blocks, tolerance)
        step = _joint_step(M, blocks, tolerance)
        if step is None:
            break
        M, blocks = step.M, step.blocks
        invariance = max(invariance, step.invariance)
    if blocks == given[1]:
        return Reduced(*given, 0.0, 0.0, 0, True)
    small = M, tuple(blocks)
    difference = _difference(given, small, seed)
    proved = invariance <= PROVED and difference <= PROVED
    return Reduced(*(small if proved else given), invariance, difference, POINTS, proved)


def _difference(
    first: tuple[StateSpaceModel, Sequence[Block]], second: tuple[StateSpaceModel, Sequence[Block]], seed: int
) -> float:
    """Largest relative difference of the frequency responses at random Deltas and frequencies."""
    rng = np.random.default_rng(seed)
    (M, blocks), (small, left) = first, second
    poles = np.abs(M.poles())
    poles = poles[poles > 0]
    low, high = (float(poles.min()), float(poles.max())) if len(poles) else (1.0, 1.0)
    known = {b.name for b in left}
    worst = 0.0
    for _ in range(POINTS):
        omega = np.exp(rng.uniform(np.log(0.1 * low), np.log(10 * high)))
        if M.dt:
            omega = rng.uniform(0.0, np.pi) / M.dt
        values = {b.name: b.draw(rng, boundary=True) for b in blocks}
        m, d = frequency_response(M, [omega]), delta_matrix(blocks, values)
        a = closed_response(m, d)
        remaining = delta_matrix(left, {name: v for name, v in values.items() if name in known})
        b = closed_response(frequency_response(small, [omega]), remaining)
        size = max(float(np.abs(a).max(initial=0.0)), 1e-3 * _summands(m[0], d)) or 1.0
        worst = max(worst, float(np.abs(a - b).max(initial=0.0)) / size)
    return worst


def _summands(m: AnyArray, d: AnyArray) -> float:
    """Largest entry of ``|M22| + |M21| |Delta| |(I - M11 Delta)^-1| |M12|``: what is added up to the response."""
    q, p = d.shape
    inside = np.abs(d) @ np.abs(np.linalg.inv(np.eye(p) - m[:p, :q] @ d)) @ np.abs(m[:p, q:])
    return float((np.abs(m[p:, q:]) + np.abs(m[p:, :q]) @ inside).max(initial=0.0))


# --- each block alone ------------------------------------------------------------------------------------------------


def reduce_blocks(
    M: StateSpaceModel,
    blocks: Sequence[Block],
    tolerance: float = 1e-12,
    names: Collection[str] | None = None,
    keep: bool = False,
) -> tuple[StateSpaceModel, tuple[Block, ...]]:
    """M and blocks with each scalar block repeated as rarely as its own channels allow.

    Every reduced block is checked against the unreduced one at random deltas of the unit disc; where they differ by
    more than 1e-10, that block stays as it was. A scalar block without any effect vanishes, and its name with it.

    ``M``: model whose first q inputs and p outputs are the channels of the blocks.
    ``tolerance``: singular values below ``tolerance`` times the largest count as zero.
    ``names``: reduce these blocks only.
    ``keep``: a block without any effect stays, once and without any channel that reaches it, so that its name stays
    known.
    """
    if not 0 < tolerance < 1:
        raise InputError("reduce", f"tolerance {tolerance}", "a number between 0 and 1")
    n = M.n_states
    constant = _constant(M)
    kept: list[Block] = list(blocks)
    outputs, inputs = list(M.outputs), list(M.inputs)
    index = 0
    while index < len(kept):
        block = kept[index]
        w, z = block_slices(kept)[index]
        rows, cols = np.arange(n + z.start, n + z.stop), np.arange(n + w.start, n + w.stop)
        wanted = block.is_scalar and (names is None or block.name in names)
        smaller = _reduced(constant, rows, cols, tolerance, keep) if wanted else None
        if smaller is None:
            index += 1
            continue
        constant, size = smaller
        del outputs[z.start + size : z.stop], inputs[w.start + size : w.stop]
        if size:
            kept[index] = block.resized(size, size)
            index += 1
        else:
            del kept[index]
    model = StateSpaceModel(
        constant[:n, :n],
        constant[:n, n:],
        constant[n:, :n],
        constant[n:, n:],
        M.dt,
        inputs,
        outputs,
        M.states,
        where="reduce",
    )
    return model, tuple(kept)


def _reduced(constant: Array, rows: Indices, cols: Indices, tolerance: float, keep: bool) -> tuple[Array, int] | None:
    """The constant matrix with a smaller block at these rows and columns, and its new size; None where it stays."""
    n11 = constant[rows[:, None], cols]
    n12 = np.delete(constant[rows], cols, axis=1)
    n21 = np.delete(constant[:, cols], rows, axis=0)
    # Units of the outside must not decide what counts as zero: its signals are scaled to norm one.
    into, out = _powers(np.abs(n12).max(axis=0, initial=0.0)), _powers(np.abs(n21).max(axis=1, initial=0.0))
    a, b, c = n11, n12 / into, n21 / out[:, None]
    # Channels of one block may carry any scaling T: the one that makes what comes in and what goes out alike is used.
    balance = _powers(np.sqrt(np.abs(b).max(axis=1, initial=0.0) / _nonzero(np.abs(c).max(axis=0, initial=0.0))))
    a, b, c = a / balance[:, None] * balance, b / balance[:, None], c * balance
    # What the second step sees may be rounding of the first: it is judged by the size that b and c had before.
    b_size, c_size = _norm(b), _norm(c)
    (reach,), _ = _invariant(a, b, [len(a)], tolerance, b_size)
    a, b, c = reach.T @ a @ reach, reach.T @ b, c @ reach
    (show,), _ = _invariant(a.T, c.T, [len(a)], tolerance, c_size)
    a, b, c = show.T @ a @ show, show.T @ b, c @ show
    size = a.shape[0]
    if keep and size == 0:
        a, b, c, size = np.zeros((1, 1)), np.zeros((1, b.shape[1])), np.zeros((c.shape[0], 1)), 1
    if size == len(rows) or not _same((n11, n12 / into, n21 / out[:, None]), [len(rows)], (a, b, c), [size]):
        return None
    keep_rows, keep_cols = (
        np.delete(np.arange(constant.shape[0]), rows[size:]),
        np.delete(np.arange(constant.shape[1]), cols[size:]),
    )
    result = constant[keep_rows[:, None], keep_cols]
    inside_rows, inside_cols = rows[:size], cols[:size]
    outside_rows = np.delete(np.arange(result.shape[0]), inside_rows)
    outside_cols = np.delete(np.arange(result.shape[1]), inside_cols)
    result[inside_rows[:, None], inside_cols] = a
    result[inside_rows[:, None], outside_cols] = b * into
    result[outside_rows[:, None], inside_cols] = c * out[:, None]
    return result, size


# --- all blocks jointly ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Step:
    M: StateSpaceModel
    blocks: tuple[Block, ...]
    invariance: float


def _joint_step(M: StateSpaceModel, blocks: Sequence[Block], tolerance: float) -> _Step | None:
    """One joint reduction of all scalar blocks; None where nothing goes."""
    n = M.n_states
    whole = _constant(M)
    scalar = [b for b in blocks if b.is_scalar]
    if not scalar:
        return None
    slices = [s for b, s in zip(blocks, block_slices(blocks), strict=True) if b.is_scalar]
    cols = np.concatenate([np.arange(n + w.start, n + w.stop) for w, _ in slices])
    rows = np.concatenate([np.arange(n + z.start, n + z.stop) for _, z in slices])
    other_cols, other_rows = np.delete(np.arange(whole.shape[1]), cols), np.delete(np.arange(whole.shape[0]), rows)
    a, b, c = whole[rows[:, None], cols], whole[rows[:, None], other_cols], whole[other_rows[:, None], cols]
    into, out = _powers(np.abs(b).max(axis=0, initial=0.0)), _powers(np.abs(c).max(axis=1, initial=0.0))
    b, c = b / into, c / out[:, None]
    scale = _channel_scale(a, b, c)
    a, b, c = a / scale[:, None] * scale, b / scale[:, None], c * scale
    sizes = [s.rows for s in scalar]
    # What the second step sees may be rounding of the first: it is judged by the size that b and c had before.
    b_size, c_size = _norm(b), _norm(c)
    reach, miss_1 = _invariant(a, b, sizes, tolerance, b_size)
    v = _diagonal(reach)
    a1, b1, c1 = v.T @ a @ v, v.T @ b, c @ v
    show, miss_2 = _invariant(a1.T, c1.T, [part.shape[1] for part in reach], tolerance, c_size)
    t = _diagonal(show)
    a2, b2, c2 = t.T @ a1 @ t, t.T @ b1, c1 @ t
    left = [part.shape[1] for part in show]
    if left == sizes or not _same((a, b, c), sizes, (a2, b2, c2), left):
        return None
    return _Step(*_rebuilt(M, blocks, left, a2, b2 * into, c2 * out[:, None]), max(miss_1, miss_2))


def _rebuilt(
    M: StateSpaceModel, blocks: Sequence[Block], left: Sequence[int], a: Array, b: Array, c: Array
) -> tuple[StateSpaceModel, tuple[Block, ...]]:
    """The model with its scalar blocks' channels replaced, ``left`` of each, the full blocks' where they were."""
    n = M.n_states
    whole = _constant(M)
    sizes = iter(left)
    kept: list[Block] = []
    keep_in, keep_out = list(range(n)), list(range(n))
    new_in: list[int] = []
    new_out: list[int] = []
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if not block.is_scalar:
            kept.append(block)
            keep_in += range(n + w.start, n + w.stop)
            keep_out += range(n + z.start, n + z.stop)
            continue
        size = next(sizes)
        if size:
            kept.append(block.resized(size, size))
        new_in += range(len(keep_in), len(keep_in) + size)
        new_out += range(len(keep_out), len(keep_out) + size)
        keep_in += range(n + w.start, n + w.start + size)
        keep_out += range(n + z.start, n + z.start + size)
    q, p = sum(x.rows for x in blocks), sum(x.cols for x in blocks)
    keep_in += range(n + q, whole.shape[1])
    keep_out += range(n + p, whole.shape[0])
    result = whole[keep_out][:, keep_in]
    rest_in, rest_out = np.delete(np.arange(len(keep_in)), new_in), np.delete(np.arange(len(keep_out)), new_out)
    channels_in, channels_out = np.array(new_in, dtype=int), np.array(new_out, dtype=int)
    result[channels_out[:, None], channels_in] = a
    result[channels_out[:, None], rest_in] = b
    result[rest_out[:, None], channels_in] = c
    model = StateSpaceModel(
        result[:n, :n], result[:n, n:], result[n:, :n], result[n:, n:], M.dt,
        [M.inputs[k - n] for k in keep_in[n:]], [M.outputs[k - n] for k in keep_out[n:]], M.states, where="reduction",
    )  # fmt: skip
    return model, tuple(kept)


def _invariant(a: Array, b: Array, sizes: Sequence[int], tolerance: float, b_size: float) -> tuple[list[Array], float]:
    """Orthonormal bases V_i of the smallest subspaces with ``B_i in V_i``, ``A_ij V_j in V_i``, and what they miss."""
    ends = np.cumsum([0, *sizes])
    parts = [slice(int(first), int(last)) for first, last in itertools.pairwise(ends)]
    bases: list[Array] = [np.zeros((size, 0)) for size in sizes]
    fresh, size = b, b_size
    while True:
        found = []
        for i, part in enumerate(parts):
            new = _fresh_directions(fresh[part], bases[i], tolerance * size)
            found.append(new)
            bases[i] = np.hstack([bases[i], new])
        if not any(new.shape[1] for new in found):
            break
        fresh, size = a @ _diagonal(found), _norm(a)
    whole = _diagonal(bases)
    norm = max(b_size, _norm(a)) or 1.0
    missed = max(_norm(inside - whole @ (whole.T @ inside)) / norm for inside in (b, a @ whole))
    return bases, missed


def _fresh_directions(fresh: Array, basis: Array, limit: float) -> Array:
    """Orthonormal basis of what ``fresh`` adds to ``basis``, singular values above the limit."""
    rest = fresh - basis @ (basis.T @ fresh)
    if not rest.size or basis.shape[1] == len(basis):
        return np.zeros((len(basis), 0))
    u, s, _ = np.linalg.svd(rest, full_matrices=False)
    new = u[:, s > limit]
    # Orthogonalised twice: the small directions of an SVD carry rounding of the large ones.
    return np.linalg.qr(new - basis @ (basis.T @ new))[0] if new.shape[1] else new


def _norm(matrix: Array) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def _diagonal(parts: Sequence[Array]) -> Array:
    """Block-diagonal matrix; empty blocks count with their rows or columns."""
    result = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    row = col = 0
    for p in parts:
        result[row : row + p.shape[0], col : col + p.shape[1]] = p
        row, col = row + p.shape[0], col + p.shape[1]
    return result


def _channel_scale(a: Array, b: Array, c: Array) -> Array:
    """Powers of two for the channels: what comes in and what goes out alike, the outside as one more channel."""
    k = len(a)
    square = np.zeros((k + 1, k + 1))
    square[:k, :k] = np.abs(a)
    square[:k, k], square[k, :k] = np.abs(b).sum(axis=1), np.abs(c).sum(axis=0)
    scale = balancing_scale(square)
    return scale[:k] / scale[k]


def _same(
    first: tuple[Array, Array, Array],
    first_sizes: Sequence[int],
    second: tuple[Array, Array, Array],
    sizes: Sequence[int],
) -> bool:
    """Whether both give the same ``C Delta (I - A Delta)^-1 B`` at random complex deltas, to 1e-10 of the largest."""
    rng = np.random.default_rng(0)
    for _ in range(6):
        deltas = np.sqrt(rng.random(len(sizes))) * np.exp(2j * np.pi * rng.random(len(sizes)))
        maps, summands = [], 0.0
        for (a, b, c), repeats in ((first, first_sizes), (second, sizes)):
            d = np.repeat(deltas, repeats)
            loop = np.eye(len(a)) - a * d
            if loop.size and np.linalg.cond(loop) > 1 / UNCHANGED:
                return False
            inside = d[:, None] * np.linalg.solve(loop, b) if loop.size else np.zeros((0, b.shape[1]))
            maps.append(c @ inside)
            summands = max(summands, float((np.abs(c) @ np.abs(inside)).max(initial=0.0)))
        allowed = max(UNCHANGED * float(np.abs(maps[0]).max(initial=0.0)), CANCELLED * summands)
        if np.abs(maps[0] - maps[1]).max(initial=0.0) > allowed:
            return False
    return True


def _constant(M: StateSpaceModel) -> Array:
    return np.asarray(np.block([[M.A, M.B], [M.C, M.D]]), dtype=np.float64)


def _nonzero(size: Array) -> Array:
    return np.where(size > 0, size, 1.0)


def _powers(size: Array) -> Array:
    """The power of two next to each size; one where the size is zero."""
    return np.exp2(np.rint(np.log2(_nonzero(size))))
