r"""Low-order LFTs of matrices that are polynomials of real parameters with numeric coefficients.

.. math:: N(t) = \sum_\alpha t^\alpha N_\alpha, \qquad
          N = N_0 + t_k \, L \, Q(t) = \begin{bmatrix} I & t_k L \end{bmatrix} \begin{bmatrix} N_0 \\ Q \end{bmatrix}
          \quad \text{or} \quad
          N = N_0 + t_k \, Q(t) \, R = \begin{bmatrix} N_0 & Q \end{bmatrix} \begin{bmatrix} I \\ t_k R \end{bmatrix}

with a constant L or R of the smallest rank r, by which :math:`t_k` is repeated r times; what is left goes through the
same step until it is constant. Where N is affine, r is the rank of :math:`N_k` and no LFT of N has fewer. It is the
decomposition of `robustlab.uncertainty.decomposition_tree` for coefficients that are not exact: ranks are those of
numbers with rounding.

References
----------
Cockburn, Morton, "Linear fractional representations of uncertain systems", Automatica 33 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from robustlab.arrays import Array
from robustlab.uncertainty.decomposition_tree import ConstantLft
from robustlab.uncertainty.tuning import TUNING

# The power of each variable, in the order of the polynomial's names.
Exponents = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class MatrixPolynomial:
    """A matrix polynomial.

    Attributes
    ----------
    names
        The variables.
    terms
        Exponents -> coefficient (m, n); the constant one is always there.
    """

    names: tuple[str, ...]
    terms: Mapping[Exponents, Array]

    def __call__(self, t: Array) -> Array:
        """The matrix (m, n) at t, shape (number of names,)."""
        powers = [np.prod(np.power(t, exponents)) for exponents in self.terms]
        return np.tensordot(np.array(powers), np.stack(list(self.terms.values())), 1)


def polynomial_lft(polynomial: MatrixPolynomial, scale: Array, tolerance: float) -> ConstantLft:
    """The smallest LFT ``w = diag(t_k I) z`` of a polynomial that a few orders of the variables give.

    Parameters
    ----------
    scale
        Natural magnitude of each entry, an outer product ``rows cols^T`` of positive numbers, (m, n).
    tolerance
        What is below this share of the natural magnitude is rounding, where ranks are taken.

    Examples
    --------
    >>> product = MatrixPolynomial(("a", "b"), {(0, 0): np.ones((1, 1)), (1, 1): np.array([[0.5]])})
    >>> lft = polynomial_lft(product, np.ones((1, 1)), 1e-12)
    >>> sorted(lft.names)
    ['a', 'b']
    """
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
    if math.factorial(min(count, 20)) <= TUNING.variable_orders:
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
    quotient = {_lower(e, k): part for e, part in terms.items() if e[k]}
    rest = {zero: np.zeros((m, n))} | {e: part for e, part in terms.items() if not e[k]}
    parts, size = list(quotient.values()), len(quotient)
    left, below = rank_factors(np.hstack(parts), tolerance)
    beside, right = rank_factors(np.vstack(parts), tolerance)
    r = min(left.shape[1], right.shape[0])
    if left.shape[1] <= right.shape[0]:
        low = dict(zip(quotient, np.hsplit(below, size), strict=True))
        stacked = {e: np.vstack([_at(rest, e, (m, n)), _at(low, e, (r, n))]) for e in {**rest, **low}}
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
    stacked = {e: np.hstack([_at(rest, e, (m, n)), _at(wide, e, (m, r))]) for e in {**rest, **wide}}
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


def _lower(exponents: Exponents, k: int) -> Exponents:
    return (*exponents[:k], exponents[k] - 1, *exponents[k + 1 :])


def _at(terms: Mapping[Exponents, Array], exponents: Exponents, shape: tuple[int, int]) -> Array:
    return terms[exponents] if exponents in terms else np.zeros(shape)


def rank_factors(matrix: Array, tolerance: float) -> tuple[Array, Array]:
    """``matrix = left @ right`` with as few columns of left as its entries above the tolerance ask for.

    By elimination with full pivoting, which leaves zeros of rows and columns exact, where an SVD would not. The parts
    of a pivot are of one size.
    """
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
