r"""A model with the filters of its multipliers: one set of states, and rows for every weighted signal.

.. math:: \dot x = A x + B u, \qquad v = C x + D u

u are the inputs of the model, followed by those of multipliers. States and inputs are only appended, so that earlier
rows remain valid with zeros appended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array

__all__ = ["FilteredModel", "Rows", "stacked"]


@dataclass(frozen=True, eq=False)
class Rows:
    """Signals ``c x + d u`` over the first states and inputs, (k, n) and (k, m)."""

    c: Array
    d: Array

    def __len__(self) -> int:
        return len(self.c)

    def padded(self, n: int, m: int) -> Rows:
        """Extend to n states and m inputs."""
        c, d = np.zeros((len(self), n)), np.zeros((len(self), m))
        c[:, : self.c.shape[1]], d[:, : self.d.shape[1]] = self.c, self.d
        return Rows(c, d)

    def plus(self, factor: float, other: Rows, own: float = 1.0) -> Rows:
        """Return ``own self + factor other``."""
        n, m = max(self.c.shape[1], other.c.shape[1]), max(self.d.shape[1], other.d.shape[1])
        one, two = self.padded(n, m), other.padded(n, m)
        return Rows(own * one.c + factor * two.c, own * one.d + factor * two.d)


def stacked(*parts: Rows) -> Rows:
    n, m = max(p.c.shape[1] for p in parts), max(p.d.shape[1] for p in parts)
    wide = [p.padded(n, m) for p in parts]
    return Rows(np.vstack([p.c for p in wide]), np.vstack([p.d for p in wide]))


class FilteredModel:
    """The model A, B, C, D, extended by filters on request."""

    def __init__(self, A: Array, B: Array, C: Array, D: Array) -> None:
        self.A, self.B = A.copy(), B.copy()
        self._c, self._d = C, D

    @property
    def n(self) -> int:
        return len(self.A)

    @property
    def m(self) -> int:
        return self.B.shape[1]

    def outputs(self, part: slice) -> Rows:
        return Rows(self._c[part], self._d[part])

    def inputs(self, part: slice) -> Rows:
        return Rows(np.zeros((part.stop - part.start, 0)), np.eye(self.m)[part])

    def added_inputs(self, count: int) -> Rows:
        self.B = np.hstack([self.B, np.zeros((self.n, count))])
        return self.inputs(slice(self.m - count, self.m))

    def derivative(self, rows: Rows) -> Rows:
        """Return the time derivative of signals without a direct term."""
        wide = rows.padded(self.n, self.m)
        return Rows(wide.c @ self.A, wide.c @ self.B)

    def low_passes(self, rows: Rows, pole: float, order: int, driven: list[Rows] | None = None) -> list[Rows]:
        r"""Add filters :math:`(a / (s + a))^j`, j = 1 .. order, and return their outputs; ``driven``: more inputs."""
        found: list[Rows] = []
        for j in range(order):
            count, n, m = len(rows), self.n, self.m
            source = (found[-1] if found else rows).padded(n, m)
            more = driven[j].padded(n, m) if driven else Rows(np.zeros((count, n)), np.zeros((count, m)))
            corner = -pole * np.eye(count)
            self.A = np.block([[self.A, np.zeros((n, count))], [pole * source.c + more.c, corner]])
            self.B = np.vstack([self.B, pole * source.d + more.d])
            found.append(Rows(np.hstack([np.zeros((count, n)), np.eye(count)]), np.zeros((count, m))))
        return found
