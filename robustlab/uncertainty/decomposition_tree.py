"""Low-order LFTs of matrices of polynomials: structured tree decomposition.

Cockburn, Morton, Automatica 33 (1997); Varga, Looye, "Symbolic and numerical software tools for LFT-based low order
uncertainty modeling" (1999).
"""

# One step takes a variable out of every term that contains it, and shares what is left: M = M0 + v L R = [I, v L]
# [M0; R] with a constant L (rows), or [M0, L] [I; v R] with a constant R (columns), of the smallest inner size r; v
# then stands r times. The stacked matrix goes through the same step until it is constant, so that equal sub-
# expressions of different entries are realised once. Which variable comes first decides how many repetitions come
# out; several orders are tried. Of Laurent polynomials with exact coefficients ranks are exact, of polynomials with
# numeric ones they are those of numbers with rounding. Where M is affine in v, no LFT has fewer repetitions.

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.uncertainty.laurent import Laurent, Monomial, times

# Orders of the variables in which a decomposition is tried: more find smaller LFTs, in as many times the work.
VARIABLE_ORDERS = 24

# A matrix of polynomials: monomial -> {(row, column): coefficient}.
Terms = dict[Monomial, dict[tuple[int, int], Fraction]]


@dataclass(frozen=True)
class ConstantLft:
    """A constant matrix with Delta channels: ``z = d11 w + d12 u``, ``y = d21 w + d22 u``, ``w = Delta z``."""

    names: tuple[str, ...]
    d11: Array
    d12: Array
    d21: Array
    d22: Array

    @property
    def T(self) -> ConstantLft:
        """The transposed LFT: a product with the gain at the inputs is one at the outputs."""
        return ConstantLft(self.names, self.d11.T, self.d21.T, self.d12.T, self.d22.T)

    def inverse(self) -> ConstantLft:
        """The LFT of the inverse of a 1 x 1 matrix, not zero at Delta = 0."""
        gain = _floats(np.linalg.inv(self.d22))
        out = -gain @ self.d21
        return ConstantLft(self.names, self.d11 + self.d12 @ out, self.d12 @ gain, out, gain)

    def repeated(self, count: int) -> ConstantLft:
        """``count`` copies side by side, block-diagonal."""
        eye = np.eye(count)
        parts = (_floats(np.kron(eye, part)) for part in (self.d11, self.d12, self.d21, self.d22))
        return ConstantLft(self.names * count, *parts)


@dataclass(frozen=True)
class _Step:
    """One variable taken out: L (rows) or R (columns) is the constant factor, (r x ..) times."""

    variable: str
    inverted: bool
    rows: bool
    factor: Array


@dataclass(frozen=True)
class Plan:
    """Steps from the outside to the inside, and the constant matrix that is left; ``size`` counts the repetitions."""

    steps: tuple[_Step, ...]
    core: Array
    size: int


def plans(matrix: Sequence[Sequence[Laurent]], weight: Callable[[str], int], shape: tuple[int, int]) -> list[Plan]:
    """Ways to decompose a matrix, the smallest first."""
    terms: Terms = {}
    for i, row in enumerate(matrix):
        for j, entry in enumerate(row):
            for monomial, c in entry.terms.items():
                terms.setdefault(monomial, {})[i, j] = c
    variables = sorted({name for monomial in terms for name, _ in monomial})
    found = [_plan(terms, shape, weight, None)]
    for order in islice(permutations(variables), VARIABLE_ORDERS):
        if found[0].size > sum(weight(v) for v in variables):
            found.append(_plan(terms, shape, weight, order))
    distinct = {(plan.size, len(plan.steps)): plan for plan in reversed(found)}
    return sorted(distinct.values(), key=lambda plan: plan.size)


def _plan(terms: Terms, shape: tuple[int, int], weight: Callable[[str], int], order: Sequence[str] | None) -> Plan:
    steps: list[_Step] = []
    size = 0
    while any(terms):
        choices = []
        for variable, inverted in sorted({(name, e < 0) for monomial in terms for name, e in monomial}):
            step, left, new_shape, count = _taken_out(terms, shape, variable, inverted)
            saved = (_occurrences(terms, weight) - _occurrences(left, weight)) / (count * weight(variable))
            rank = 0 if order is None else -order.index(variable)
            choices.append(((rank, saved, -len(choices)), step, left, new_shape, count))
        _, step, terms, shape, count = max(choices, key=lambda choice: choice[0])
        size += count * weight(step.variable)
        steps.append(step)
    core = np.zeros(shape)
    for (i, j), c in terms.get((), {}).items():
        core[i, j] = float(c)
    return Plan(tuple(steps), core, size)


def _occurrences(terms: Terms, weight: Callable[[str], int]) -> int:
    return sum(sum(abs(e) * weight(name) for name, e in monomial) * len(entries) for monomial, entries in terms.items())


