"""Block-diagonal Delta: the order of its blocks, their places, and Delta from the blocks' values and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, did_you_mean
from robustlab.uncertainty.blocks.base import Block
from robustlab.uncertainty.blocks.kinds import ComplexScalar, FullBlock, RealScalar


def as_blocks(given: Any) -> tuple[Block, ...]:
    """Blocks as given, or from rows in the notation of MATLAB's ``mussv``.

    ``[-r, 0]`` is one real scalar repeated r times, ``[r, 0]`` a complex one, ``[r, c]`` a full block of r rows and c
    columns; ``[-1, 1]`` and ``[1, 1]`` are a real and a complex scalar. Such blocks are called ``delta1, delta2, ...``.

    Raises
    ------
    InputError
        Names used twice, or a row that is none of these.

    Examples
    --------
    >>> as_blocks([[-2, 0], [1, 3]])
    (RealScalar(name='delta1', repeats=2, parameter=None), FullBlock(name='delta2', rows=1, cols=3))
    """
    if isinstance(given, Block):
        given = [given]
    if isinstance(given, np.ndarray):
        given = np.atleast_2d(given).tolist()
    if not isinstance(given, Iterable) or isinstance(given, (str, bytes)):
        raise InputError("blocks", f"{type(given).__name__}", "a list of blocks or of mussv rows")
    blocks = tuple(b if isinstance(b, Block) else _from_mussv_row(b, i) for i, b in enumerate(given))
    names = [b.name for b in blocks]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(
            "blocks", f"block name {twice[0]!r} is used twice", "unique names", "use repeats=... for a repeated scalar"
        )
    return blocks


def _from_mussv_row(row: Any, index: int) -> Block:
    name = f"delta{index + 1}"
    expected = "[-r, 0], [r, 0] or [r, c] with whole numbers r, c >= 1"
    try:
        r, c = (float(v) for v in row)
    except (TypeError, ValueError):
        raise InputError(f"blocks[{index}]", f"{row!r}", expected) from None
    if r != int(r) or c != int(c):
        raise InputError(f"blocks[{index}]", f"{row!r}", expected)
    r, c = int(r), int(c)
    if r < 0 and (c == 0 or (r, c) == (-1, 1)):
        return RealScalar(name, -r)
    if r > 0 and (c == 0 or (r, c) == (1, 1)):
        return ComplexScalar(name, r)
    if r > 0 and c > 0:
        return FullBlock(name, r, c)
    raise InputError(f"blocks[{index}]", f"{row!r}", expected)


def structure_size(blocks: Sequence[Block]) -> tuple[int, int]:
    """``(q, p)``: Delta is q x p, so M has q input and p output columns of perturbation channels."""
    return sum(b.rows for b in blocks), sum(b.cols for b in blocks)


def block_slices(blocks: Sequence[Block]) -> list[tuple[slice, slice]]:
    """For each block its slice of w (rows of Delta) and of z (columns of Delta)."""
    result, row, col = [], 0, 0
    for b in blocks:
        result.append((slice(row, row + b.rows), slice(col, col + b.cols)))
        row, col = row + b.rows, col + b.cols
    return result


def delta_matrix(blocks: Sequence[Block], values: Mapping[str, ArrayLike]) -> NDArray[Any]:
    """The block-diagonal Delta, shape (q, p), from one normalised value per block name; blocks left out are zero.

    Scalar blocks take a number, full blocks a matrix (rows, cols). The result is real where every value is real. A
    negative delta of a range that is not symmetric is multiplied with its ratio (see `RealScalar`).

    Raises
    ------
    InputError
        Unknown names, wrong shapes, NaN or Inf, a complex value for a real block.
    """
    known = tuple(b.name for b in blocks)
    for name in values:
        if name not in known:
            raise InputError(
                f"delta {name!r}", "no such block", f"one of {', '.join(known) or 'none'}", did_you_mean(name, known)
            )
    q, p = structure_size(blocks)
    delta: NDArray[Any] = np.zeros((q, p), dtype=complex)
    for block, (rows, cols) in zip(blocks, block_slices(blocks), strict=True):
        if block.name not in values:
            continue
        value = np.asarray(values[block.name], dtype=complex)
        if not np.isfinite(value).all():
            raise InputError(f"delta {block.name!r}", "NaN or infinite", "finite numbers")
        delta[rows, cols] = block.matrix_of(value)
    return delta if np.imag(delta).any() else np.real(delta)


def delta_values(blocks: Sequence[Block], delta: ArrayLike) -> dict[str, Any]:
    """Inverse of `delta_matrix`: one value per block name (float, complex, or a complex matrix)."""
    full = np.asarray(delta)
    return {
        block.name: block.value_of(full[rows, cols])
        for block, (rows, cols) in zip(blocks, block_slices(blocks), strict=True)
    }
