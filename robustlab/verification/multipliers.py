r"""Integral quadratic constraints of the block types of Delta, with checks that multipliers belong to their classes.

.. math:: \int_0^\infty v^T M v \, dt \ge 0 \quad\text{for all } z \in L_2,\ w = \Delta(z)

zeta is a signal filtered by 1, :math:`\frac{a}{s+a}, .., (\frac{a}{s+a})^\nu`, a > 0, from zero states. All matrices X
and Q below are positive definite, Y is skew; X counts once for each channel of a full block. Each constraint holds for
tau times the block, too, tau from 0 to 1.

- Time-invariant block (nu), or one that varies (nu = 0): :math:`\zeta_z^T X \zeta_z - \zeta_w^T X \zeta_w`. Of a
  linear block of gain at most one: in the frequency domain :math:`\psi^* X \psi \ge 0` is a scaling that commutes.
- Real number in [-1, 1], constant or (nu = 0) varying: also :math:`2 \zeta_z^T Y \zeta_w`, of which the integral is 0.
- Real number with :math:`|\dot\delta| \le \rho`: both with :math:`\zeta_w` driven by
  :math:`\rho r_j = \dot\delta \zeta_{z,j}`, so that :math:`\zeta_w = \delta \zeta_z` at each instant; the same two
  constraints state :math:`r = (\dot\delta/\rho) \zeta_z`, from the first power of the filter on.
- Law in the sector [-1, 1]: :math:`x (z^2 - w^2)`, x > 0. Steady, and z without a direct term: :math:`2 x w \dot z`, x
  of either sign, whose integral is that of the law from z(0) = 0 to :math:`z(\infty) = 0` (Popov).
- Law with slopes in [m, k]: p = k z - w and q = w - m z do not fall with z, so (Zames, Falb 1968)
  :math:`2 \int p (x_0 q - h * q)\, dt \ge 0` where :math:`\|h\|_1 \le x_0` and h >= 0 (or the law is odd). Here
  h = h_+ - h_- (h_- of odd laws only), each :math:`a e^{-at}(s^T Q_1 s + at\, s^T Q_2 s)`, :math:`s_i = (at)^i/i!`, of
  both directions of time. As the integral of :math:`a e^{-at} (at)^l/l!` is one, the norm is at most the sum of all
  coefficients. A law that is not steady has h = 0.

References
----------
Megretski, Rantzer, IEEE TAC 42 (1997); Jonsson, "Stability analysis with Popov multipliers and IQCs", Systems & Control
Letters 31 (1997); Zames, Falb, SIAM J. Control 6 (1968); Koroglu, Scherer, "Robust performance analysis for structured
linear time-varying perturbations with bounded rates-of-variation", IEEE TAC 52 (2007): the swapping lemma.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import Matrix, definite, exact, part, stack, zeros
from robustlab.verification.claim import Claim, Work, real, whole
from robustlab.verification.forms import FULL, REAL, Block
from robustlab.verification.models import Model

CONSTANT, VARYING, SECTOR, SLOPE = 0, 1, 2, 3


@dataclass(frozen=True)
class Nature:
    """The type of a block, for a law whether it is odd and steady, and its numbers in the model's units."""

    kind: int
    odd: bool
    steady: bool
    range: tuple[float, float]  # of a real block
    slope: tuple[float, float]  # of a law of the kind SLOPE
    rate: float  # of change, per second; inf: no bound

    def order(self, order: int) -> int:
        """Return the highest power of a filter that its constraints allow."""
        fast = self.kind == VARYING and math.isinf(self.rate)
        return 0 if fast or self.kind == SECTOR or (self.kind == SLOPE and not self.steady) else order


def read_natures(claim: Claim, blocks: Sequence[Block]) -> list[Nature]:
    """Read ``nature`` (k, 3): kind, odd, steady; ``ranges``, ``slope`` (k, 2), ``rate`` (k,)."""
    k = len(blocks)
    table, rates = whole(claim, "nature", (k, 3)).tolist(), real(claim, "rate", (k,), infinite=True).tolist()
    ranges, slopes = (real(claim, name, (k, 2)).tolist() for name in ("ranges", "slope"))
    result: list[Nature] = []
    for block, (kind, odd, steady), (a, b), (m, n), rate in zip(blocks, table, ranges, slopes, rates, strict=True):
        number = block.kind == REAL
        fits = [
            kind in (CONSTANT, VARYING) or (kind in (SECTOR, SLOPE) and number and block.w.stop - block.w.start == 1),
            {odd, steady} <= {0, 1},
            a < b if number else (a, b) == (-1, 1),
            kind != SLOPE or m <= a < b <= n,
            rate > 0 and (math.isinf(rate) or (kind == VARYING and number)),
        ]
        if not all(fits):
            found = f"{[kind, odd, steady]}, range {a}, {b}, slope {m}, {n}, rate {rate}"
            raise InputError("nature", f"{found} of a block of kind {block.kind}", "a class of the theorem")
        result.append(Nature(kind, bool(odd), bool(steady), (a, b), (m, n), rate))
    return result


