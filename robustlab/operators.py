"""Arithmetic of transfer matrices, written as one writes it: ``2 * G``, ``G + H``, ``G @ K``, ``G ** -1``."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ClassVar, Self, TypeVar, cast

from robustlab.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])

# The power of a model has that many times its states.
LARGEST_POWER = 100


class TransferMatrix:
    """Base of models and of sets of them: operators on what their class says of products, sums and inverses.

    ``G * H`` is ``G @ H``, the product of the transfer matrices in which H comes first in the signal's way, as
    python-control and MATLAB read it. Operands are models, sets, matrices and numbers, and python-control's objects on
    the right. A number, or a model with one input and one output, multiplies every channel; added it has to have the
    size of the other.
    """

    operator_rank: ClassVar[int] = 0  # the operand of the higher rank carries out the operation
    __array_ufunc__ = None  # numpy arrays on the left leave the operation to us

    def _product(self, second: Any, first: Any) -> Any:
        raise NotImplementedError

    def _sum(self, first: Any, second: Any, sign: int) -> Any:
        raise NotImplementedError

    def _identity(self) -> Self:
        raise NotImplementedError

    def inverse(self) -> Self:
        """The inverse of a square transfer matrix."""
        raise NotImplementedError

    def _yields(self, other: Any) -> bool:
        return getattr(other, "operator_rank", 0) > self.operator_rank

    def __matmul__(self, other: Any) -> Self:
        """``self @ other``: the product of the transfer matrices; ``other`` comes first in the signal's way."""
        if self._yields(other):
            return NotImplemented
        return self._product(self, other)

    def __rmatmul__(self, other: Any) -> Self:
        return self._product(other, self)

    __mul__, __rmul__ = __matmul__, __rmatmul__

    def __truediv__(self, other: Any) -> Self:
        """Every channel divided by a number."""
        if isinstance(other, bool) or not isinstance(other, (int, float)) or other == 0:
            found = "0" if other == 0 else type(other).__name__
            raise InputError("division", f"by {found}", "a number that is not zero", "write G @ H.inverse()")
        return self._product(1.0 / other, self)

    def __add__(self, other: Any) -> Self:
        if self._yields(other):
            return NotImplemented
        return self._sum(self, other, 1)

    def __radd__(self, other: Any) -> Self:
        return self._sum(other, self, 1)

    def __sub__(self, other: Any) -> Self:
        if self._yields(other):
            return NotImplemented
        return self._sum(self, other, -1)

    def __rsub__(self, other: Any) -> Self:
        return self._sum(other, self, -1)

    def __neg__(self) -> Self:
        return self._product(-1.0, self)

    def __pos__(self) -> Self:
        return self

    def __pow__(self, exponent: int) -> Self:
        """``G ** -1`` is the inverse, ``G ** 2`` is ``G @ G``, ``G ** 0`` the identity.

        Raises InputError: no whole number, or a model that is not square.
        """
        if isinstance(exponent, bool) or not isinstance(exponent, int) or abs(exponent) > LARGEST_POWER:
            raise InputError(
                "power", f"exponent {exponent!r}", f"a whole number from -{LARGEST_POWER} to {LARGEST_POWER}"
            )
        if exponent < 0:
            return self.inverse() ** -exponent
        result = self._identity() if exponent == 0 else self
        for _ in range(exponent - 1):
            result = result._product(self, result)
        return result


def carried_by_rank(function: F) -> F:
    """An interconnection that an operand of a class with a method ``carried`` carries out, and not the function."""

    @wraps(function)
    def by_rank(*operands: Any, **options: Any) -> Any:
        carrier = next((operand for operand in operands if hasattr(operand, "carried")), None)
        return function(*operands, **options) if carrier is None else carrier.carried(function, *operands, **options)

    return cast("F", by_rank)
