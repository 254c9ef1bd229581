r"""Gain and stability of loops with blocks that vary or are nonlinear: one matrix inequality for all frequencies.

The theorem, its proof and the constraints of each block type are in theorems.md, in the same symbols. The
loop is w = Delta(z), from the model's first inputs and outputs; the others, u and y, are the performance. A real block
is :math:`c z + s h\, \delta(z)`, c and h middle and half width of its range, s the ``size``; other blocks are s times a
unit one. So the unit blocks close the model of `mu.within_box` with its columns times s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from flint import arb
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import Matrix, definite, exact, identity, part, stack, zeros
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar, symmetric, whole
from robustlab.verification.models import FULL, REAL, Block, Model, model_of, placed, read_shapes
from robustlab.verification.mu import within_box
from robustlab.verification.norms import climb, stable

CONSTANT, VARYING, SECTOR, SLOPE = 0, 1, 2, 3


@dataclass(frozen=True)
class BlockType:
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


def read_block_types(claim: Claim, blocks: Sequence[Block]) -> list[BlockType]:
    """Read ``nature`` (k, 3): kind, odd, steady; ``ranges``, ``slope`` (k, 2), ``rate`` (k,)."""
    k = len(blocks)
    table, rates = whole(claim, "nature", (k, 3)).tolist(), real(claim, "rate", (k,), infinite=True).tolist()
    ranges, slopes = (real(claim, name, (k, 2)).tolist() for name in ("ranges", "slope"))
    result: list[BlockType] = []
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
        result.append(BlockType(kind, bool(odd), bool(steady), (a, b), (m, n), rate))
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
    F: Filtered, block: Block, block_type: BlockType, order: int, pole: float, free: tuple[bool, bool], x: Multipliers
) -> Matrix:
    """Return the constraints of a law; ``free``: z has no direct term from any block, none from any input."""
    z, w = F.output(block.z), F.input(block.w)
    S = zeros(F.width, F.width)
    if not free[0] and block_type.kind == SECTOR:
        raise InputError("nature", "a law without a slope that acts on its own input at once", "a law with a slope")
    if free[0]:
        S = S + (z.transpose() * z - w.transpose() * w) * arb(x.definite(1)[0, 0])
    if free[1] and block_type.steady:
        pair = F.derivative(block.z).transpose() * w * arb(x.take(1)[0])
        S = S + pair + pair.transpose()
    if block_type.kind == SECTOR:
        return S
    (a, b), (m, n) = block_type.range, block_type.slope
    middle, half = (arb(a) + arb(b)) / 2, (arb(b) - arb(a)) / 2
    p, q = z * ((arb(n) - middle) / half) - w, w - z * ((arb(m) - middle) / half)
    behind_q, behind_p, direct = F.stages(q, pole, order), F.stages(p, pole, order), arb(x.take(1)[0])
    signs = (1, -1) if block_type.odd else (1,)
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


HIGHEST = 8  # power of a filter


def prove_multipliers(claim: Claim, work: Work, gain: bool) -> Verdict:
    """Prove by the theorem that the ``gain`` of the set is at most ``gamma``, or that it is stable at ``size``.

    The model of datasets ``A .. D`` (or a loop) has the channels of ``blocks`` first. ``pole`` is a, ``order`` nu;
    ``multipliers`` holds the numbers of each block's constraints in the order of the theory's table, triangles row by
    row; ``P`` belongs to the states of the model, then those of the filters of each block, of z (q) before w (p).
    """
    given, table = model_of(claim), read_shapes(claim)
    rows, cols = (sum(row[k] for row in table) for k in (1, 2))
    if given.dt or rows > given.m or cols > given.p or (not gain and (rows, cols) != (given.m, given.p)):
        raise InputError("A .. D", f"{given.p} x {given.m}, dt {given.dt}", f"continuous, with {rows} w and {cols} z")
    blocks = placed(table, [1.0] * len(table))
    block_types, order, pole = read_block_types(claim, blocks), int(whole(claim, "order", ())), scalar(claim, "pole")
    if not 0 <= order <= HIGHEST:
        raise InputError("order", f"{order}", f"0 to {HIGHEST}")
    size, gamma = (1.0, scalar(claim, "gamma")) if gain else (scalar(claim, "size"), 0.0)
    orders = [block_type.order(order) for block_type in block_types]
    rated = [n.kind == VARYING and k > 0 for n, k in zip(block_types, orders, strict=True)]
    kz, kw = ([s.stop - s.start for s in side] for side in ([b.z for b in blocks], [b.w for b in blocks]))
    filters = sum(k * (i + j) for k, i, j in zip(orders, kz, kw, strict=True))
    extra = sum(k * i for k, i, r in zip(orders, kz, rated, strict=True) if r)
    n = given.n + filters
    P, values = symmetric(claim, "P", n), real(claim, "multipliers", (None,))

    def attempt() -> Verdict:
        free = [_free(model_of(claim), block.z, rows) for block in blocks]
        G = _about_the_middles(model_of(claim), blocks, block_types, rows, size)
        if G is None:
            return not_proved("the set's middle was not proved to be well posed")
        verdict = stable(G, work)
        if not verdict.proved:
            return verdict
        F, x = Filtered(G, filters, extra), Multipliers(values, work)
        S = zeros(F.width, F.width)
        for i, (block, block_type) in enumerate(zip(blocks, block_types, strict=True)):
            rho = (
                arb(block_type.rate) * 2 / (arb(block_type.range[1]) - arb(block_type.range[0])) / arb(size)
                if rated[i]
                else None
            )
            if block_type.kind in (SECTOR, SLOPE):
                S = S + law(F, block, block_type, orders[i], pole, free[i], x)
            else:
                S = S + linear(F, block, orders[i], pole, rho, x)
        if x.at != len(values):
            raise InputError("multipliers", f"{len(values)} numbers", f"{x.at}")
        if not x.positive:
            return not_proved("a multiplier was not proved to be one of its class")
        motion = F.units(0, n).transpose() * exact(P) * stack([[rate] for rate in F.rates])
        y, u = F.output(slice(cols, G.p)), F.input(slice(rows, G.m))
        work.spend(F.width)
        form = u.transpose() * u * arb(gamma) ** 2 - motion - motion.transpose() - S - y.transpose() * y
        answer = definite(form)
        if answer.proved:
            return PROVED
        return not_proved(f"the inequality's smallest eigenvalue is {answer.least:.3g} of its size")

    return climb(attempt)


def _free(G: Model, z: slice, w: int) -> tuple[bool, bool]:
    """Test whether the rows z of D are exactly zero: those from the first w inputs, and all."""
    entries = [[x == 0 for x in line] for line in part(G.D, z, slice(None)).tolist()]
    return all(all(line[:w]) for line in entries), all(all(line) for line in entries)


def _about_the_middles(
    G: Model, blocks: Sequence[Block], block_types: Sequence[BlockType], w: int, size: float
) -> Model | None:
    """Return the model in feedback with the w unit blocks; None where it was not proved to be well posed."""
    z = blocks[-1].z.stop if blocks else 0
    rest = Block(FULL, slice(w, G.m), slice(z, G.p), 1.0)
    inside = within_box(G, [*blocks, rest], [*(n.range for n in block_types), (-1.0, 1.0)])
    if inside is None:
        return None
    scale = identity(G.m)
    for i in range(w):
        scale[i, i] = arb(size)
    return replace(inside, B=inside.B * scale, D=inside.D * scale)