class Multipliers:
    """Reader of the numbers of all multipliers in their order; proves definiteness where it is required."""

    def __init__(self, values: NDArray[np.float64], work: Work) -> None:
        self.values, self.at, self.work, self.positive = values, 0, work, True

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next numbers. InputError: there are fewer."""
        self.at += count
        if self.at > len(self.values):
            raise InputError("multipliers", f"{len(self.values)} numbers", f"{self.at} or more")
        return self.values[self.at - count : self.at]

    def skew(self, size: int) -> NDArray[np.float64]:
        """Read a skew matrix, the entries above its diagonal row by row."""
        X = np.zeros((size, size))
        X[np.triu_indices(size, 1)] = self.take(size * (size - 1) // 2)
        return X - X.T

    def definite(self, size: int) -> NDArray[np.float64]:
        """Read a symmetric matrix, its upper triangle row by row, and prove it positive definite."""
        X = np.zeros((size, size))
        X[np.triu_indices(size)] = self.take(size * (size + 1) // 2)
        X = X + np.triu(X, 1).T
        self.work.spend(size)
        self.positive = self.positive and definite(exact(X)).proved
        return X


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


def scaled(above: Matrix, below: Matrix, size: int, copies: tuple[int, int], number: bool, x: Multipliers) -> Matrix:
    """Return X on ``above`` minus X on ``below``; of a real number plus Y between them."""
    X = x.definite(size)
    over, under = (exact(np.kron(X, np.eye(k))) for k in copies)
    S = above.transpose() * over * above - below.transpose() * under * below
    if number:
        cross = above.transpose() * exact(x.skew(size)) * below
        S = S + cross + cross.transpose()
    return S


def linear(F: Filtered, block: Block, order: int, pole: float, rho: arb | None, x: Multipliers) -> Matrix:
    """Return the constraints of a linear block; ``rho``: the bound of the rate of a number with filters."""
    z, w = F.output(block.z), F.input(block.w)
    kz, kw, number = z.nrows(), w.nrows(), block.kind == REAL
    behind_z = F.stages(z, pole, order)
    moved = F.added(order * kz) if rho is not None else None
    shares = [slice(j * kz, (j + 1) * kz) for j in range(order)]
    driven = [] if moved is None else [part(moved, rows, slice(None)) * rho for rows in shares]
    behind_w = F.stages(w, pole, order, driven)
    above, below = _stacked([z, *behind_z]), _stacked([w, *behind_w])
    full = block.kind == FULL
    S = scaled(above, below, order + 1 if full else (order + 1) * kz, (kz, kw) if full else (1, 1), number, x)
    return S if moved is None else S + scaled(_stacked(behind_z), moved, order * kz, (1, 1), number, x)


def law(
    F: Filtered, block: Block, nature: Nature, order: int, pole: float, free: tuple[bool, bool], x: Multipliers
) -> Matrix:
    """Return the constraints of a law; ``free``: z has no direct term from any block, none from any input."""
    z, w = F.output(block.z), F.input(block.w)
    S = zeros(F.width, F.width)
    if not free[0] and nature.kind == SECTOR:
        raise InputError("nature", "a law without a slope that acts on its own input at once", "a law with a slope")
    if free[0]:
        S = S + (z.transpose() * z - w.transpose() * w) * arb(x.definite(1)[0, 0])
    if free[1] and nature.steady:
        pair = F.derivative(block.z).transpose() * w * arb(x.take(1)[0])
        S = S + pair + pair.transpose()
    if nature.kind == SECTOR:
        return S
    (a, b), (m, n) = nature.range, nature.slope
    middle, half = (arb(a) + arb(b)) / 2, (arb(b) - arb(a)) / 2
    p, q = z * ((arb(n) - middle) / half) - w, w - z * ((arb(m) - middle) / half)
    behind_q, behind_p, direct = F.stages(q, pole, order), F.stages(p, pole, order), arb(x.take(1)[0])
    signs = (1, -1) if nature.odd else (1,)
    kernels = [[(sign, _kernel(x, order)) for sign in signs] for _ in range(2 if order else 0)]  # both ways of time
    x.positive = x.positive and bool(direct > sum((c for way in kernels for _, h in way for c in h), arb(0)))
    pair = p.transpose() * q * direct
    for way, one, behind in zip(kernels, (p, q), (behind_q, behind_p), strict=False):
        for sign, h in way:
            for c, stage in zip(h, behind, strict=True):
                pair = pair - one.transpose() * stage * (c * sign)
    return S + pair + pair.transpose()


def _kernel(x: Multipliers, order: int) -> list[arb]:
    """Read the coefficients of ``a e^-at (at)^l / l!``, l = 0, .., order - 1, of Q_1 and, from order 2 on, Q_2."""
    h = [arb(0)] * order
    for shift in range(min(order, 2)):
        size = (order - 1 - shift) // 2 + 1
        Q = x.definite(size)
        for i in range(size):
            for j in range(size):
                times = math.factorial(i + j + shift) // (math.factorial(i) * math.factorial(j))
                h[i + j + shift] += arb(Q[i, j]) * times
    return h


def _stacked(rows: Sequence[Matrix]) -> Matrix:
    return stack([[X] for X in rows])
