"""A model with the filters of its multipliers: one set of states, and rows for every weighted signal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from flint import arb

from robustlab.verification.balls import Matrix, exact, part, stack, zeros
from robustlab.verification.models import Model


class Filtered:
    """The model with the filters of its constraints; a signal is a matrix of rows over (x, q).

    ``filters`` states and ``extra`` inputs are the totals, so that every row has its final length.
    """

    def __init__(self, G: Model, filters: int, extra: int) -> None:
        self.n, self.inputs, self.width = G.n + filters, G.m + extra, G.n + filters + G.m + extra
        self.G, self.rates = G, [self._wide(G.A, G.B)]
        self.states, self.used = G.n, G.m

    def _wide(self, C: Matrix, D: Matrix) -> Matrix:
        gap, rest = self.n - C.ncols(), self.inputs - D.ncols()
        return stack([[C, zeros(C.nrows(), gap), D, zeros(C.nrows(), rest)]])

    def units(self, first: int, count: int) -> Matrix:
        """Entries of (x, q) themselves."""
        return exact(np.eye(self.width)[first : first + count])

    def output(self, rows: slice) -> Matrix:
        return self._wide(part(self.G.C, rows, slice(None)), part(self.G.D, rows, slice(None)))

    def input(self, cols: slice) -> Matrix:
        return self.units(self.n + cols.start, cols.stop - cols.start)

    def added(self, count: int) -> Matrix:
        self.used += count
        return self.units(self.n + self.used - count, count)

    def stages(self, signal: Matrix, pole: float, order: int, driven: Sequence[Matrix] = ()) -> list[Matrix]:
        """Return the signal behind each power of ``a / (s + a)``; ``driven``: a further input of each stage."""
        found: list[Matrix] = []
        for j in range(order):
            own, source = self.units(self.states, signal.nrows()), found[-1] if found else signal
            rate = (source - own) * arb(pole)
            self.rates.append(rate + driven[j] if driven else rate)
            self.states += signal.nrows()
            found.append(own)
        return found

    def derivative(self, rows: slice) -> Matrix:
        """Return the derivative of outputs without a direct term."""
        return part(self.G.C, rows, slice(None)) * self.rates[0]
