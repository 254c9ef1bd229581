r"""Controllers as functions of named parameters: packed matrices :math:`\Theta(p) = [A_K, B_K; C_K, D_K]`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.statespace import StateSpaceModel


@dataclass(frozen=True)
class Parameter:
    """A parameter of a controller."""

    # name, unit: for people and files; an empty unit means not stated
    name: str
    unit: str = ""
    # low, high: bounds
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0  # where a search starts
    size: float = 0.0  # how much it may sensibly change; 0: found from the plant's scaling
    centre: float = 0.0  # where random starts are centred, in units of its size and relative to `start`


class Law(Protocol):
    """What every law has."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of p."""
        ...

    @property
    def sizes(self) -> tuple[int, int, int]:
        """``(n_states, n_controls, n_measurements)``."""
        ...

    def packed(self, p: AnyArray) -> AnyArray:
        """``[A_K, B_K; C_K, D_K]``, shape (n_states + n_controls, n_states + n_measurements)."""
        ...

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """``sum(G * dTheta/dp_j)`` for every parameter; G has the shape of the packed matrices."""
        ...


def unpacked(theta: AnyArray, n_states: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """``(A_K, B_K, C_K, D_K)`` of packed matrices."""
    k = n_states
    return theta[:k, :k], theta[:k, k:], theta[k:, :k], theta[k:, k:]


def model_of(law: Law, p: AnyArray, dt: float, inputs: Any = None, outputs: Any = None) -> StateSpaceModel:
    """The controller as a model."""
    k = law.sizes[0]
    return StateSpaceModel(*unpacked(law.packed(p), k), dt, inputs, outputs, [f"k{i + 1}" for i in range(k)])


@dataclass(frozen=True, eq=False)
class AffineLaw:
    """``Theta = base + sum_j p_j E_j`` with sparse E_j: entry ``(row, column)`` gets ``weight * p[index]``."""

    parameters: tuple[Parameter, ...]
    sizes: tuple[int, int, int]
    base: AnyArray
    index: AnyArray
    row: AnyArray
    column: AnyArray
    weight: AnyArray

    def packed(self, p: AnyArray) -> AnyArray:
        theta = self.base.astype(np.result_type(self.base, p))
        np.add.at(theta, (self.row, self.column), self.weight * p[self.index])
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        return np.bincount(self.index, self.weight * G[self.row, self.column], len(self.parameters))


@dataclass
class AffineBuilder:
    """Collects parameters and the entries of the packed matrices that they fill."""

    n_states: int
    n_controls: int
    n_measurements: int
    parameters: list[Parameter] = field(default_factory=list)
    entries: list[tuple[int, int, int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.base = np.zeros((self.n_states + self.n_controls, self.n_states + self.n_measurements))

    def parameter(self, parameter: Parameter, *entries: tuple[int, int, float]) -> None:
        """A parameter with its entries ``(row, column, weight)``."""
        self.entries += [(len(self.parameters), row, column, weight) for row, column, weight in entries]
        self.parameters.append(parameter)

    def law(self) -> AffineLaw:
        """The finished law."""
        table = np.array(self.entries, dtype=float).reshape(-1, 4)
        index, row, column = (table[:, j].astype(int) for j in range(3))
        sizes = self.n_states, self.n_controls, self.n_measurements
        return AffineLaw(tuple(self.parameters), sizes, self.base, index, row, column, table[:, 3])


@dataclass(frozen=True, eq=False)
class FilteredLaw:
    """An affine law with one more parameter, the time constant tau of its derivative filters."""

    law: AffineLaw
    tau: Parameter
    first: int
    dt: float
    derivative: AnyArray  # parameters that are derivative gains

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the affine law, then tau."""
        return (*self.law.parameters, self.tau)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Those of the affine law."""
        return self.law.sizes

    def _rate(self, tau: Any) -> tuple[Any, Any]:
        """The filter's rate r in ``x' = r (y - x)`` and its derivative with respect to tau."""
        if self.dt:
            return self.dt / (tau + self.dt), -self.dt / (tau + self.dt) ** 2
        return 1 / tau, -1 / tau**2

    def _scaled(self, p: AnyArray) -> AnyArray:
        return np.where(self.derivative, p[:-1] / (p[-1] + self.dt), p[:-1])

    def packed(self, p: AnyArray) -> AnyArray:
        theta = self.law.packed(self._scaled(p))
        k, n_y = self.sizes[0], self.sizes[2]
        rate, _ = self._rate(p[-1])
        for j in range(k - self.first):
            i = self.first + j
            theta[i, i] = (1.0 if self.dt else 0.0) - rate
            theta[i, k + j % n_y] = rate
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        inner = self.law.pullback(self._scaled(p), G)
        tau = p[-1] + self.dt
        k, n_y = self.sizes[0], self.sizes[2]
        _, slope = self._rate(p[-1])
        by_tau = slope * sum(G[i, k + (i - self.first) % n_y] - G[i, i] for i in range(self.first, k))
        by_tau = by_tau - (inner * np.where(self.derivative, p[:-1], 0.0)).sum() / tau**2
        return np.append(np.where(self.derivative, inner / tau, inner), by_tau)


@dataclass(frozen=True, eq=False)
class DiagonalLaw:
    """Laws side by side; part i sees the measurements ``measurements[i]`` and drives the controls ``controls[i]``."""

    parts: tuple[Law, ...]
    controls: tuple[tuple[int, ...], ...]
    measurements: tuple[tuple[int, ...], ...]
    n_controls: int
    n_measurements: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the parts, one after the other."""
        return tuple(parameter for part in self.parts for parameter in part.parameters)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """States of all parts, all controls, all measurements."""
        return sum(part.sizes[0] for part in self.parts), self.n_controls, self.n_measurements

    def _places(self) -> list[tuple[Law, slice, AnyArray, AnyArray]]:
        """Of every part its parameters, its rows and its columns in the packed matrices."""
        k, state, first, found = self.sizes[0], 0, 0, []
        for part, u, y in zip(self.parts, self.controls, self.measurements, strict=True):
            own = list(range(state, state + part.sizes[0]))
            count = len(part.parameters)
            rows, columns = (np.array([*own, *(k + i for i in channels)], dtype=int) for channels in (u, y))
            found.append((part, slice(first, first + count), rows, columns))
            state, first = state + part.sizes[0], first + count
        return found

    def packed(self, p: AnyArray) -> AnyArray:
        k = self.sizes[0]
        theta = np.zeros((k + self.n_controls, k + self.n_measurements), dtype=np.result_type(float, p))
        for part, own, rows, columns in self._places():
            theta[rows[:, None], columns] += part.packed(p[own])
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        return np.concatenate(
            [part.pullback(p[own], G[rows[:, None], columns]) for part, own, rows, columns in self._places()]
        )


def sum_law(first: Law, second: Law) -> DiagonalLaw:
    """``K_1 + K_2``: both see all measurements, their controls add up."""
    _, n_u, n_y = first.sizes
    u, y = tuple(range(n_u)), tuple(range(n_y))
    return DiagonalLaw((first, second), (u, u), (y, y), n_u, n_y)


@dataclass(frozen=True, eq=False)
class SeriesLaw:
    """``K_2 K_1``: the measurements go into the first, its outputs into the second."""

    first: Law
    second: Law

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the first, then of the second."""
        return (*self.first.parameters, *self.second.parameters)

    @property
    def sizes(self) -> tuple[int, int, int]:
        return self.first.sizes[0] + self.second.sizes[0], self.second.sizes[1], self.first.sizes[2]

    def _parts(self, p: AnyArray) -> tuple[AnyArray, AnyArray]:
        count = len(self.first.parameters)
        return p[:count], p[count:]

    def packed(self, p: AnyArray) -> AnyArray:
        one, two = self._parts(p)
        a1, b1, c1, d1 = unpacked(self.first.packed(one), self.first.sizes[0])
        a2, b2, c2, d2 = unpacked(self.second.packed(two), self.second.sizes[0])
        top = np.hstack([a1, np.zeros((len(a1), len(a2))), b1])
        return np.vstack([top, np.hstack([b2 @ c1, a2, b2 @ d1]), np.hstack([d2 @ c1, c2, d2 @ d1])])

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        one, two = self._parts(p)
        i, j = self.first.sizes[0], self.second.sizes[0]
        first, second = self.first.packed(one), self.second.packed(two)
        # Rows of the second see [C1, D1] through its columns [B2; D2].
        into = second[:, j:]
        out = first[i:]
        columns = np.r_[0:i, i + j : G.shape[1]]
        rows = np.r_[i : G.shape[0]]
        crossed = G[np.ix_(rows, columns)]
        g1 = np.vstack([G[:i][:, columns], into.T @ crossed])
        g2 = np.hstack([G[rows, i : i + j], crossed @ out.T])
        return np.concatenate([self.first.pullback(one, g1), self.second.pullback(two, g2)])


@dataclass(frozen=True, eq=False)
class RelabelledLaw:
    """A law with other names, bounds or starts of its parameters."""

    law: Law
    parameters: tuple[Parameter, ...]

    @property
    def sizes(self) -> tuple[int, int, int]:
        return self.law.sizes

    def packed(self, p: AnyArray) -> AnyArray:
        return self.law.packed(p)

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        return self.law.pullback(p, G)
