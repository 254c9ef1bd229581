"""The blocks of a structured perturbation Delta, each normalised: ``|delta| <= 1`` or ``sigma_max(Delta_i) <= 1``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, did_you_mean

__all__ = [
    "Block",
    "ComplexScalar",
    "FullBlock",
    "ParameterRange",
    "RealScalar",
    "Sign",
    "as_blocks",
    "block_slices",
    "delta_matrix",
    "delta_values",
    "structure_size",
]


Sign = Literal["any", "either", "nonnegative", "positive"]


@dataclass(frozen=True)
class ParameterRange:
    r"""What a normalised real delta in [-1, 1] means in the user's parameter; 0 is nominal, +1 and -1 are the ends.

    .. math:: value = nominal + radius \, \delta \quad (\delta \ge 0), \qquad
              value = nominal + below \, \delta \quad (\delta < 0)

    Attributes
    ----------
    nominal, radius
        Nominal value and width of the range above it, in ``unit``.
    unit
        Physical unit of the parameter.
    below
        Width of the range beneath the nominal value; None where it is the same (a width given equal to ``radius``
        becomes None).
    sign
        What physics allows beyond the range too: a mass is ``"positive"``, a friction ``"nonnegative"``, a torque
        constant ``"either"``, but never zero and never both in one machine. It limits nothing; results that name a
        value outside say so (`impossible`). Ranges that differ in nothing else are equal.

    Raises
    ------
    InputError
        ``below`` is given, and it or ``radius`` is not a positive finite number; an unknown ``sign``.

    Examples
    --------
    >>> lag = ParameterRange(1.0, 0.5, "s", below=0.25)
    >>> lag.value(1.0), lag.value(-1.0), lag.delta(0.875)
    (1.5, 0.75, -0.5)
    """

    nominal: float
    radius: float
    unit: str = ""
    below: float | None = None
    sign: Sign = field(default="any", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.sign not in get_args(Sign):
            raise InputError("ParameterRange: sign", f"{self.sign!r}", f"one of {', '.join(get_args(Sign))}")
        if self.below is None:
            return
        for word, width in (("above (radius)", self.radius), ("below", self.below)):
            if isinstance(width, bool) or not isinstance(width, (int, float, np.number)) or not 0 < width < np.inf:
                raise InputError(
                    "ParameterRange",
                    f"width {width!r} {word} the nominal value" if word == "below" else f"width {width!r} {word}",
                    "a positive finite number",
                    "a range that ends at its nominal value needs another nominal value, inside of it",
                )
        if not 0 < self.below / self.radius < np.inf:
            raise InputError("ParameterRange", f"widths {self.radius} above and {self.below} below", "a finite ratio")
        if self.below == self.radius:
            object.__setattr__(self, "below", None)

    @classmethod
    def between(cls, low: float, high: float, nominal: float | None = None, unit: str = "") -> ParameterRange:
        """The range from ``low`` to ``high`` around ``nominal``, which is the middle where left out.

        Raises
        ------
        InputError
            Not ``low < nominal < high``, or numbers that are not finite.

        Examples
        --------
        >>> ParameterRange.between(0.75, 1.5, 1.0)
        ParameterRange(nominal=1.0, radius=0.5, unit='', below=0.25)
        """
        middle = 0.5 * (low + high) if nominal is None else nominal
        if not (np.isfinite([low, middle, high]).all() and low < middle < high):
            raise InputError("ParameterRange", f"{low} .. {high} around {middle}", "finite low < nominal < high")
        if nominal is None:
            return cls(middle, 0.5 * (high - low), unit)
        return cls(middle, high - middle, unit, middle - low)

    @property
    def ratio(self) -> float:
        """Width below divided by width above: what a negative delta is multiplied with to give the entry of Delta."""
        return 1.0 if self.below is None else self.below / self.radius

    @property
    def low(self) -> float:
        """The value at delta = -1."""
        return self.value(-1.0)

    @property
    def high(self) -> float:
        """The value at delta = +1."""
        return self.value(1.0)

    def value(self, delta: float) -> float:
        """Parameter value that belongs to a normalised delta."""
        width = self.radius if self.below is None or delta >= 0 else self.below
        return self.nominal + width * delta

    def delta(self, value: float) -> float:
        """Normalised delta that belongs to a parameter value."""
        width = self.radius if self.below is None or value >= self.nominal else self.below
        return (value - self.nominal) / width

    def impossible(self, value: float) -> str:
        """What physics asks of the parameter that this value does not meet; empty where it may exist.

        Examples
        --------
        >>> ParameterRange(4.8e-05, 1.68e-05, "N m s", sign="nonnegative").impossible(-1e-4)
        'it is never negative'
        """
        if self.sign == "positive" and value <= 0:
            return "it is always positive"
        if self.sign == "either" and value * self.nominal <= 0:
            return "it never changes its sign"
        return "it is never negative" if self.sign == "nonnegative" and value < 0 else ""

    def to_json(self) -> dict[str, object]:
        """The attributes; ``below`` only where it differs from ``radius``, ``sign`` only where there is one."""
        data: dict[str, object] = {"nominal": self.nominal, "radius": self.radius, "unit": self.unit}
        if self.below is not None:
            data["below"] = self.below
        return data if self.sign == "any" else {**data, "sign": self.sign}


@dataclass(frozen=True)
class RealScalar:
    """``delta * I`` with one real delta, ``-1 <= delta <= 1``, repeated ``repeats`` times.

    ``parameter`` says which physical range the normalised delta stands for. Where that range is wider on one side, the
    number that stands in Delta is ``delta`` for ``delta >= 0`` and ``ratio * delta`` for ``delta < 0``: it fills
    [-ratio, 1], and every value of the parameter enters M by one and the same affine law. ``origin`` says in words
    where the block comes from; blocks that differ in nothing else are equal.
    """

    name: str
    repeats: int = 1
    parameter: ParameterRange | None = None
    origin: str = field(default="", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        _check(self.name, self.repeats)

    @property
    def rows(self) -> int:
        """Rows of the block (entries of w)."""
        return self.repeats

    @property
    def cols(self) -> int:
        """Columns of the block (entries of z)."""
        return self.repeats

    @property
    def ratio(self) -> float:
        """Width of the range below nominal divided by the width above; 1 for a symmetric range or without one."""
        return 1.0 if self.parameter is None else self.parameter.ratio

    def entry(self, delta: float) -> float:
        """The number that stands in Delta for a normalised delta."""
        return delta if delta >= 0 else self.ratio * delta

    def delta(self, entry: float) -> float:
        """The normalised delta that belongs to a number in Delta."""
        return entry if entry >= 0 else entry / self.ratio


@dataclass(frozen=True)
class ComplexScalar:
    """``delta * I`` with one complex delta, ``|delta| <= 1``, repeated ``repeats`` times."""

    name: str
    repeats: int = 1
    origin: str = field(default="", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        _check(self.name, self.repeats)

    @property
    def rows(self) -> int:
        """Rows of the block (entries of w)."""
        return self.repeats

    @property
    def cols(self) -> int:
        """Columns of the block (entries of z)."""
        return self.repeats


@dataclass(frozen=True)
class FullBlock:
    """A full complex matrix ``Delta_i`` of shape (rows, cols) with ``sigma_max(Delta_i) <= 1``; ``w = Delta_i z``."""

    name: str
    rows: int
    cols: int
    origin: str = field(default="", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        _check(self.name, self.rows)
        _check(self.name, self.cols)


Block = RealScalar | ComplexScalar | FullBlock


def _check(name: str, size: int) -> None:
    if not isinstance(name, str) or not name or len(name) > 200:
        raise InputError("block", f"name {name!r}", "a text of 1 to 200 characters")
    if isinstance(size, bool) or not isinstance(size, (int, np.integer)) or size < 1:
        raise InputError(f"block {name!r}", f"size {size!r}", "a positive whole number")


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
    if isinstance(given, (RealScalar, ComplexScalar, FullBlock)):
        given = [given]
    if isinstance(given, np.ndarray):
        given = np.atleast_2d(given).tolist()
    if not isinstance(given, Iterable) or isinstance(given, (str, bytes)):
        raise InputError("blocks", f"{type(given).__name__}", "a list of blocks or of mussv rows")
    blocks = tuple(
        b if isinstance(b, (RealScalar, ComplexScalar, FullBlock)) else _from_mussv_row(b, i)
        for i, b in enumerate(given)
    )
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
        if isinstance(block, FullBlock):
            if value.ndim == 0 and (block.rows, block.cols) == (1, 1):
                value = value.reshape(1, 1)
            if value.shape != (block.rows, block.cols):
                raise InputError(f"delta {block.name!r}", f"shape {value.shape}", f"{(block.rows, block.cols)}")
            delta[rows, cols] = value
            continue
        if value.size != 1:
            raise InputError(f"delta {block.name!r}", f"shape {value.shape}", "one number")
        number = complex(value.reshape(()))
        if isinstance(block, RealScalar):
            if number.imag != 0:
                raise InputError(f"delta {block.name!r}", f"{number}", "a real number")
            number = complex(block.entry(number.real))
        delta[rows, cols] = number * np.eye(block.repeats)
    return delta if np.imag(delta).any() else np.real(delta)


def delta_values(blocks: Sequence[Block], delta: ArrayLike) -> dict[str, Any]:
    """Inverse of `delta_matrix`: one value per block name (float, complex, or a complex matrix)."""
    full = np.asarray(delta)
    values: dict[str, Any] = {}
    for block, (rows, cols) in zip(blocks, block_slices(blocks), strict=True):
        part = full[rows, cols]
        if isinstance(block, FullBlock):
            values[block.name] = part.copy()
        elif isinstance(block, RealScalar):
            values[block.name] = block.delta(float(part[0, 0].real))
        else:
            values[block.name] = complex(part[0, 0])
    return values
