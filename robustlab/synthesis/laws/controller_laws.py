r"""Controllers as functions of named parameters: packed matrices :math:`\Theta(p) = [A_K, B_K; C_K, D_K]`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.statespace import StateSpaceModel


@dataclass(frozen=True)
class Parameter:
    """A parameter of a controller."""

    name: str
    unit: str = ""  # empty: not stated
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0  # where a search starts
    size: float = 0.0  # typical change; 0: from the plant's scaling
    centre: float = 0.0  # centre of random starts, in units of its size and relative to `start`


@dataclass(frozen=True, eq=False)
class Law:
    """``Theta(p) = base + sum of entries``; an entry at (row, column) is ``weight * p[top] / (p[below] + dt)``.

    ``top``, ``below`` -1: that factor is one.
    """

    parameters: tuple[Parameter, ...]
    sizes: tuple[int, int, int]  # numbers of states, controls and measurements
    base: AnyArray
    entries: AnyArray  # rows of (top, row, column, weight, below)
    dt: float = 0.0  # of the backward differences of a sampled derivative filter; 0: continuous

    def __post_init__(self) -> None:
        top, row, column, weight, below = self.entries.T
        places = {"top": top, "row": row, "column": column, "below": below}
        self.__dict__.update({name: values.astype(int) for name, values in places.items()}, weight=weight)

    top: AnyArray = field(init=False)
    row: AnyArray = field(init=False)
    column: AnyArray = field(init=False)
    below: AnyArray = field(init=False)
    weight: AnyArray = field(init=False)

    def _factors(self, p: AnyArray) -> tuple[AnyArray, AnyArray]:
        return np.append(p, 1.0)[self.top], 1 / np.append(p + self.dt, 1.0)[self.below]

    def packed(self, p: AnyArray) -> AnyArray:
        """Return ``[A_K, B_K; C_K, D_K]``, shape (n_states + n_controls, n_states + n_measurements)."""
        top, share = self._factors(p)
        theta = self.base.astype(np.result_type(self.base, p))
        np.add.at(theta, (self.row, self.column), self.weight * top * share)
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """Return ``sum(G * dTheta/dp_j)`` for every parameter."""
        n, (top, share) = len(p), self._factors(p)
        by = self.weight * G[self.row, self.column] * share
        above = np.bincount(self.top % (n + 1), by, n + 1)
        return (above - np.bincount(self.below % (n + 1), by * top * share, n + 1))[:n]

    def model(self, p: AnyArray, dt: float, inputs: Any = None, outputs: Any = None) -> StateSpaceModel:
        """Return the controller as a model."""
        k = self.sizes[0]
        return StateSpaceModel(*unpacked(self.packed(p), k), dt, inputs, outputs, [f"k{i + 1}" for i in range(k)])


def unpacked(theta: AnyArray, n_states: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return ``(A_K, B_K, C_K, D_K)`` of packed matrices."""
    k = n_states
    return theta[:k, :k], theta[:k, k:], theta[k:, :k], theta[k:, k:]


@dataclass
class LawBuilder:
    """Builder of a law from its parameters and the entries of the packed matrices that they fill."""

    n_states: int
    n_controls: int
    n_measurements: int
    parameters: list[Parameter] = field(default_factory=list)
    entries: list[tuple[int, int, int, float, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.base = np.zeros((self.n_states + self.n_controls, self.n_states + self.n_measurements))

    def parameter(self, parameter: Parameter, *entries: tuple[int, int, float], below: int = -1) -> None:
        """Add a parameter with its entries ``(row, column, weight)``, divided by that of number ``below``."""
        self.entries += [(len(self.parameters), row, column, weight, below) for row, column, weight in entries]
        self.parameters.append(parameter)

    def law(self, dt: float = 0.0) -> Law:
        """Return the finished law."""
        sizes = self.n_states, self.n_controls, self.n_measurements
        return Law(tuple(self.parameters), sizes, self.base, np.array(self.entries, dtype=float).reshape(-1, 5), dt)


def side_by_side(
    parts: Sequence[Law], controls: Sequence[Sequence[int]], measurements: Sequence[Sequence[int]], n_u: int, n_y: int
) -> Law:
    """Return the law of parts from ``measurements[i]`` to ``controls[i]``, whose shared controls add up.

    The parameters are those of the parts in order.
    """
    made = LawBuilder(sum(part.sizes[0] for part in parts), n_u, n_y)
    k, state = made.n_states, 0
    for part, u, y in zip(parts, controls, measurements, strict=True):
        own, first = range(state, state + part.sizes[0]), len(made.parameters)
        rows, columns = (np.array([*own, *(k + i for i in channels)], dtype=int) for channels in (u, y))
        made.base[rows[:, None], columns] += part.base
        top, below = (np.where(at < 0, -1, at + first).tolist() for at in (part.top, part.below))
        made.entries += zip(
            top, rows[part.row].tolist(), columns[part.column].tolist(), part.weight.tolist(), below, strict=True
        )
        made.parameters += part.parameters
        state = own.stop
    return made.law(max((part.dt for part in parts), default=0.0))
