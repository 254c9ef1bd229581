"""Operators of models of any kind: ``G(1j)``, ``G.feedback()``, ``2 * G``, ``G + H``, ``G @ K``, ``G ** -1``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar, cast

from robustlab.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from robustlab.record import Record

F = TypeVar("F", bound=Callable[..., Any])

# Largest exponent: the power of a model has that many times its states.
LARGEST_POWER = 100


class _ToControl:
    """A method ``__call__`` that python-control's ss() does not take for the right-hand side of a nonlinear system.

    ``control.ss(G)`` tests ``callable(G)`` before the type of G, and would return an empty system.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __get__(self, model: Any, kind: type | None = None) -> Any:
        if model is None:
            return self.function
        if sys._getframe(1).f_globals.get("__name__") == "control.statesp":
            found = f"control.ss takes no {type(model).__name__}"
            raise TypeError(f"{found}\nhint: {model.for_control}")
        return self.function.__get__(model, kind)


def _not_for_control(function: F) -> F:
    return cast("F", _ToControl(function))


class Behaviour:
    """Base of all kinds of models, with the methods common to them; their functions are in higher packages."""

    operator_rank: ClassVar[int] = 0  # the operand of higher rank performs the operation
    no_model: ClassVar[str] = ""  # hint of a kind without a state-space model
    for_control: ClassVar[str] = "G.to_control() is G as a control.StateSpace"  # hint for python-control

    @property
    def n_inputs(self: Any) -> int:
        """Number of inputs n_u."""
        return len(self.inputs)

    @property
    def n_outputs(self: Any) -> int:
        """Number of outputs n_y."""
        return len(self.outputs)

    @property
    def input_names(self: Any) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(s.name for s in self.inputs)

    @property
    def output_names(self: Any) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(s.name for s in self.outputs)

    def _yields(self, other: Any) -> bool:
        return getattr(other, "operator_rank", 0) > self.operator_rank

    def _numbers(self) -> list[str]:
        """Return the lines of ``print`` below the repr: the model's matrices, or their equivalent."""
        return []

    def __str__(self) -> str:
        return "\n".join([repr(self), *(f"  {line}" for line in self._numbers())])

    def _loop(self, forward: Any, back: Any, sign: int | None) -> Any:
        found = f"{type(forward).__name__} has no loops"
        raise InputError("feedback", found, "a model, or a set of models", self.no_model)

    def feedback(self, other: Any = 1.0, sign: int | None = None) -> Self:
        """Return the closed loop from r to y for ``y = self e, e = r + sign other y``, with this model's signals.

        The result is of the more general kind of the two: of a model and a set of models it is a set.

        Parameters
        ----------
        other
            A model of any kind, a matrix, or a number (for as many inputs as outputs).
        sign
            -1: negative feedback, ``e = r - other y``; 1: positive. Left out: a controller from a design has its own
            sign, anything else negative feedback.

        Raises
        ------
        InputError
            Sizes, sample times or units that do not fit; a sign that contradicts the controller; a kind without loops.
        NoTrustworthyNumber
            The loop is not well posed.
        """
        return (other if self._yields(other) else self)._loop(self, other, sign)

    @_not_for_control
    def __call__(self, s: ArrayLike) -> NDArray[np.complex128]:
        r"""Compute the transfer matrix at complex numbers: ``G(2j)`` is the response at 2 rad/s.

        ``s`` is one number in rad/s, or shape (n,); of a discrete model z, :math:`e^{j \omega dt}` at a frequency. The
        result has shape (n_y, n_u), or (n, n_y, n_u). Raises InputError: numbers that are not finite, frequency data at
        other frequencies than their own; NoTrustworthyNumber: a number is a pole.
        """
        return import_module("robustlab.linear_analysis.frequency").value_at(self, s)

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles in rad/s (z plane if discrete), shape (n_x,); of a set those of the nominal model.

        Raises InputError: a kind without a state-space model, such as one with exact delays.
        """
        return import_module("robustlab.statespace").as_model(self, "poles").poles()

    def zeros(self) -> NDArray[np.complex128]:
        """Return the finite invariant zeros (n_z,), as `poles`; `robustlab.zeros` adds kinds and directions."""
        return import_module("robustlab.linear_analysis.zeros").zeros(self).values

    def step(self, t_end: float | None = None, input: str | None = None) -> Record:
        """Simulate the response to a unit step on one input, from rest, at 401 samples or those of a discrete model.

        Parameters
        ----------
        t_end
            End in s; eight time constants of the slowest decay where left out.
        input
            Name of the input; the only one where left out.

        Raises
        ------
        InputError
            An unstable model without ``t_end``, several inputs without ``input``, a kind without step responses.
        """
        return import_module("robustlab.dynamics.simulation").step_response(self, t_end, input)


class TransferMatrix(Behaviour):
    """Base of models and of sets of them: operators by the products, sums and inverses of their class.

    ``G * H`` is ``G @ H``, the product of the transfer matrices in which the signal passes H first, as in
    python-control and MATLAB. Operands are models, sets, matrices and numbers, and python-control's objects on the
    right. A number, or a model with one input and one output, multiplies every channel; in a sum it needs the size of
    the other.
    """

    __array_ufunc__ = None  # numpy arrays on the left defer to this class

    def _product(self, second: Any, first: Any) -> Any:
        raise NotImplementedError

    def _sum(self, first: Any, second: Any, sign: int) -> Any:
        raise NotImplementedError

    def _identity(self) -> Self:
        raise NotImplementedError

    def inverse(self) -> Self:
        """Return the inverse of a square transfer matrix."""
        raise NotImplementedError

    def __matmul__(self, other: Any) -> Self:
        """Return ``self @ other``, the product of the transfer matrices; the signal passes ``other`` first."""
        if self._yields(other):
            return NotImplemented
        return self._product(self, other)

    def __rmatmul__(self, other: Any) -> Self:
        return self._product(other, self)

    __mul__, __rmul__ = __matmul__, __rmatmul__

    def __truediv__(self, other: Any) -> Self:
        """Divide every channel by a number."""
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
        """Return a power: ``G ** -1`` is the inverse, ``G ** 2`` is ``G @ G``, ``G ** 0`` the identity.

        Raises InputError: no whole number, or a model that is not square.
        """
        if isinstance(exponent, bool) or not isinstance(exponent, int) or abs(exponent) > LARGEST_POWER:
            expected = f"a whole number from -{LARGEST_POWER} to {LARGEST_POWER}"
            raise InputError("power", f"exponent {exponent!r}", expected)
        if exponent < 0:
            return self.inverse() ** -exponent
        result = self._identity() if exponent == 0 else self
        for _ in range(exponent - 1):
            result = result._product(self, result)
        return result


def carried_by_rank(function: F) -> F:
    """Let an operand with a method ``carried`` perform an interconnection in place of the function."""

    @wraps(function)
    def by_rank(*operands: Any, **options: Any) -> Any:
        carrier = next((operand for operand in operands if hasattr(operand, "carried")), None)
        return function(*operands, **options) if carrier is None else carrier.carried(function, *operands, **options)

    return cast("F", by_rank)
