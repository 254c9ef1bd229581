"""What the scalar kinds share: one number times the identity."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError
from robustlab.uncertainty.blocks.base import Block, Pattern


class ScalarBlock(Block):
    """``delta * I``, ``repeats`` times; a dataclass with that field."""

    is_scalar: ClassVar[bool] = True
    repeats: int

    @property
    def rows(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of the block (entries of w)."""
        return self.repeats

    @property
    def cols(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Columns of the block (entries of z)."""
        return self.repeats

    @property
    def value_shape(self) -> tuple[int, int]:
        """One number."""
        return (1, 1)

    def norm(self, part: NDArray[Any]) -> float:
        """Size of the number."""
        return float(abs(part[0, 0]))

    def matrix_of(self, value: NDArray[Any]) -> NDArray[Any]:
        """The number times the identity."""
        if value.size != 1:
            raise InputError(f"delta {self.name!r}", f"shape {value.shape}", "one number")
        return self.entry_of(complex(value.reshape(()))) * np.eye(self.repeats)

    def entry_of(self, number: complex) -> complex:
        """What stands in Delta for a value."""
        return number

    def members(self, coordinates: Array) -> NDArray[Any]:
        """Numbers beyond one in size are drawn back to one."""
        return super().members(coordinates) * np.eye(self.repeats)

    @property
    def d_order(self) -> int:
        """D is any Hermitian matrix."""
        return self.repeats

    def d_basis(self) -> list[tuple[Pattern, Pattern]]:
        """All Hermitian matrices, the same on both sides."""
        return [(pattern, pattern) for pattern in hermitian_basis(self.repeats)]

    def commutes(self, d_w: ComplexArray, d_z: ComplexArray, g: ComplexArray) -> bool:
        """D Hermitian and the same on both sides; G Hermitian, where there is room for one."""
        fits = (d_w == d_z).all() and (d_w == d_w.conj().T).all()
        return bool(fits and ((g == g.conj().T).all() if self.is_real else not g.any()))

    def resized(self, rows: int, cols: int) -> Self:
        """The same number, repeated more or fewer times."""
        return dataclasses.replace(self, repeats=rows) if rows == cols else super().resized(rows, cols)  # type: ignore[type-var]

    def merged(self, others: Sequence[Any], where: str) -> Block:
        """The same number everywhere: repeated."""
        size = self.repeats + sum(b.repeats for b in others)
        return self.resized(size, size)


def hermitian_basis(order: int) -> list[Pattern]:
    """Basis of the Hermitian matrices of an order over the real numbers; diagonal ones first."""
    diagonal: list[Pattern] = [[(i, i, 1.0)] for i in range(order)]
    pairs = [(i, j) for i in range(order) for j in range(i + 1, order)]
    return diagonal + [[(i, j, c), (j, i, np.conj(c))] for i, j in pairs for c in (1.0 + 0j, 1j)]
