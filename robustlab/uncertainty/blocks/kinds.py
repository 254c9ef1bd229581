"""The kinds of blocks: real scalars (parameters), complex scalars, full blocks (unmodelled dynamics); and Delta."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, did_you_mean
from robustlab.uncertainty.blocks.base import Block, ParameterRange, Pattern, check_name_and_size, rank_one


class ScalarBlock(Block):
    """``delta * I``, ``repeats`` times; a dataclass with that field."""

    is_scalar: ClassVar[bool] = True
    repeats: int

    @property
    def rows(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.repeats

    @property
    def cols(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.repeats

    @property
    def value_shape(self) -> tuple[int, int]:
        return (1, 1)

    def norm(self, part: NDArray[Any]) -> float:
        return float(abs(part[0, 0]))

    def matrix_of(self, value: NDArray[Any]) -> NDArray[Any]:
        if value.size != 1:
            raise InputError(f"delta {self.name!r}", f"shape {value.shape}", "one number")
        return self.entry_of(complex(value.reshape(()))) * np.eye(self.repeats)

    def entry_of(self, number: complex) -> complex:
        return number

    def members(self, coordinates: Array) -> NDArray[Any]:
        return super().members(coordinates) * np.eye(self.repeats)

    @property
    def d_order(self) -> int:
        return self.repeats

    def d_basis(self) -> list[tuple[Pattern, Pattern]]:
        return [(pattern, pattern) for pattern in hermitian_basis(self.repeats)]

    def resized(self, rows: int, cols: int) -> Self:
        return dataclasses.replace(self, repeats=rows) if rows == cols else super().resized(rows, cols)  # type: ignore[type-var]

    def merged(self, others: Sequence[Any], where: str) -> Block:
        size = self.repeats + sum(b.repeats for b in others)
        return self.resized(size, size)


def hermitian_basis(order: int) -> list[Pattern]:
    """Return a basis of the Hermitian matrices of an order over the real numbers; diagonal ones first."""
    diagonal: list[Pattern] = [[(i, i, 1.0)] for i in range(order)]
    pairs = [(i, j) for i in range(order) for j in range(i + 1, order)]
    return diagonal + [[(i, j, c), (j, i, np.conj(c))] for i, j in pairs for c in (1.0 + 0j, 1j)]


@dataclass(frozen=True)
class ComplexScalar(ScalarBlock):
    """``delta * I`` with one complex delta, ``|delta| <= 1``, repeated ``repeats`` times.

    Parameters
    ----------
    name
        Unique within a structure.
    repeats
        How many channels the number acts on.
    origin
        Source of the block, in words; ignored in comparisons.
    covers
        For a delay: its length and its spread in s, and the orders of the approximation and of the weight; else None.

    Raises
    ------
    InputError
        A name that is no text of 1 to 200 characters, a size that is no positive whole number.
    """

    is_real: ClassVar[bool] = False
    stored_as: ClassVar[str] = "complex"

    name: str
    repeats: int = 1
    origin: str = field(default="", repr=False, compare=False, kw_only=True)
    covers: tuple[float, float, int, int] | None = field(default=None, repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        check_name_and_size(self.name, self.repeats)

    @property
    def is_ball(self) -> bool:
        return self.repeats == 1

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        return np.trace(part) / len(part) * np.eye(len(part))

    def value_of(self, part: NDArray[Any]) -> complex:
        return complex(part[0, 0])

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        return np.exp(2j * np.pi * rng.random()) * np.eye(self.repeats)


@dataclass(frozen=True)
class RealScalar(ScalarBlock):
    """``delta * I`` with one real delta, ``-1 <= delta <= 1``, repeated ``repeats`` times.

    Parameters
    ----------
    name
        Unique within a structure.
    repeats
        How many channels the number acts on.
    parameter
        The physical range of the normalised delta. If that range is wider on one side, the entry of Delta is ``delta``
        for ``delta >= 0`` and ``ratio * delta`` for ``delta < 0``, in [-ratio, 1], so that M is affine in the
        parameter.
    origin
        Source of the block, in words; ignored in comparisons.

    Raises
    ------
    InputError
        A name that is no text of 1 to 200 characters, a size that is no positive whole number.

    Examples
    --------
    >>> mass = RealScalar("mass", parameter=ParameterRange(1.0, 0.5, "kg", below=0.25))
    >>> mass.entry(-1.0), mass.delta(-0.25)
    (-0.5, -0.5)
    """

    is_real: ClassVar[bool] = True
    stored_as: ClassVar[str] = "real"

    name: str
    repeats: int = 1
    parameter: ParameterRange | None = None
    origin: str = field(default="", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        check_name_and_size(self.name, self.repeats)

    @property
    def ratio(self) -> float:
        """Return the width of the range below nominal divided by the width above; 1 without a range."""
        return 1.0 if self.parameter is None else self.parameter.ratio

    @property
    def interval(self) -> tuple[float, float]:
        return (-self.ratio, 1.0)

    @property
    def is_symmetric(self) -> bool:
        return self.ratio == 1

    def entry(self, delta: float) -> float:
        """Return the entry of Delta for a normalised delta."""
        return delta if delta >= 0 else self.ratio * delta

    def delta(self, entry: float) -> float:
        """Return the normalised delta of an entry of Delta."""
        return entry if entry >= 0 else entry / self.ratio

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        return (np.trace(part) / len(part)).real * np.eye(len(part))

    def entry_of(self, number: complex) -> complex:
        if number.imag != 0:
            raise InputError(f"delta {self.name!r}", f"{number}", "a real number")
        return complex(self.entry(number.real))

    def value_of(self, part: NDArray[Any]) -> float:
        return self.delta(float(part[0, 0].real))

    def draw(self, rng: np.random.Generator, boundary: bool = False) -> float:
        return self.in_range(float(rng.uniform(-1.0, 1.0)))

    def in_range(self, place: float) -> float:
        if self.ratio == 1:
            return place
        delta = self.delta(0.5 * ((1.0 - self.ratio) + (1.0 + self.ratio) * place))
        return min(max(delta, -1.0), 1.0)  # rounding next to an end must not leave the range

    def members(self, coordinates: Array) -> NDArray[Any]:
        entries = np.where(coordinates < 0, coordinates * self.ratio, coordinates)
        return entries[:, :, None] * np.eye(self.rows)

    def g_basis(self) -> list[Pattern]:
        return hermitian_basis(self.repeats)

    def as_complex(self) -> ComplexScalar:
        return ComplexScalar(self.name, self.repeats)

    def merged(self, others: Sequence[RealScalar], where: str) -> Block:
        for other in others:
            if other.parameter != self.parameter:
                found = f"stands for {self.parameter} in one operand and for {other.parameter} in another"
                raise InputError(where, found, "one range for one name", "rename one of the two blocks")
        return super().merged(others, where)

    def centred(self, level: float) -> tuple[float, float, Block]:
        middle, half = 0.5 * level * (1.0 - self.ratio), 0.5 * level * (1.0 + self.ratio)
        span = self.parameter
        if span is not None:
            span = ParameterRange(span.nominal + span.radius * middle, span.radius * half, span.unit, sign=span.sign)
        return middle, half, replace(self, parameter=span)


@dataclass(frozen=True)
class FullBlock(Block):
    """A full complex matrix ``Delta_i`` of shape (rows, cols) with ``sigma_max(Delta_i) <= 1``; ``w = Delta_i z``.

    Parameters
    ----------
    name
        Unique within a structure.
    rows, cols
        Entries of w and of z.
    origin
        Source of the block, in words; ignored in comparisons.
    covers
        For a delay: its length and its spread in s, and the orders of the approximation and of the weight; else None.

    Raises
    ------
    InputError
        A name that is no text of 1 to 200 characters, a size that is no positive whole number.
    """

    is_real: ClassVar[bool] = False
    is_scalar: ClassVar[bool] = False
    stored_as: ClassVar[str] = "full"

    name: str
    rows: int
    cols: int
    origin: str = field(default="", repr=False, compare=False, kw_only=True)
    covers: tuple[float, float, int, int] | None = field(default=None, repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        check_name_and_size(self.name, self.rows)
        check_name_and_size(self.name, self.cols)

    @property
    def is_ball(self) -> bool:
        return True

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        return part

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any] | None:
        norm = np.linalg.norm(left) * np.linalg.norm(right)
        return size * np.outer(np.conj(left), np.conj(right)) / norm if norm > 0 else None

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        return rank_one(vector(self.rows), vector(self.cols))

    def resized(self, rows: int, cols: int) -> Self:
        return replace(self, rows=rows, cols=cols)

    def merged(self, others: Sequence[FullBlock], where: str) -> Block:
        if all(b.value_shape == (1, 1) for b in (self, *others)):
            return ComplexScalar(self.name, 1 + len(others))
        return super().merged(others, where)


def as_blocks(given: Any) -> tuple[Block, ...]:
    """Return blocks as given, or from rows in the notation of MATLAB's ``mussv``."""
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
    try:
        r, c = (int(v) for v in row if float(v).is_integer())
    except (TypeError, ValueError):
        r, c = 0, 0
    if r < 0 and (c == 0 or (r, c) == (-1, 1)):
        return RealScalar(name, -r)
    if r > 0 and (c == 0 or (r, c) == (1, 1)):
        return ComplexScalar(name, r)
    if r > 0 and c > 0:
        return FullBlock(name, r, c)
    raise InputError(f"blocks[{index}]", f"{row!r}", "[-r, 0], [r, 0] or [r, c] with whole numbers r, c >= 1")


def structure_size(blocks: Sequence[Block]) -> tuple[int, int]:
    """Return ``(q, p)``, the shape of Delta: M has q inputs and p outputs of perturbation channels."""
    return sum(b.rows for b in blocks), sum(b.cols for b in blocks)


def block_slices(blocks: Sequence[Block]) -> list[tuple[slice, slice]]:
    """Return each block's slices of w (rows of Delta) and of z (columns of Delta)."""
    result, row, col = [], 0, 0
    for b in blocks:
        result.append((slice(row, row + b.rows), slice(col, col + b.cols)))
        row, col = row + b.rows, col + b.cols
    return result


def delta_matrix(blocks: Sequence[Block], values: Mapping[str, ArrayLike]) -> NDArray[Any]:
    """Return the block-diagonal Delta (q, p) of one normalised value per block name; omitted blocks are zero."""
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
    """Return one value per block name (float, complex, or a complex matrix): the inverse of `delta_matrix`."""
    full = np.asarray(delta)
    return {
        block.name: block.value_of(full[rows, cols])
        for block, (rows, cols) in zip(blocks, block_slices(blocks), strict=True)
    }
