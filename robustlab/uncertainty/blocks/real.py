"""A real scalar: a parameter of the plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError
from robustlab.uncertainty.blocks.base import Block, Pattern, check_name_and_size
from robustlab.uncertainty.blocks.complex import ComplexScalar
from robustlab.uncertainty.blocks.parameter_range import ParameterRange
from robustlab.uncertainty.blocks.scalar import ScalarBlock, hermitian_basis


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
        Which physical range the normalised delta stands for. Where that range is wider on one side, the number that
        stands in Delta is ``delta`` for ``delta >= 0`` and ``ratio * delta`` for ``delta < 0``: it fills [-ratio, 1],
        and every value of the parameter enters M by one and the same affine law.
    origin
        Where the block comes from, in words; blocks that differ in nothing else are equal.

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
        """Width of the range below nominal divided by the width above; 1 for a symmetric range or without one."""
        return 1.0 if self.parameter is None else self.parameter.ratio

    @property
    def interval(self) -> tuple[float, float]:
        """From minus the ratio to one."""
        return (-self.ratio, 1.0)

    @property
    def is_symmetric(self) -> bool:
        """Whether the range is as wide below nominal as above."""
        return self.ratio == 1

    def entry(self, delta: float) -> float:
        """The number that stands in Delta for a normalised delta."""
        return delta if delta >= 0 else self.ratio * delta

    def delta(self, entry: float) -> float:
        """The normalised delta that belongs to a number in Delta."""
        return entry if entry >= 0 else entry / self.ratio

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        """The mean of the diagonal, without its imaginary part."""
        return (np.trace(part) / len(part)).real * np.eye(len(part))

    def entry_of(self, number: complex) -> complex:
        """The number that stands in Delta for a normalised delta."""
        if number.imag != 0:
            raise InputError(f"delta {self.name!r}", f"{number}", "a real number")
        return complex(self.entry(number.real))

    def value_of(self, part: NDArray[Any]) -> float:
        """The normalised delta."""
        return self.delta(float(part[0, 0].real))

    def draw(self, rng: np.random.Generator, boundary: bool = False) -> float:
        """Uniform over the range; at its boundary too, which is a matter of vertices."""
        return self.in_range(float(rng.uniform(-1.0, 1.0)))

    def in_range(self, place: float) -> float:
        """The normalised delta at a place of the range whose ends are at -1 and 1, and its middle at 0."""
        if self.ratio == 1:
            return place
        delta = self.delta(0.5 * ((1.0 - self.ratio) + (1.0 + self.ratio) * place))
        return min(max(delta, -1.0), 1.0)  # rounding next to an end must not leave the range

    def members(self, coordinates: Array) -> NDArray[Any]:
        """The coordinate is the normalised delta."""
        entries = np.where(coordinates < 0, coordinates * self.ratio, coordinates)
        return entries[:, :, None] * np.eye(self.rows)

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any]:
        """The sign of the real part of the gain."""
        return size * np.sign((left * right).sum().real) * np.eye(self.repeats)

    def g_basis(self) -> list[Pattern]:
        """G is any Hermitian matrix."""
        return hermitian_basis(self.repeats)

    def as_complex(self) -> ComplexScalar:
        """A complex number instead of the real one."""
        return ComplexScalar(self.name, self.repeats)

    def merged(self, others: Sequence[RealScalar], where: str) -> Block:
        """The same number everywhere, if it has one range."""
        for other in others:
            if other.parameter != self.parameter:
                found = f"stands for {self.parameter} in one operand and for {other.parameter} in another"
                raise InputError(where, found, "one range for one name", "rename one of the two blocks")
        return super().merged(others, where)

    def centred(self, level: float) -> tuple[float, float, Block]:
        """The range, ``level`` times as wide on each side, around its own middle."""
        middle, half = 0.5 * level * (1.0 - self.ratio), 0.5 * level * (1.0 + self.ratio)
        span = self.parameter
        if span is not None:
            span = ParameterRange(span.nominal + span.radius * middle, span.radius * half, span.unit, sign=span.sign)
        return middle, half, replace(self, parameter=span)

    @classmethod
    def from_row(cls, name: str, rows: int, cols: int, parameter: ParameterRange | None, origin: str) -> RealScalar:
        """The block of one row of a file."""
        return cls(name, rows, parameter, origin=origin)
