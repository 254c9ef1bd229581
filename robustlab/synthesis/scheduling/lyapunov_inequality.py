"""The dissipation inequality of an LPV model over whole cells: its Bernstein coefficients, as a solver takes them.

Wu, Yang, Packard, Becker 1996. Where all coefficients are negative definite, so is the inequality in the whole cell.
What the solver finds is proved in ball arithmetic (`robustlab.verification.parameters`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.synthesis.problem.partition import PlantMatrices
from robustlab.synthesis.problem.scaling import Scaling, equilibrated
from robustlab.synthesis.scheduling.inequalities import bounded_real
from robustlab.synthesis.scheduling.parameter_varying import LPVModel

# Entries of the deviation in a cell up to which every choice of signs is asked for: exact, but 2^n inequalities.
SIGNED_ENTRIES = 3

Index = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Coefficient:
    """One ``L_c``: means over the pairs, and what of P its derivative along the motion is."""

    pairs: tuple[tuple[Index, Index], ...]  # vertex of the model, and of P
    slopes: tuple[tuple[float, Index], ...]  # factor and vertex of P: their sum is the derivative of P
    shift: Array  # added to the model: its deviation with one choice of signs; zero where the next takes its place
    deviation: Array  # bound of what the model deviates beside it


class Inequality:
    """The coefficients of one model, scaled by powers of two."""

    def __init__(self, model: LPVModel, varying: bool, size: float = 0.0) -> None:
        self.varies = tuple(varying and np.isfinite(p.rate) for p in model.parameters)
        n = model.n_states
        middle = model.matrices[tuple(size // 2 for size in model.grid)]
        nothing = (np.zeros((n, 0)), np.zeros((0, n)))
        scaling = equilibrated(
            PlantMatrices(
                middle[:n, :n], middle[:n, n:], nothing[0], middle[n:, :n], nothing[1], middle[n:, n:],
                np.zeros((len(middle) - n, 0)), np.zeros((0, middle.shape[1] - n)),
            )
        )  # fmt: skip
        if size > 0:
            scaling = replace(scaling, z=scaling.z * 2.0 ** -round(float(np.log2(size * scaling.gain))))
        self.gain = scaling.gain
        rows = np.append(1 / (scaling.states * scaling.rate), np.full(len(middle) - n, scaling.z))
        cols = np.append(scaling.states, np.full(middle.shape[1] - n, scaling.w))
        factor = rows[:, None] * cols
        self.model = model.changed(matrices=model.matrices * factor, deviation=model.deviation * factor)
        self.scaling: Scaling = scaling
        self.given = model
        self.rates = tuple(p.rate / scaling.rate for p in model.parameters)
        self.n = n

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the stack of P: the grid along the parameters with which it varies, 1 along the others."""
        return tuple(size if v else 1 for size, v in zip(self.model.grid, self.varies, strict=True))

    def scaled(self, P: Array) -> Array:
        """P of the model as given in the scaled states, exactly."""
        s = self.scaling
        return P * s.states[:, None] * s.states * (s.z * s.rate / s.w)

    def as_given(self, P: Array) -> Array:
        """Inverse of `scaled`."""
        s = self.scaling
        return P / s.states[:, None] / s.states / (s.z * s.rate / s.w)

    def turned(self, T: Array) -> Inequality:
        """The same, rounded, in states ``x = T x'``: for a solver, not for a proof."""
        made, n, back = copy(self), self.n, np.linalg.inv(T)
        left, right = np.eye(self.model.matrices.shape[-2]), np.eye(self.model.matrices.shape[-1])
        left[:n, :n], right[:n, :n] = back, T
        made.model = self.model.changed(matrices=left @ self.model.matrices @ right)
        made.coefficients = [
            replace(c, shift=left @ c.shift @ right, deviation=np.abs(left) @ c.deviation @ np.abs(right))
            for c in self.coefficients
        ]
        return made

    @cached_property
    def coefficients(self) -> list[Coefficient]:
        """All of them; those that neighbouring cells share once."""
        found: dict[Any, Coefficient] = {}
        for cell in self.model.cells():
            for made in self._of_cell(cell):
                key = (made.pairs, made.slopes, made.shift.tobytes(), made.deviation.tobytes())
                found[key] = made
        return list(found.values())

    def count(self) -> int:
        """How many inequalities there are at most, without making them."""
        cells = int(np.prod([size - 1 for size in self.model.grid]))
        signs = max(len(self._signed(self.model.deviation[cell])[0]) for cell in self.model.cells())
        return cells * signs * int(np.prod([6 if v else 2 for v in self.varies]))

    def _signed(self, deviation: Array) -> tuple[list[Array], Array]:
        """The deviation with every choice of its signs, and what of it is only bounded: all where entries are many."""
        places = np.argwhere(deviation > 0)
        if len(places) > SIGNED_ENTRIES:
            return [np.zeros_like(deviation)], deviation
        shifts = []
        for signs in product((1.0, -1.0), repeat=len(places)):
            shift = np.zeros_like(deviation)
            shift[tuple(places.T)] = signs * deviation[tuple(places.T)]
            shifts.append(shift)
        return shifts, np.zeros_like(deviation)

    def _of_cell(self, cell: Index) -> list[Coefficient]:
        k, made = len(cell), []
        shifts, rest = self._signed(self.model.deviation[cell])
        signs = [(1.0, -1.0) if v and rate > 0 else (0.0,) for v, rate in zip(self.varies, self.rates, strict=True)]
        for c in product(*((0, 1, 2) if v else (0, 2) for v in self.varies)):
            halves = [((0, 1), (1, 0)) if ci == 1 else ((ci // 2, ci // 2),) for ci in c]
            pairs = []
            for bits in product(*halves):
                v = tuple(cell[i] + bits[i][0] for i in range(k))
                pairs.append((v, tuple(cell[i] + bits[i][1] if self.varies[i] else 0 for i in range(k))))
            for sign in product(*signs):
                slopes = self._slopes(cell, pairs, sign)
                made += [Coefficient(tuple(pairs), slopes, shift, rest) for shift in shifts]
        return made

    def _slopes(
        self, cell: Index, pairs: Sequence[tuple[Index, Index]], sign: Sequence[float]
    ) -> tuple[tuple[float, Index], ...]:
        """The derivative of P along the motion, at rates at their ends, as a sum of vertices of P."""
        total: dict[Index, float] = {}
        for i, s in enumerate(sign):
            if not s:
                continue
            points = self.model.parameters[i].points
            factor = s * self.rates[i] / (points[cell[i] + 1] - points[cell[i]]) / len(pairs)
            for _, w in pairs:
                for end, part in ((1, factor), (0, -factor)):
                    at = (*w[:i], cell[i] + end, *w[i + 1 :])
                    total[at] = total.get(at, 0.0) + part
        return tuple((part, at) for at, part in total.items() if part)

    def matrix(self, c: Coefficient, P: Mapping[Index, Any], gamma: Any) -> Any:
        """``L_c`` for a solver, P at its vertices and gamma unknown."""
        import cvxpy as cp

        n, share, matrices = self.n, 1.0 / len(c.pairs), self.model.matrices
        top: Any = sum(share * (P[w] @ (matrices[v] + c.shift)[:n]) for v, w in c.pairs)
        drift = top[:, :n] + top[:, :n].T + sum(factor * P[w] for factor, w in c.slopes)
        return bounded_real(cp.hstack([drift, top[:, n:]]), *self._outputs(c), gamma)

    def sizes(self, c: Coefficient) -> Array:
        """The same for ``P = I`` at every vertex without slopes and ``gamma = 1``."""
        n, mean = self.n, np.mean([self.model.matrices[v] for v, _ in c.pairs], axis=0) + c.shift
        a, b, (out, direct) = mean[:n, :n], mean[:n, n:], self._outputs(c)
        slope = sum(factor for factor, _ in c.slopes) * np.eye(n)
        q, m = direct.shape
        return np.block([[a + a.T + slope, b, out.T], [b.T, -np.eye(m), direct.T], [out, direct, -np.eye(q)]])

    def _outputs(self, c: Coefficient) -> tuple[Array, Array]:
        mean = np.mean([self.model.matrices[v][self.n :] for v, _ in c.pairs], axis=0) + c.shift[self.n :]
        return mean[:, : self.n], mean[:, self.n :]
