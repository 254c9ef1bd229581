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
    size: float = 0.0  # how much it may sensibly change; 0: found from the plant's scaling
    centre: float = 0.0  # where random starts are centred, in units of its size and relative to `start`


@dataclass(frozen=True, eq=False)
class Law:
    """A controller as a function of its parameters p."""

    parameters: tuple[Parameter, ...]
    sizes: tuple[int, int, int]  # numbers of states, controls and measurements

    def packed(self, p: AnyArray) -> AnyArray:
        """``[A_K, B_K; C_K, D_K]``, shape (n_states + n_controls, n_states + n_measurements)."""
        raise NotImplementedError

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """``sum(G * dTheta/dp_j)`` for every parameter."""
        raise NotImplementedError

    def model(self, p: AnyArray, dt: float, inputs: Any = None, outputs: Any = None) -> StateSpaceModel:
        """The controller as a model."""
        k = self.sizes[0]
        return StateSpaceModel(*unpacked(self.packed(p), k), dt, inputs, outputs, [f"k{i + 1}" for i in range(k)])


def unpacked(theta: AnyArray, n_states: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """``(A_K, B_K, C_K, D_K)`` of packed matrices."""
    k = n_states
    return theta[:k, :k], theta[:k, k:], theta[k:, :k], theta[k:, k:]


@dataclass(frozen=True, eq=False)
class AffineLaw(Law):
    """``Theta = base + sum_j p_j E_j`` with sparse E_j: entry ``(row, column)`` gets ``weight * p[index]``."""

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
        sizes = self.n_states, self.n_controls, self.n_measurements
        index, row, column = table[:, :3].astype(int).T
        return AffineLaw(tuple(self.parameters), sizes, self.base, index, row, column, table[:, 3])


@dataclass(frozen=True, eq=False)
class FilteredLaw(Law):
    """An affine law with one more parameter, the time constant tau of its derivative filters.

    The states from ``first`` on are filters, ``tau x' = -x + y`` (discrete: backward Euler), and act as
    ``(y - x)/tau``; the affine law is written for ``tau = 1``.
    """

    law: AffineLaw
    first: int
    dt: float
    derivative: AnyArray  # parameters that are derivative gains

    def _scaled(self, p: AnyArray) -> AnyArray:
        return np.where(self.derivative, p[:-1] / (p[-1] + self.dt), p[:-1])

    def packed(self, p: AnyArray) -> AnyArray:
        theta, tau = self.law.packed(self._scaled(p)), p[-1]
        k, _, n_y = self.sizes
        rate = self.dt / (tau + self.dt) if self.dt else 1 / tau
        for i in range(self.first, k):
            theta[i, i] = (1.0 if self.dt else 0.0) - rate
            theta[i, k + (i - self.first) % n_y] = rate
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        inner, tau = self.law.pullback(self._scaled(p), G), p[-1] + self.dt
        k, _, n_y = self.sizes
        slope = -(self.dt or 1.0) / tau**2
        by_tau = slope * sum(G[i, k + (i - self.first) % n_y] - G[i, i] for i in range(self.first, k))
        by_tau = by_tau - (inner * np.where(self.derivative, p[:-1], 0.0)).sum() / tau**2
        return np.append(np.where(self.derivative, inner / tau, inner), by_tau)


@dataclass(frozen=True, eq=False)
class DiagonalLaw(Law):
    """Laws side by side; part i sees the measurements ``measurements[i]`` and drives the controls ``controls[i]``.

    What several parts give to one control adds up.
    """

    parts: Sequence[Law]
    controls: Sequence[Sequence[int]]
    measurements: Sequence[Sequence[int]]

    @classmethod
    def of(
        cls, parts: Sequence[Law], controls: Sequence[Sequence[int]], measurements: Sequence[Sequence[int]],
        n_controls: int, n_measurements: int,
    ) -> DiagonalLaw:  # fmt: skip
        """With the parameters of the parts, one after the other."""
        parameters = tuple(parameter for part in parts for parameter in part.parameters)
        sizes = sum(part.sizes[0] for part in parts), n_controls, n_measurements
        return cls(parameters, sizes, parts, controls, measurements)

    def _places(self) -> list[tuple[Law, slice, AnyArray, AnyArray]]:
        """Of every part its parameters, its rows and its columns in the packed matrices."""
        k, state, first, found = self.sizes[0], 0, 0, []
        for part, u, y in zip(self.parts, self.controls, self.measurements, strict=True):
            own, count = range(state, state + part.sizes[0]), len(part.parameters)
            rows, columns = (np.array([*own, *(k + i for i in channels)], dtype=int) for channels in (u, y))
            found.append((part, slice(first, first + count), rows, columns))
            state, first = own.stop, first + count
        return found

    def packed(self, p: AnyArray) -> AnyArray:
        k, n_u, n_y = self.sizes
        theta = np.zeros((k + n_u, k + n_y), dtype=np.result_type(float, p))
        for part, own, rows, columns in self._places():
            theta[rows[:, None], columns] += part.packed(p[own])
        return theta

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        return np.concatenate(
            [part.pullback(p[own], G[rows[:, None], columns]) for part, own, rows, columns in self._places()]
        )


@dataclass(frozen=True, eq=False)
class SeriesLaw(Law):
    """``K_2 K_1``: the measurements go into the first, its outputs into the second."""

    first: Law
    second: Law

    @classmethod
    def of(cls, first: Law, second: Law) -> SeriesLaw:
        """With the parameters of the first, then of the second."""
        sizes = first.sizes[0] + second.sizes[0], second.sizes[1], first.sizes[2]
        return cls((*first.parameters, *second.parameters), sizes, first, second)

    def packed(self, p: AnyArray) -> AnyArray:
        one, two = np.split(p, [len(self.first.parameters)])
        a1, b1, c1, d1 = unpacked(self.first.packed(one), self.first.sizes[0])
        a2, b2, c2, d2 = unpacked(self.second.packed(two), self.second.sizes[0])
        return np.block([[a1, np.zeros((len(a1), len(a2))), b1], [b2 @ c1, a2, b2 @ d1], [d2 @ c1, c2, d2 @ d1]])

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        one, two = np.split(p, [len(self.first.parameters)])
        i, j = self.first.sizes[0], self.second.sizes[0]
        # Rows of the second see [C1, D1] through its columns [B2; D2].
        into, out = self.second.packed(two)[:, j:], self.first.packed(one)[i:]
        columns = np.r_[0:i, i + j : G.shape[1]]
        crossed = G[i:, columns]
        g1 = np.vstack([G[:i][:, columns], into.T @ crossed])
        g2 = np.hstack([G[i:, i : i + j], crossed @ out.T])
        return np.concatenate([self.first.pullback(one, g1), self.second.pullback(two, g2)])
