"""A complex scalar: unmodelled dynamics of one channel, or the same of several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import ComplexArray
from robustlab.uncertainty.blocks.base import check_name_and_size
from robustlab.uncertainty.blocks.parameter_range import ParameterRange
from robustlab.uncertainty.blocks.scalar import ScalarBlock


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
        Where the block comes from, in words; blocks that differ in nothing else are equal.

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

    def __post_init__(self) -> None:
        check_name_and_size(self.name, self.repeats)

    @property
    def is_ball(self) -> bool:
        """One number is every matrix of its size."""
        return self.repeats == 1

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        """The mean of the diagonal."""
        return np.trace(part) / len(part) * np.eye(len(part))

    def value_of(self, part: NDArray[Any]) -> complex:
        """The number."""
        return complex(part[0, 0])

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any] | None:
        """The phase that turns the gain to the real axis."""
        gain = (left * right).sum()
        return size * np.conj(gain) / abs(gain) * np.eye(self.repeats) if gain != 0 else None

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        """Any phase."""
        return np.exp(2j * np.pi * rng.random()) * np.eye(self.repeats)

    @classmethod
    def from_row(cls, name: str, rows: int, cols: int, parameter: ParameterRange | None, origin: str) -> ComplexScalar:
        """The block of one row of a file."""
        return cls(name, rows, origin=origin)
