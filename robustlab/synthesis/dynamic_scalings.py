r"""Rational scalings D(s), G(s) of a block structure that prove a bound of mu at every frequency at once.

A full block of r x c has one scalar factor d(s), on c outputs and r inputs. A scalar repeated r times has
``D(s) = diag(d_1 .. d_r) T`` with a constant unit upper triangular T. Every factor is

.. math:: d(s) = k \prod_i \frac{s / z_i + 1}{s / p_i + 1}
    \prod_j \frac{s^2 / \omega_{zj}^2 + 2 \zeta_{zj} s / \omega_{zj} + 1}
                 {s^2 / \omega_{pj}^2 + 2 \zeta_{pj} s / \omega_{pj} + 1}

with at most one first-order section; all its numbers are positive, so that d and 1/d are stable by construction, and
their logarithms are free parameters. Real scalars also carry an odd function

.. math:: \hat g(s) = \sum_i \frac{c_i a_i s}{s^2 - a_i^2}, \qquad \hat g(j \omega) = -j g(\omega)

as normalised coprime factors ``g = G_N / G_M``, ``|G_M|^2 + |G_N|^2 = 1``. With them

.. math:: \| D_z M D_w^{-1} G_M / \beta - G_N \|_\infty \le 1 \quad \Rightarrow \quad \sup_\omega \mu(M) \le \beta .

References
----------
Young, "Robustness with parametric and dynamic uncertainty", PhD thesis (1993), chapter 9; Fan, Tits, Doyle (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, block_slices, structure_size

__all__ = ["BlockScaling", "DynamicScalings", "Factor", "Realisation", "reference_block", "unit_scalings"]

Array = NDArray[Any]
Realisation = tuple[Array, Array, Array, Array]


@dataclass(frozen=True)
class Factor:
    """One scalar factor d(s) by its logarithms; 2 numbers a first-order section, 4 a second-order one.

    Attributes
    ----------
    log_gain
        ``log d(0)``.
    sections
        ``(log z, log p)`` or ``(log w_z, log 2 zeta_z, log w_p, log 2 zeta_p)``, frequencies in rad/s; sections of
        second order come first.
    """

    log_gain: float = 0.0
    sections: tuple[tuple[float, ...], ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(len(section) // 2 for section in self.sections)

    def parameters(self) -> list[float]:
        """All logarithms in a row."""
        return [self.log_gain, *(value for section in self.sections for value in section)]

    def with_parameters(self, values: Iterator[float]) -> Factor:
        """The same form with the next numbers of ``values``."""
        gain = float(next(values))
        return Factor(gain, tuple(tuple(float(next(values)) for _ in section) for section in self.sections))

    def with_section(self, log_zero: float, log_pole: float) -> Factor:
        """One order higher: times ``(s/z + 1) / (s/p + 1)``; two sections of first order become one of second."""
        last = self.sections[-1] if self.sections else ()
        if len(last) != 2:
            return Factor(self.log_gain, (*self.sections, (log_zero, log_pole)))
        merged: list[float] = []
        for one, two in ((last[0], log_zero), (last[1], log_pole)):
            middle = 0.5 * (one + two)  # (s/z1 + 1)(s/z2 + 1): w = sqrt(z1 z2), 2 zeta = (z1 + z2) / w
            merged += [middle, float(np.logaddexp(one, two) - middle)]
        return Factor(self.log_gain, (*self.sections[:-1], tuple(merged)))

    def realisation(self) -> Realisation:
        """States, input, output and direct term of d(s), sections in series."""
        A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[np.exp(self.log_gain)]])
        for section in self.sections:
            a, b, c, d = _section(section)
            n, m = len(A), len(a)
            A = np.block([[A, np.zeros((n, m))], [b @ C, a]])
            B, C, D = np.vstack([B, b @ D]), np.hstack([d * C, c]), d * D
        return A, B, C, D

    def log_modulus(self, omega: Array) -> Array:
        """``log |d(j omega)|``, shape (n_omega,)."""
        result = np.full(len(omega), self.log_gain)
        for section in self.sections:
            half = len(section) // 2
            result += _log_modulus(section[:half], omega) - _log_modulus(section[half:], omega)
        return result


def _section(values: tuple[float, ...]) -> Realisation:
    if len(values) == 2:
        zero, pole = np.exp(values)
        d = pole / zero
        return np.array([[-pole]]), np.array([[pole]]), np.array([[1 - d]]), np.array([[d]])
    w_z, two_z, w_p, two_p = np.exp(values)
    d = (w_p / w_z) ** 2
    A = np.array([[0.0, w_p], [-w_p, -two_p * w_p]])
    return A, np.array([[0.0], [w_p]]), np.array([[1 - d, two_z * w_p / w_z - d * two_p]]), np.array([[d]])


def _log_modulus(values: tuple[float, ...], omega: Array) -> Array:
    with np.errstate(over="ignore"):
        ratio = omega / np.exp(values[0])
        if len(values) == 1:
            return 0.5 * np.log1p(ratio**2)
        return 0.5 * np.log((1 - ratio**2) ** 2 + (np.exp(values[1]) * ratio) ** 2)


@dataclass(frozen=True, eq=False)
class BlockScaling:
    """Scalings of one block.

    Attributes
    ----------
    factors
        One for a full block, one a channel for a repeated scalar, none for the block whose D is one.
    mixing
        Entries of T above the diagonal, row by row.
    g
        For each channel of a real scalar its terms ``(c, log a)``.
    """

    factors: tuple[Factor, ...]
    mixing: tuple[float, ...] = ()
    g: tuple[tuple[tuple[float, float], ...], ...] = ()

    @property
    def order(self) -> int:
        """Orders of all factors."""
        return sum(factor.order for factor in self.factors)

    def triangular(self) -> Array:
        """T, shape (r, r)."""
        r = len(self.factors)
        T = np.eye(r)
        if self.mixing:
            T[np.triu_indices(r, 1)] = self.mixing
        return T


@dataclass(frozen=True, eq=False)
class DynamicScalings:
    """D(s) and G(s) of a whole structure; see the module's docstring."""

    blocks: tuple[Block, ...]
    parts: tuple[BlockScaling, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        """Order of D, and of G, that each block brings."""
        return tuple(part.order + 2 * sum(map(len, part.g)) for part in self.parts)

    @property
    def n_states(self) -> int:
        """Number of states that a plant gets when it is scaled."""
        total = 0
        for block, part in zip(self.blocks, self.parts, strict=True):
            sides = block.rows + block.cols if isinstance(block, FullBlock) else 2
            total += part.order * sides + 2 * sum(map(len, part.g))
        return total

    @property
    def mixed(self) -> bool:
        """Whether there is a G."""
        return any(terms for part in self.parts for terms in part.g)

    def parameters(self) -> Array:
        """All free parameters, shape (n_theta,)."""
        values: list[float] = []
        for part in self.parts:
            for factor in part.factors:
                values += factor.parameters()
            values += part.mixing
            values += [value for terms in part.g for term in terms for value in term]
        return np.array(values)

    def with_parameters(self, theta: Array) -> DynamicScalings:
        """The same form with other parameters."""
        values = iter(theta)
        parts = []
        for part in self.parts:
            factors = tuple(factor.with_parameters(values) for factor in part.factors)
            mixing = tuple(float(next(values)) for _ in part.mixing)
            g = tuple(tuple((float(next(values)), float(next(values))) for _ in terms) for terms in part.g)
            parts.append(BlockScaling(factors, mixing, g))
        return replace(self, parts=tuple(parts))

    def with_part(self, index: int, part: BlockScaling) -> DynamicScalings:
        """With the scalings of one block replaced."""
        return replace(self, parts=(*self.parts[:index], part, *self.parts[index + 1 :]))

    def to_json(self) -> list[dict[str, object]]:
        """For each block its factors (log gain, sections), mixing and terms of G."""
        return [
            {
                "block": block.name,
                "factors": [{"log_gain": f.log_gain, "sections": f.sections} for f in part.factors],
                "mixing": part.mixing,
                "g": part.g,
            }
            for block, part in zip(self.blocks, self.parts, strict=True)
        ]

    def on_outputs(self) -> Realisation:
        """``D_z(s)``, shape (p, p)."""
        p = structure_size(self.blocks)[1]
        pieces: list[tuple[Realisation, slice, slice]] = []
        for block, part, (_, z) in self._with_slices():
            pieces += [
                (factor.realisation(), slice(i, i + 1), slice(i, i + 1))
                for factor, i in _channels(block, part, z.start, block.cols)
            ]
        A, B, C, D = _placed(pieces, p, p, _ones(self, 1))
        T = self._mixing(1)
        return A, B @ T, C, D @ T

    def on_inputs(self) -> Realisation:
        """``D_w(s)^{-1}``, shape (q, q)."""
        q = structure_size(self.blocks)[0]
        pieces: list[tuple[Realisation, slice, slice]] = []
        for block, part, (w, _) in self._with_slices():
            for factor, i in _channels(block, part, w.start, block.rows):
                a, b, c, d = factor.realisation()
                inverse = (a - b @ c / d, b / d, -c / d, 1 / d)
                pieces.append((inverse, slice(i, i + 1), slice(i, i + 1)))
        A, B, C, D = _placed(pieces, q, q, _ones(self, 0))
        back = np.linalg.inv(self._mixing(0))
        return A, B, back @ C, back @ D

    def coprime(self) -> tuple[Array, Array, Array, Array]:
        """``(A, B, F, C)`` with ``G_M = I + F (sI - A)^-1 B`` (q x q) and ``G_N = C (sI - A)^-1 B`` (p x q)."""
        q, p = structure_size(self.blocks)
        pieces = []
        for _, part, (w, z) in self._with_slices():
            pieces += [(_coprime(terms), w.start + i, z.start + i) for i, terms in enumerate(part.g) if terms]
        n = sum(len(piece[0][0]) for piece in pieces)
        A, B, F, C = np.zeros((n, n)), np.zeros((n, q)), np.zeros((q, n)), np.zeros((p, n))
        at = 0
        for (a, b, f, c), i, j in pieces:
            m = len(a)
            A[at : at + m, at : at + m], B[at : at + m, i] = a, b[:, 0]
            F[i, at : at + m], C[j, at : at + m] = f[0], c[0]
            at += m
        return A, B, F, C

    def _with_slices(self) -> list[tuple[Block, BlockScaling, tuple[slice, slice]]]:
        return list(zip(self.blocks, self.parts, block_slices(self.blocks), strict=True))

    def _mixing(self, side: int) -> Array:
        T = np.eye(structure_size(self.blocks)[side])
        for _, part, where in self._with_slices():
            if part.mixing:
                T[where[side], where[side]] = part.triangular()
        return T


def _channels(block: Block, part: BlockScaling, start: int, size: int) -> list[tuple[Factor, int]]:
    """Each factor with each of its channels; the one factor of a full block comes once for every channel."""
    if not part.factors:
        return []
    factors = part.factors * size if isinstance(block, FullBlock) else part.factors
    return [(factor, start + i) for i, factor in enumerate(factors)]


def _ones(scalings: DynamicScalings, side: int) -> list[int]:
    """Channels of blocks whose D is one."""
    slices = block_slices(scalings.blocks)
    return [
        i
        for part, where in zip(scalings.parts, slices, strict=True)
        if not part.factors
        for i in range(where[side].start, where[side].stop)
    ]


def _placed(pieces: list[tuple[Realisation, slice, slice]], rows: int, cols: int, ones: list[int]) -> Realisation:
    n = sum(len(piece[0][0]) for piece in pieces)
    A, B, C, D = np.zeros((n, n)), np.zeros((n, cols)), np.zeros((rows, n)), np.zeros((rows, cols))
    D[ones, ones] = 1.0
    at = 0
    for (a, b, c, d), row, col in pieces:
        m = len(a)
        A[at : at + m, at : at + m] = a
        B[at : at + m, col], C[row, at : at + m], D[row, col] = b, c, d
        at += m
    return A, B, C, D


@lru_cache(maxsize=4096)
def _coprime(terms: tuple[tuple[float, float], ...]) -> tuple[Array, Array, Array, Array]:
    r"""Normalised right coprime factors of ghat, from the stabilising solution of its control Riccati equation."""
    from robustlab.matrix_equations import care

    n = 2 * len(terms)
    A, B, C = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    for i, (c, log_a) in enumerate(terms):
        a = np.exp(log_a)
        # x2 = a s / (s^2 - a^2) u
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, a], [a, 0.0]]
        B[2 * i + 1, 0], C[0, 2 * i + 1] = a, c
    F = care(A, B, C.T @ C, np.eye(1)).gain
    return A + B @ F, B, F, C


def reference_block(blocks: Sequence[Block]) -> int | None:
    """The block whose D is one: of those with a scalar D the one whose D would cost most states; None: none has one."""
    scalar = [
        (block.rows + block.cols, i)
        for i, block in enumerate(blocks)
        if isinstance(block, FullBlock) or block.rows == 1
    ]
    return max(scalar)[1] if scalar else None


def unit_scalings(blocks: Sequence[Block]) -> DynamicScalings:
    """D = I, G = 0."""
    one = reference_block(blocks)
    parts = []
    for i, block in enumerate(blocks):
        r = 1 if isinstance(block, FullBlock) else block.rows
        factors = () if i == one else (Factor(),) * r
        g = ((),) * r if isinstance(block, RealScalar) else ()
        parts.append(BlockScaling(factors, (0.0,) * (r * (r - 1) // 2), g))
    return DynamicScalings(tuple(blocks), tuple(parts))