def _taken_out(
    terms: Terms, shape: tuple[int, int], variable: str, inverted: bool
) -> tuple[_Step, Terms, tuple[int, int], int]:
    """The step for one variable, the stacked matrix that is left, its shape, and the inner size r."""
    down: Monomial = ((variable, 1 if inverted else -1),)
    rest: Terms = {}
    part: Terms = {}
    for monomial, entries in terms.items():
        e = dict(monomial).get(variable, 0)
        if (e < 0) if inverted else (e > 0):
            part[times(monomial, down)] = entries
        else:
            rest[monomial] = entries
    by_row = _row_factors(part, shape[0])
    turned = {m: {(j, i): c for (i, j), c in entries.items()} for m, entries in part.items()}
    by_col = _row_factors(turned, shape[1])
    (r_row, size_row), (r_col, size_col) = (
        (factor.shape[1], sum(map(len, terms.values()))) for factor, terms in (by_row, by_col)
    )
    rows = (r_row, size_row) <= (r_col, size_col)
    (factor, shared), (n, m) = by_row if rows else by_col, shape
    stacked = {monomial: dict(entries) for monomial, entries in rest.items()}
    for monomial, entries in shared.items():
        moved = {((n + i, j) if rows else (j, m + i)): c for (i, j), c in entries.items()}
        stacked.setdefault(monomial, {}).update(moved)
    r, step = factor.shape[1], _Step(variable, inverted, rows, factor if rows else factor.T)
    return step, stacked, (n + r, m) if rows else (n, m + r), r


def _row_factors(part: Terms, n_rows: int) -> tuple[Array, Terms]:
    """``part = L R`` with constant L (n_rows, r) and R made of r rows of ``part``, r the rank of its rows (exact)."""
    rows: dict[int, dict[tuple[Monomial, int], Fraction]] = {}
    for monomial, entries in part.items():
        for (i, j), c in entries.items():
            rows.setdefault(i, {})[monomial, j] = c
    kept: list[int] = []
    echelon: list[tuple[tuple[Monomial, int], dict[tuple[Monomial, int], Fraction], dict[int, Fraction]]] = []
    weights: dict[int, dict[int, Fraction]] = {}
    for i in sorted(rows, key=lambda k: (len(rows[k]), k)):  # short rows first: they become the shared ones
        left, combination = dict(rows[i]), {}
        for pivot, row, made_of in echelon:
            if pivot not in left:
                continue
            share = left[pivot] / row[pivot]
            for key, c in row.items():
                value = left.get(key, Fraction(0)) - share * c
                left.pop(key, None)
                if value:
                    left[key] = value
            for k, c in made_of.items():
                combination[k] = combination.get(k, Fraction(0)) + share * c
        if not left:
            weights[i] = combination
            continue
        position = len(kept)
        kept.append(i)
        weights[i] = {position: Fraction(1)}
        own = {k: -c for k, c in combination.items()}
        own[position] = Fraction(1)
        echelon.append((min(left), left, own))
    factor = np.zeros((n_rows, len(kept)))
    for i, combination in weights.items():
        for k, c in combination.items():
            factor[i, k] = float(c)
    position_of = {i: k for k, i in enumerate(kept)}
    shared: Terms = {}
    for monomial, entries in part.items():
        chosen = {(position_of[i], j): c for (i, j), c in entries.items() if i in position_of}
        if chosen:
            shared[monomial] = chosen
    return factor, shared


def assemble(plan: Plan, gains: Mapping[tuple[str, bool], ConstantLft]) -> ConstantLft:
    """The LFT of a plan, from the 1 x 1 LFT of every variable (and of its inverse: True)."""
    n_y, n_u = plan.core.shape
    lft = ConstantLft((), np.zeros((0, 0)), np.zeros((0, n_u)), np.zeros((n_y, 0)), plan.core)
    for step in reversed(plan.steps):
        r = step.factor.shape[1] if step.rows else step.factor.shape[0]
        gain = gains[step.variable, step.inverted].repeated(r)
        lft = _after(lft, gain, step.factor) if step.rows else _after(lft.T, gain.T, step.factor.T).T
    return lft


def _floats(matrix: NDArray[Any]) -> Array:
    return np.asarray(matrix, dtype=np.float64)


def _after(inner: ConstantLft, gain: ConstantLft, left: Array) -> ConstantLft:
    """``[I, left gain] @ inner``: the last r outputs of inner go through the gain."""
    n = left.shape[0]
    n_w, r_w = inner.d21[:n], inner.d21[n:]
    n_u, r_u = inner.d22[:n], inner.d22[n:]
    old, new = len(inner.names), len(gain.names)
    return ConstantLft(
        inner.names + gain.names,
        np.block([[inner.d11, np.zeros((old, new))], [gain.d12 @ r_w, gain.d11]]),
        np.vstack([inner.d12, gain.d12 @ r_u]),
        np.hstack([n_w + left @ gain.d22 @ r_w, left @ gain.d21]),
        n_u + left @ gain.d22 @ r_u,
    )


# The power of each variable, in the order of the polynomial's names.
Exponents = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class MatrixPolynomial:
    """A matrix polynomial."""

    names: tuple[str, ...]  # the variables
    terms: Mapping[Exponents, Array]  # exponents -> coefficient (m, n); the constant one is always there

    def __call__(self, t: Array) -> Array:
        """The matrix (m, n) at t, shape (number of names,)."""
        powers = [np.prod(np.power(t, exponents)) for exponents in self.terms]
        return np.tensordot(np.array(powers), np.stack(list(self.terms.values())), 1)


