"""A full block: unmodelled dynamics that couple several channels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import ComplexArray
from robustlab.uncertainty.blocks.base import Block, check_name_and_size, rank_one
from robustlab.uncertainty.blocks.complex import ComplexScalar
from robustlab.uncertainty.blocks.parameter_range import ParameterRange


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
        Where the block comes from, in words; blocks that differ in nothing else are equal.

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

    def __post_init__(self) -> None:
        check_name_and_size(self.name, self.rows)
        check_name_and_size(self.name, self.cols)

    @property
    def is_ball(self) -> bool:
        """By definition."""
        return True

    def project(self, part: NDArray[Any]) -> NDArray[Any]:
        """Any matrix is a multiple of a member."""
        return part

    def aligned(self, left: ComplexArray, right: ComplexArray, size: float = 1.0) -> NDArray[Any] | None:
        """The matrix of rank one along both."""
        norm = np.linalg.norm(left) * np.linalg.norm(right)
        return size * np.outer(np.conj(left), np.conj(right)) / norm if norm > 0 else None

    def extreme(self, rng: np.random.Generator, vector: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
        """A matrix of rank one."""
        return rank_one(vector(self.rows), vector(self.cols))

    def resized(self, rows: int, cols: int) -> Self:
        """A full block of any size."""
        return replace(self, rows=rows, cols=cols)

    def merged(self, others: Sequence[FullBlock], where: str) -> Block:
        """One number everywhere: repeated. A repeated matrix has no kind."""
        if all(b.value_shape == (1, 1) for b in (self, *others)):
            return ComplexScalar(self.name, 1 + len(others))
        return super().merged(others, where)

    @classmethod
    def from_row(cls, name: str, rows: int, cols: int, parameter: ParameterRange | None, origin: str) -> FullBlock:
        """The block of one row of a file."""
        return cls(name, rows, cols, origin=origin)
