"""The blocks of a structured perturbation Delta, each normalised: |delta| <= 1 or sigma_max(Delta_i) <= 1.

All differences between kinds of uncertainty are methods or properties of the kind. A `ParameterRange` maps a
normalised real delta to the user's parameter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.checks import choice, number, whole
from robustlab.errors import InputError, unknown_name

Sign = Literal["any", "either", "nonnegative", "positive"]


@dataclass(frozen=True)
class ParameterRange:
    r"""Map of a normalised real delta in [-1, 1] to the user's parameter; 0 is nominal, +1 and -1 are the ends.

    .. math:: value = nominal + radius \, \delta \quad (\delta \ge 0), \qquad
              value = nominal + below \, \delta \quad (\delta < 0)

    Attributes
    ----------
    nominal, radius
        Nominal value and width of the range above it, in ``unit``.
    unit
        Physical unit of the parameter.
    below
        Width of the range below the nominal value; None where it equals ``radius``.
    sign
        Physical limit, also outside the range: a mass is ``"positive"``, a friction ``"nonnegative"``, a torque
        constant ``"either"`` (of constant sign, not zero). It does not limit the range; results with a value outside
        remark on it (`impossible`). Ignored in comparisons.

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
        choice("ParameterRange: sign", self.sign, get_args(Sign))
        if self.below is None:
            return
        for word, width in (("above (radius)", self.radius), ("below", self.below)):
            hint = "a range that ends at its nominal value needs another nominal value, inside of it"
            number(f"ParameterRange: width {word}", width, "a positive finite number", hint, above=0)
        if not 0 < self.below / self.radius < np.inf:
            raise InputError("ParameterRange", f"widths {self.radius} above and {self.below} below", "a finite ratio")
        if self.below == self.radius:
            object.__setattr__(self, "below", None)

    @property
    def words(self) -> str:
        """Return the ends with their unit, and the nominal value where it is not the middle."""
        around = "" if self.below is None else f" around {self.nominal:.6g}"
        return f"{self.low:.6g} .. {self.high:.6g} {self.unit}{around}".rstrip()

    @classmethod
    def between(cls, low: float, high: float, nominal: float | None = None, unit: str = "") -> ParameterRange:
        """Return the range from ``low`` to ``high`` around ``nominal``, by default the middle."""
        middle = 0.5 * (low + high) if nominal is None else nominal
        if not (np.isfinite([low, middle, high]).all() and low < middle < high):
            raise InputError("ParameterRange", f"{low} .. {high} around {middle}", "finite low < nominal < high")
        if nominal is None:
            return cls(middle, 0.5 * (high - low), unit)
        return cls(middle, high - middle, unit, middle - low)

    @property
    def ratio(self) -> float:
        """Return width below divided by width above, the factor of a negative delta in Delta."""
        return 1.0 if self.below is None else self.below / self.radius

    @property
    def low(self) -> float:
        """Return the value at delta = -1."""
        return self.value(-1.0)

    @property
    def high(self) -> float:
        """Return the value at delta = +1."""
        return self.value(1.0)

    def value(self, delta: float) -> float:
        """Return the parameter value of a normalised delta."""
        width = self.radius if self.below is None or delta >= 0 else self.below
        return self.nominal + width * delta

    def delta(self, value: float) -> float:
        """Return the normalised delta of a parameter value."""
        width = self.radius if self.below is None or value >= self.nominal else self.below
        return (value - self.nominal) / width

    def impossible(self, value: float) -> str:
        """Return the physical limit that this value violates; empty where it is possible."""
        if self.sign == "positive" and value <= 0:
            return "it is always positive"
        if self.sign == "either" and value * self.nominal <= 0:
            return "it never changes its sign"
        return "it is never negative" if self.sign == "nonnegative" and value < 0 else ""

    def to_json(self) -> dict[str, object]:
        data: dict[str, object] = {"nominal": self.nominal, "radius": self.radius, "unit": self.unit}
        if self.below is not None:
            data["below"] = self.below
        return data if self.sign == "any" else {**data, "sign": self.sign}


Pattern = list[tuple[int, int, complex]]  # entries (row, column, coefficient) of a sparse matrix
SAMPLED = "sampled"  # first word of the origin of a block that holds for samples only