def polynomial_lft(polynomial: MatrixPolynomial, scale: Array, tolerance: float) -> ConstantLft:
    """The smallest LFT ``w = diag(t_k I) z`` of a polynomial that a few orders of the variables give."""
    rows, cols = scale[:, 0], scale[0] / scale[0, 0]
    plain = {e: part / scale for e, part in polynomial.terms.items()}
    count = len(polynomial.names)
    best: tuple[list[int], ConstantLft] | None = None
    affine = all(sum(e) <= 1 for e in plain)
    for order in [range(count)] if affine else _orders(count):
        found = _expanded(plain, order, tolerance)
        if best is None or len(found[0]) < len(best[0]):
            best = found
    assert best is not None
    channels, lft = best
    names = tuple(polynomial.names[k] for k in channels)
    return ConstantLft(names, lft.d11, lft.d12 * cols, rows[:, None] * lft.d21, lft.d22 * scale)


def _orders(count: int) -> list[Sequence[int]]:
    """Orders of the variables: all, or forwards and backwards with each one put first and last."""
    every = range(count)
    if math.factorial(min(count, 20)) <= VARIABLE_ORDERS:
        return list(permutations(every))
    turned: list[Sequence[int]] = [list(every), list(reversed(every))]
    moved = [made for k in every for made in ([k, *(j for j in every if j != k)], [*(j for j in every if j != k), k])]
    return [*turned, *moved]


def _expanded(
    terms: Mapping[Exponents, Array], order: Sequence[int], tolerance: float
) -> tuple[list[int], ConstantLft]:
    """The variable of each channel, and the LFT; the first variable of the order that occurs is taken out first."""
    occurring = {k for exponents in terms for k, e in enumerate(exponents) if e}
    (m, n), zero = next(iter(terms.values())).shape, (0,) * len(order)
    if not occurring:
        nothing = np.zeros((0, 0)), np.zeros((0, n)), np.zeros((m, 0))
        return [], ConstantLft((), *nothing, terms.get(zero, np.zeros((m, n))))
    k = next(v for v in order if v in occurring)
    quotient = {(*e[:k], e[k] - 1, *e[k + 1 :]): part for e, part in terms.items() if e[k]}
    rest = {zero: np.zeros((m, n))} | {e: part for e, part in terms.items() if not e[k]}
    parts, size = list(quotient.values()), len(quotient)
    left, below = rank_factors(np.hstack(parts), tolerance)
    beside, right = rank_factors(np.vstack(parts), tolerance)
    r = min(left.shape[1], right.shape[0])
    if left.shape[1] <= right.shape[0]:
        low = dict(zip(quotient, np.hsplit(below, size), strict=True))
        stacked = {e: np.vstack([rest.get(e, np.zeros((m, n))), low.get(e, np.zeros((r, n)))]) for e in {**rest, **low}}
        names, lft = _expanded(stacked, order, tolerance)
        q = len(names)
        # z = the last r outputs, y += left w
        return [k] * r + names, ConstantLft(
            (),
            np.block([[np.zeros((r, r)), lft.d21[m:]], [np.zeros((q, r)), lft.d11]]),
            np.vstack([lft.d22[m:], lft.d12]),
            np.hstack([left, lft.d21[:m]]),
            lft.d22[:m],
        )
    wide = dict(zip(quotient, np.vsplit(beside, size), strict=True))
    stacked = {e: np.hstack([rest.get(e, np.zeros((m, n))), wide.get(e, np.zeros((m, r)))]) for e in {**rest, **wide}}
    names, lft = _expanded(stacked, order, tolerance)
    q = len(names)
    # z = right xi, w enters by the last r inputs
    return [k] * r + names, ConstantLft(
        (),
        np.block([[np.zeros((r, r)), np.zeros((r, q))], [lft.d12[:, n:], lft.d11]]),
        np.vstack([right, lft.d12[:, :n]]),
        np.hstack([lft.d22[:, n:], lft.d21]),
        lft.d22[:, :n],
    )


def rank_factors(matrix: Array, tolerance: float) -> tuple[Array, Array]:
    """``matrix = left @ right`` with as few columns of left as its entries above the tolerance ask for."""
    # Elimination with full pivoting leaves zeros of rows and columns exact, where an SVD would not.
    rest = matrix.copy()
    columns, rows = [np.zeros((len(matrix), 0))], [np.zeros((0, matrix.shape[1]))]
    while np.abs(rest).max(initial=0.0) > tolerance:
        i, j = np.unravel_index(np.argmax(np.abs(rest)), rest.shape)
        root, sign = np.sqrt(abs(rest[i, j])), np.sign(rest[i, j])
        column, row = rest[:, [j]] / root, rest[[i], :] * (sign / root)
        columns.append(column)
        rows.append(row)
        rest = rest - column @ row
        rest[i, :], rest[:, j] = 0.0, 0.0
    return np.hstack(columns), np.vstack(rows)
