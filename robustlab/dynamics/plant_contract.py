r"""What every plant is: named parameters and signals, and its equations of motion.

.. math:: \dot x = f(x, u), \qquad y = h(x, u)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.dynamics.parameters import Parameter
from robustlab.errors import InputError
from robustlab.statespace import Signal, real_array, signals

__all__ = ["Array", "Plant"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Plant(ABC):
    """The contract of a plant; linear plants follow it through `robustlab.dynamics.linear_plant.LinearPlant`.

    Attributes
    ----------
    name
        Name in the registry, for example ``"dc-motor"``.
    parameters
        Name -> parameter.
    inputs, outputs, states
        Named signals with units; their order is the order of u, y and x.
    """

    name: str
    parameters: Mapping[str, Parameter]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]

    def __post_init__(self) -> None:
        for key, parameter in self.parameters.items():
            if key != parameter.name:
                raise InputError(f"{self.name}: parameters", f"{key!r} holds {parameter.name!r}", "one name")
        object.__setattr__(self, "parameters", dict(self.parameters))
        for kind in ("inputs", "outputs", "states"):
            given = getattr(self, kind)
            object.__setattr__(self, kind, signals(given, len(given), kind, f"{self.name}: {kind}"))

    @abstractmethod
    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``f(x, u)``: rates of the states, shape (n_x,), for x of shape (n_x,) and u of shape (n_u,)."""

    @abstractmethod
    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``h(x, u)``: outputs, shape (n_y,)."""

    @property
    def values(self) -> dict[str, float]:
        """Nominal value of each parameter."""
        return {name: p.value for name, p in self.parameters.items()}

    def point(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """The vectors x and u as finite vectors of this plant's sizes.

        Raises
        ------
        InputError
            Wrong lengths, NaN or Inf.
        """
        vectors = real_array("x", x, 1, self.name), real_array("u", u, 1, self.name)
        for vector, kind in zip(vectors, (self.states, self.inputs), strict=True):
            if len(vector) != len(kind):
                names = ", ".join(s.name for s in kind)
                raise InputError(self.name, f"{len(vector)} numbers for {names}", f"{len(kind)}")
        return vectors

    def __repr__(self) -> str:
        values = ", ".join(f"{p.name}={p.value:g}" for p in self.parameters.values())
        return f"{type(self).__name__}({self.name!r}: {values})"