class Block:
    """One block ``w = Delta_i z`` of a structured perturbation; the defaults are those of a full block."""

    # With a member its multiples by 0 .. 1 are in the set. A *value* is the user's form of a member: a number for a
    # scalar kind, else a matrix of `value_shape`.

    name: str  # unique within a structure
    # rows, cols: entries of w and of z
    rows: int
    cols: int
    origin: str = ""  # where the block comes from, in words
    # Of a block for a delay: its length and spread, in s, orders of the approximation and of the weight.
    covers: tuple[float, float, int, int] | None = None
    parameter: ParameterRange | None = None  # the physical range of a real delta

    # Whether all members are real matrices, constant in time; else a member is a stable system of gain at most one.
    is_real: ClassVar[bool] = False
    is_scalar: ClassVar[bool] = False  # whether members are one number times the identity
    stored_as: ClassVar[str]  # the kind's word in files

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or len(self.name) > 200:
            raise InputError("block", f"name {self.name!r}", "a text of 1 to 200 characters")
        for size in (self.rows, self.cols):
            whole(f"block {self.name!r}: size", size, 1)

    def _no_arithmetic(self, other: object = None) -> Any:
        """Reject arithmetic: a block is a set, and expressions in parameters are given as text."""
        hint = 'rl.parametric(A, B, C, D, ranges) takes entries such as "2 * k" or "-k / m"'
        raise TypeError(f"{type(self).__name__} {self.name!r} is an uncertainty block, no number\nhint: {hint}")

    __neg__ = __pos__ = __abs__ = _no_arithmetic
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _no_arithmetic
    __truediv__ = __rtruediv__ = __pow__ = __rpow__ = _no_arithmetic

    # --- the set -----------------------------------------------------------------------------------------------------

    @property
    def value_shape(self) -> tuple[int, int]:
        """Return the shape of a value as a matrix; it is repeated ``rows / value_shape[0]`` times in the block."""
        return (self.rows, self.cols)

    @property
    def interval(self) -> tuple[float, float] | None:
        """Return for one real number times the identity the ends (low, high) of its entry in Delta; None for others."""
        return None

    @property
    def ends(self) -> tuple[float, float]:
        """Return the ends of a one-number range in the user's unit, or normalised."""
        if self.parameter is not None:
            return self.parameter.low, self.parameter.high
        return self.interval or (-1.0, 1.0)

    @property
    def is_symmetric(self) -> bool:
        """Return whether the negative of each member is a member."""
        return True

    @property
    def is_ball(self) -> bool:
        """Return whether every complex matrix of this size with ``sigma_max <= 1`` is a member."""
        return True

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the nearest matrix (rows, cols) that is a multiple of a member."""
        return part

    def norm(self, part: NDArray[Any]) -> float:
        """Return the largest singular value of a multiple of a member."""
        return float(np.linalg.norm(part, 2) if part.size > 1 else abs(part[0, 0]))

    # --- values ------------------------------------------------------------------------------------------------------

    def matrix_of(self, value: NDArray[Any]) -> NDArray[Any]:
        """Return the block (rows, cols) of a value."""
        value = value.reshape(1, 1) if value.ndim == 0 and self.value_shape == (1, 1) else value
        if value.shape != self.value_shape:
            raise InputError(f"delta {self.name!r}", f"shape {value.shape}", f"{self.value_shape}")
        return value

    def value_of(self, part: NDArray[Any]) -> Any:
        """Return the value of a block (inverse of `matrix_of`)."""
        return part.copy()

    @property
    def zero(self) -> Any:
        """Return the value of the nominal model."""
        return 0.0 if self.is_scalar else np.zeros(self.value_shape)

    def draw(self, rng: np.random.Generator, boundary: bool = False) -> Any:
        """Draw a random value of the set, with ``boundary`` on its boundary."""
        matrix = rng.standard_normal(self.value_shape) + 1j * rng.standard_normal(self.value_shape)
        radius = 1.0 if boundary else rng.random() ** (1.0 / self.n_coordinates)
        # Slightly inside: the norm of the rounded matrix must not exceed one.
        matrix *= radius * (1 - 1e-15) / np.linalg.norm(matrix, 2)
        return complex(matrix[0, 0]) if self.is_scalar else matrix

    # --- real coordinates of a value, for searches and tables --------------------------------------------------------

    @property
    def n_coordinates(self) -> int:
        """Return the number of real coordinates of a value."""
        return math.prod(self.value_shape) * (1 if self.is_real else 2)

    def coordinates(self, value: Any) -> Array:
        """Return a value as real numbers (n_coordinates,): its entries, or their real and then imaginary parts."""
        entries = np.asarray(value, dtype=complex).ravel()
        return np.real(entries) if self.is_real else np.concatenate([np.real(entries), np.imag(entries)])

    def value_at(self, coordinates: Array) -> Any:
        """Return the value at coordinates (inverse of `coordinates`)."""
        entries = self._entries(coordinates)
        return entries[0].item() if self.is_scalar else entries.reshape(self.value_shape)

    def members(self, coordinates: Array) -> NDArray[Any]:
        """Return members (k, rows, cols) at coordinates (k, n_coordinates), scaled onto the set where outside."""
        matrix = self._entries(coordinates).reshape(-1, *self.value_shape)
        sizes = np.abs(matrix[:, 0, 0]) if self.value_shape == (1, 1) else np.linalg.norm(matrix, 2, axis=(1, 2))
        return matrix / np.maximum(sizes, 1.0)[:, None, None]

    def _entries(self, coordinates: Array) -> NDArray[Any]:
        half = coordinates.shape[-1] // 2
        return coordinates if self.is_real else coordinates[..., :half] + 1j * coordinates[..., half:]

    # --- members that matter -----------------------------------------------------------------------------------------

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any] | None:
        """Return ``size`` times a member with a large real part of ``left^T Delta_i right``; None if all give zero."""
        norm = np.linalg.norm(left) * np.linalg.norm(right)
        return size * np.outer(np.conj(left), np.conj(right)) / norm if norm > 0 else None

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        """Draw a member of norm one, of rank one if possible; ``vector(n)`` draws complex n-vectors."""
        return rank_one(vector(self.rows), vector(self.cols))

    # --- scalings that commute: D_w Delta = Delta D_z, and G Delta Hermitian -----------------------------------------

    @property
    def d_order(self) -> int:
        """Return the order of the Hermitian matrix of D; 1: D_w and D_z are one number times the identity."""
        return 1

    def d_basis(self) -> list[tuple[Pattern, Pattern]]:
        """Return Hermitian patterns that span ``D_w`` (rows x rows) and, with the same coefficients, ``D_z``."""
        return [([(i, i, 1 + 0j) for i in range(self.rows)], [(i, i, 1 + 0j) for i in range(self.cols)])]

    def g_basis(self) -> list[Pattern]:
        """Return patterns that span G (rows x cols); none where G is zero."""
        return []

    def as_complex(self) -> Block:
        """Return a block without G that contains this one, for proofs by D alone."""
        return self

    # --- other blocks of the kind ------------------------------------------------------------------------------------

    def resized(self, size: int) -> Self:
        """Return the same scalar block with another number of repetitions."""
        return replace(self, repeats=size)  # type: ignore[type-var]

    def merged(self, others: Sequence[Any], where: str) -> Block:
        """Merge blocks of the same uncertainty in several operands; ``others`` are of the same kind and name."""
        if self.is_scalar or all(b.value_shape == (1, 1) for b in (self, *others)):
            kind = self if self.is_scalar else ComplexScalar(self.name)
            return kind.resized(sum(b.rows for b in (self, *others)))
        expected = "a full block in one operand only: a repeated one has no structure here"
        hint = "build the interconnection so that the block occurs once, or rename one if they are different"
        raise InputError(where, "is a full block in several operands", expected, hint)

    def centred(self, level: float) -> tuple[float, float, Block]:
        """Return ``(middle, half, block)``: the set times ``level`` is ``middle I + half`` times a symmetric block."""
        return 0.0, level, self

    def to_json(self) -> dict[str, object]:
        data: dict[str, object] = {"name": self.name, "kind": type(self).__name__}
        data |= {"rows": self.rows, "cols": self.cols}
        if self.parameter is not None:
            data["parameter"] = self.parameter.to_json()
        return {**data, "origin": self.origin} if self.origin else data


def rank_one(u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """Return the matrix ``u v^T``, divided by its norm."""
    return np.outer(u / np.linalg.norm(u), v / np.linalg.norm(v))


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

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any] | None:
        part = self.project(np.outer(np.conj(left), np.conj(right)))
        norm = self.norm(part)
        return size * part / norm if norm > 0 else None

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        part = self.project(rank_one(vector(self.rows), vector(self.cols)))
        return part / self.norm(part)

    @property
    def d_order(self) -> int:
        return self.repeats

    def d_basis(self) -> list[tuple[Pattern, Pattern]]:
        return [(pattern, pattern) for pattern in hermitian_basis(self.repeats)]


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
    """

    stored_as: ClassVar[str] = "complex"

    name: str
    repeats: int = 1
    origin: str = field(default="", repr=False, compare=False, kw_only=True)
    covers: tuple[float, float, int, int] | None = field(default=None, repr=False, compare=False, kw_only=True)

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
    name, repeats, origin
        As of `ComplexScalar`.
    parameter
        The physical range of the normalised delta. If that range is wider on one side, the entry of Delta is ``delta``
        for ``delta >= 0`` and ``ratio * delta`` for ``delta < 0``, in [-ratio, 1], so that M is affine in the
        parameter.

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

    @property
    def is_ball(self) -> bool:
        return False

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
        place = float(rng.uniform(-1.0, 1.0))
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
                found = f"is {self.parameter} in one operand and {other.parameter} in another"
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
    rows, cols
        Entries of w and of z.
    name, origin, covers
        As of `ComplexScalar`.
    """

    stored_as: ClassVar[str] = "full"

    name: str
    rows: int
    cols: int
    origin: str = field(default="", repr=False, compare=False, kw_only=True)
    covers: tuple[float, float, int, int] | None = field(default=None, repr=False, compare=False, kw_only=True)


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
        found, hint = f"block name {twice[0]!r} is used twice", "use repeats=... for a repeated scalar"
        raise InputError("blocks", found, "unique names", hint)
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
            raise unknown_name(f"delta {name!r}", "no such block", name, known)
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
    full, places = np.asarray(delta), zip(blocks, block_slices(blocks), strict=True)
    return {block.name: block.value_of(full[w, z]) for block, (w, z) in places}


# The kinds that files know, by their word there.
KINDS: dict[str, type[Block]] = {k.stored_as: k for k in (RealScalar, ComplexScalar, FullBlock)}
