r"""Removing repetitions of a scalar block that its channels cannot reach or that do not show.

Seen from block i alone, everything else (states, other blocks, inputs, outputs) is outside, and M is a constant N:

.. math:: F(\delta) = N_{22} + N_{21} \, \delta \, (I - \delta N_{11})^{-1} N_{12}

the same form as a transfer function in ``1/s`` with ``A = N11, B = N12, C = N21``. Its uncontrollable and unobservable
part in this sense can go without changing F for any delta, real or complex.

References
----------
D'Andrea, Khatri, "Kalman decomposition of linear fractional transformation representations" (1997).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

__all__ = ["reduce_blocks"]


# A reduced block must give the same F(delta) to this share of the entries' natural magnitude, or it is not reduced.
UNCHANGED = 1e-10
# A difference below this share of the summands is their rounding, where F itself is what is left when they cancel.
CANCELLED = 1e-13


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

    Parameters
    ----------
    M
        Model whose first q inputs and p outputs are the channels of the blocks.
    tolerance
        Singular values below ``tolerance`` times the largest count as zero.
    names
        Reduce these blocks only.
    keep
        A block without any effect stays, once and without any channel that reaches it, so that its name stays known.
    """
    if not 0 < tolerance < 1:
        raise InputError("reduce", f"tolerance {tolerance}", "a number between 0 and 1")
    n = M.n_states
    constant = np.block([[M.A, M.B], [M.C, M.D]])
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
    into, out = _power_of_two(np.abs(n12).max(axis=0, initial=0.0)), _power_of_two(np.abs(n21).max(axis=1, initial=0.0))
    a, b, c = n11, n12 / into, n21 / out[:, None]
    # Channels of one block may carry any scaling T: the one that makes what comes in and what goes out alike is used.
    balance = _power_of_two(np.sqrt(np.abs(b).max(axis=1, initial=0.0) / _nonzero(np.abs(c).max(axis=0, initial=0.0))))
    a, b, c = a / balance[:, None] * balance, b / balance[:, None], c * balance
    # What the second step sees may be rounding of the first: it is judged by the size that b and c had before.
    sizes = [float(np.linalg.norm(part, 2)) if part.size else 0.0 for part in (b, c)]
    reach = _invariant_basis(a, b, tolerance, sizes[0])
    a, b, c = reach.T @ a @ reach, reach.T @ b, c @ reach
    show = _invariant_basis(a.T, c.T, tolerance, sizes[1])
    a, b, c = show.T @ a @ show, show.T @ b, c @ show
    size = a.shape[0]
    if keep and size == 0:
        a, b, c, size = np.zeros((1, 1)), np.zeros((1, b.shape[1])), np.zeros((c.shape[0], 1)), 1
    if size == len(rows) or not _same_map((n11, n12 / into, n21 / out[:, None]), (a, b, c)):
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


def _invariant_basis(a: Array, b: Array, tolerance: float, size: float) -> Array:
    """Orthonormal basis of the smallest a-invariant subspace that holds the range of b (staircase by SVD)."""
    basis = np.zeros((a.shape[0], 0))
    fresh = b
    while fresh.size and basis.shape[1] < a.shape[0]:
        fresh = fresh - basis @ (basis.T @ fresh)
        u, s, _ = np.linalg.svd(fresh, full_matrices=False)
        new = u[:, s > tolerance * size]
        if not new.shape[1]:
            break
        # Orthogonalised twice: the small directions of an SVD carry rounding of the large ones.
        new, _ = np.linalg.qr(new - basis @ (basis.T @ new))
        basis = np.hstack([basis, new])
        fresh = a @ new
        size = float(np.linalg.norm(a, 2))
    return basis


def _same_map(first: tuple[Array, Array, Array], second: tuple[Array, Array, Array]) -> bool:
    """Whether both give the same ``c delta (I - delta a)^-1 b`` at random deltas of the unit disc, entry by entry."""
    rng = np.random.default_rng(0)
    radius, phase = np.sqrt(rng.random(6)), 2 * np.pi * rng.random(6)
    for delta in radius * np.exp(1j * phase):
        maps, summands = [], 0.0
        for a, b, c in (first, second):
            loop = np.eye(a.shape[0]) - delta * a
            if loop.size and np.linalg.cond(loop) > 1 / UNCHANGED:
                return False
            inside = np.linalg.solve(loop, delta * b) if loop.size else delta * b
            maps.append(c @ inside)
            summands = max(summands, float((np.abs(c) @ np.abs(inside)).max(initial=0.0)))
        allowed = max(UNCHANGED * float(np.abs(maps[0]).max(initial=0.0)), CANCELLED * summands)
        if np.abs(maps[0] - maps[1]).max(initial=0.0) > allowed:
            return False
    return True


def _nonzero(size: Array) -> Array:
    return np.where(size > 0, size, 1.0)


def _power_of_two(size: Array) -> Array:
    """The power of two next to each size; one where the size is zero."""
    return np.exp2(np.rint(np.log2(_nonzero(size))))
