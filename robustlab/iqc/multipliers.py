r"""Multipliers: integral quadratic constraints of blocks, with unknowns.

.. math:: \int_0^\infty v^T M v \, dt \ge 0, \qquad v = \Psi (z, w), \quad M = M(\lambda) \text{ linear}

for all z in L2 and w the block's output. `v` are rows of a `FilteredModel`. The filters are the basis
:math:`\psi = (1, \frac{a}{s + a}, \dots, (\frac{a}{s + a})^\nu)`, or static for arbitrarily fast blocks.

===============================  ======================================================================================
block                            constraint
===============================  ======================================================================================
dynamics, time-invariant         :math:`\psi z^T X \psi z - \psi w^T X \psi w`, X >= 0: every D(jw) >= 0 of these
                                 poles is :math:`\psi^* X \psi`
real constant parameter          the same, and :math:`2 \psi z^T Y \psi w` with :math:`Y = -Y^T`
varying arbitrarily fast         the same with :math:`\nu = 0`
real parameter of bounded rate   the swapping lemma: :math:`\delta \psi z = \psi w + T (\dot\delta \, T_b z)`, T from
                                 the filters' states on; :math:`\dot\delta T_b z` is a separate input
sector [-1, 1]                   :math:`x (z^2 - w^2)`, x >= 0
the same, steady (Popov)         :math:`2 x w \dot z`, x of either sign, z without a direct term
slope in [m, k] (Zames, Falb)    :math:`2 p (x_0 - h *) q`, p = k z - w, q = w - m z, :math:`\|h\|_1 \le x_0`, h of both
                                 directions of time, h >= 0 unless the law is odd
===============================  ======================================================================================

The homotopy condition of Megretski and Rantzer holds for all of them: with each block, tau times it belongs to the
class for every tau in [0, 1], so it satisfies the same constraint.

References
----------
Megretski, Rantzer 1997; Jönsson 1997 (Popov); Zames, Falb 1968; Chen, Wen 1995; Helmersson 1999, Köroğlu, Scherer 2007
(bounded rates); Veenman, Scherer, Köroğlu, "Robust stability and performance analysis based on IQCs", 2016.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.iqc.block_types import Nonlinearity
from robustlab.iqc.filtered_model import FilteredModel, Rows, stacked

__all__ = ["POPOV", "Basis", "Term", "nonlinear_terms", "rate_terms", "repeated_terms", "symmetric"]

POPOV = "Popov"  # the kind of a constraint on a derivative


@dataclass(frozen=True)
class Basis:
    """Pole a in rad/s and highest power of ``a / (s + a)``."""

    pole: float
    order: int


@dataclass(frozen=True, eq=False)
class Term:
    """One constraint: its signals v, M, and matrices that must be >= 0, both linear in ``count`` unknowns."""

    block: str
    kind: str
    rows: Rows
    count: int
    middle: Callable[[Array], Array]
    positive: Callable[[Array], list[Array]]


def symmetric(x: Array, size: int) -> Array:
    """Return the symmetric matrix of an upper triangle, row by row."""
    found = np.zeros((size, size))
    found[np.triu_indices(size)] = x
    return found + np.triu(found, 1).T


def _skew(x: Array, size: int) -> Array:
    found = np.zeros((size, size))
    found[np.triu_indices(size, 1)] = x
    return found - found.T


def _triangle(size: int) -> int:
    return size * (size + 1) // 2


def _scaled(
    name: str, kind: str, above: Rows, below: Rows, size: int, real: bool, copies: tuple[int, int] = (1, 1)
) -> Term:
    """``above^T X above - below^T X below`` with X >= 0, and for a real scalar ``2 above^T Y below``.

    X has ``size`` rows; each of its entries is multiplied by the identity of size ``copies`` (of z, of w).
    """
    n_x = _triangle(size)

    def middle(x: Array) -> Array:
        X = symmetric(x[:n_x], size)
        over, under = np.kron(X, np.eye(copies[0])), np.kron(X, np.eye(copies[1]))
        cross = _skew(x[n_x:], size) if real else np.zeros((len(over), len(under)))
        return np.block([[over, cross], [cross.T, -under]])

    count = n_x + (size * (size - 1) // 2 if real else 0)
    return Term(name, kind, stacked(above, below), count, middle, lambda x: [symmetric(x[:n_x], size)])


# --- linear blocks ----------------------------------------------------------------------------------------------------


def repeated_terms(
    model: FilteredModel, name: str, z: Rows, w: Rows, basis: Basis, *, scalar: bool, real: bool
) -> list[Term]:
    """Return the terms of a block of gain one, a scalar (real or not) or a full one; order 0 where it varies."""
    above = stacked(z, *model.low_passes(z, basis.pole, basis.order))
    below = stacked(w, *model.low_passes(w, basis.pole, basis.order))
    kind = ("real parameter" if real else "dynamics") + ("" if basis.order else ", static multiplier")
    copies = (1, 1) if scalar else (len(z), len(w))
    size = (basis.order + 1) * (len(z) if scalar else 1)
    return [_scaled(name, kind, above, below, size, real, copies)]


def rate_terms(model: FilteredModel, name: str, z: Rows, w: Rows, basis: Basis, rate: float) -> list[Term]:
    """Return the terms of a real scalar whose rate is at most ``rate`` per second."""
    order, count = basis.order, len(z)
    stages = model.low_passes(z, basis.pole, order)
    slow = model.added_inputs(order * count)  # delta' x / rate, x the states of the stages
    parts = [Rows(slow.c[i : i + count], rate * slow.d[i : i + count]) for i in range(0, order * count, count)]
    moved = model.low_passes(w, basis.pole, order, parts)
    size = (order + 1) * count
    above, below, states = stacked(z, *stages), stacked(w, *moved), stacked(*stages)
    return [
        _scaled(name, "real parameter", above, below, size, True),
        _scaled(name, "its rate", states, slow, order * count, True),
    ]


# --- nonlinearities ---------------------------------------------------------------------------------------------------


def nonlinear_terms(
    model: FilteredModel, name: str, z: Rows, w: Rows, basis: Basis, law: Nonlinearity, loops: bool
) -> list[Term]:
    """Return the terms of a memoryless law of sector [-1, 1]; ``loops``: whether z depends on a block without delay.

    With such a dependence only constraints are used that hold for differences of two signals too: these make the loop
    well posed.
    """
    found: list[Term] = []
    if not loops:
        found.append(_single(name, "sector", stacked(z, w), np.diag([1.0, -1.0]), True))
    if law.steady and not z.d.any():
        swap = np.array([[0.0, 1.0], [1.0, 0.0]])
        found.append(_single(name, POPOV, stacked(model.derivative(z), w), swap, False))
    if law.slope is not None:
        m, k = law.slope
        order = basis.order if law.steady else 0
        found.append(_zames_falb(model, name, z, w, Basis(basis.pole, order), (m, k), law.odd))
    return found


def _single(name: str, kind: str, rows: Rows, M: Array, signed: bool) -> Term:
    """Return the term ``x M`` with one unknown, which must be positive where ``signed``."""
    return Term(name, kind, rows, 1, lambda x: x[0] * M, lambda x: [x.reshape(1, 1)] if signed else [])


def _zames_falb(
    model: FilteredModel, name: str, z: Rows, w: Rows, basis: Basis, slope: tuple[float, float], odd: bool
) -> Term:
    (m, k), order = slope, basis.order
    p, q = w.plus(k, z, -1.0), w.plus(-m, z)
    stages = [*model.low_passes(q, basis.pole, order), *model.low_passes(p, basis.pole, order)]
    grams = [((order - 1) // 2 + 1), ((order - 2) // 2 + 1)] if order else []
    each = [s for s in grams if s]
    signs = [1.0, -1.0] if odd else [1.0]
    per_kernel = sum(map(_triangle, each))

    def split(x: Array) -> list[list[Array]]:
        """Return the Gram matrices of every kernel: causal (each sign), anticausal (each sign)."""
        found, at = [], 1
        for _ in range(2 * len(signs) if order else 0):
            parts = []
            for size in each:
                parts.append(symmetric(x[at : at + _triangle(size)], size))
                at += _triangle(size)
            found.append(parts)
        return found

    def middle(x: Array) -> Array:
        ways, half = [_coefficients(parts, order) for parts in split(x)], len(signs)
        causal = sum((s * c for s, c in zip(signs, ways[:half], strict=False)), np.zeros(order))
        anti = sum((s * c for s, c in zip(signs, ways[half:], strict=False)), np.zeros(order))
        found = np.zeros((2 + 2 * order, 2 + 2 * order))
        found[0, 1] = x[0]
        found[0, 2 : 2 + order] = -causal  # p (h * q)
        found[1, 2 + order :] = -anti  # q (h~ * p)
        return found + found.T

    def positive(x: Array) -> list[Array]:
        parts = split(x)
        mass = sum(float(_coefficients(part, order).sum()) for part in parts)
        return [np.array([[x[0] - mass]]), *(gram for part in parts for gram in part)]

    count = 1 + (2 * len(signs) * per_kernel if order else 0)
    kind = "Zames-Falb" if order else "slope, static multiplier"
    return Term(name, kind, stacked(p, q, *stages), count, middle, positive)


def _coefficients(grams: list[Array], order: int) -> Array:
    r"""Compute c of :math:`h(t) = a e^{-a t} \sum_j c_j (a t)^j / j!` from Gram matrices.

    Its polynomial is :math:`s^T Q_1 s + a t \, s^T Q_2 s` with :math:`s_i = (a t)^i / i!`: every polynomial that is
    nonnegative for t >= 0 has this form.
    """
    found = np.zeros(order)
    for shift, gram in enumerate(grams):
        for i in range(len(gram)):
            for j in range(len(gram)):
                found[i + j + shift] += (
                    gram[i, j] * math.factorial(i + j + shift) / math.factorial(i) / math.factorial(j)
                )
    return found
