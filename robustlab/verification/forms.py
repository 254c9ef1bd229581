r"""Blocks of Delta, their scalings, and the form whose definiteness bounds mu.

The loop is :math:`w = \Delta z,\ z = M w`, singular where :math:`\det(I - M \Delta) = 0`. Block i may have the norm
:math:`1/\ell_i`, with :math:`\ell_i` its level; L is diag(level) on the channels of w.

Theorem. Let D_w, D_z, G have the structure (below), D_w > 0, and

.. math:: F = L D_w L - M^* D_z M - j (G M - M^* G^*) > 0 .

Then :math:`\det(I - M \Delta) \ne 0` for all Delta of the structure with :math:`\|\Delta_i\| \le 1/\ell_i`.

Proof. Else there is a z with :math:`z = M \Delta z \ne 0`; put :math:`w = \Delta z`, so z = M w and w is not zero. Then

.. math:: w^* F w = w^* L D_w L w - z^* D_z z - j (w^* G z - z^* G^* w) ,

a sum over the blocks. The part of a full block (both D a multiple d > 0 of the identity, G = 0) is
:math:`d (\ell^2 |w_i|^2 - |z_i|^2) \le 0`. In a repeated scalar block :math:`w_i = \delta z_i` and D_w = D_z = D > 0:
:math:`(\ell^2 |\delta|^2 - 1)\, z_i^* D z_i \le 0`; of a real one delta is real and G = G^*, and the last term is
:math:`-j \delta z_i^* (G - G^*) z_i = 0`; of a complex one G = 0. So the sum is not above zero: a contradiction. The
sign before j is of no importance, as -G has the structure too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, arb
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import Matrix, adjoint, definite, diagonal, exact, identity, part
from robustlab.verification.claim import Claim, Work, complex_or_real, real, whole

REAL, COMPLEX, FULL = 0, 1, 2


@dataclass(frozen=True)
class Block:
    """One block of Delta: its kind, its rows (channels of w), its columns (of z), its level."""

    kind: int
    w: slice
    z: slice
    level: float


def read_shapes(claim: Claim, kinds: Sequence[int] = (REAL, COMPLEX, FULL)) -> list[list[int]]:
    """Return ``[kind, rows, cols]`` of each block; InputError for another kind, or a scalar that is not square."""
    table = whole(claim, "blocks", (None, 3)).tolist()
    for kind, rows, cols in table:
        if kind not in kinds or rows < 1 or cols < 1 or not (rows == cols or kind == FULL):
            raise InputError("blocks", f"{[kind, rows, cols]}", "kind 0, 1 (square) or 2 with its rows and columns")
    return table


def read_blocks(claim: Claim, q: int, p: int) -> list[Block]:
    """Return the blocks of a Delta (q, p) with their levels; InputError where they do not fill it exactly."""
    table = read_shapes(claim)
    result = placed(table, _levels(claim, len(table)))
    found = (result[-1].w.stop, result[-1].z.stop) if result else (0, 0)
    if found != (q, p):
        raise InputError("blocks", f"rows and columns in all {found}", f"{(q, p)}")
    return result


def placed(table: Sequence[Sequence[int]], levels: Sequence[float]) -> list[Block]:
    """Return blocks ``[kind, rows, cols]`` in this order, with consecutive channels."""
    result: list[Block] = []
    row = col = 0
    for (kind, rows, cols), level in zip(table, levels, strict=True):
        result.append(Block(kind, slice(row, row + rows), slice(col, col + cols), level))
        row, col = row + rows, col + cols
    return result


def _levels(claim: Claim, k: int) -> list[float]:
    level = claim.numbers.get("level")
    shape = (k,) if isinstance(level, np.ndarray) and level.ndim else ()
    values = np.broadcast_to(real(claim, "level", shape), (k,)).tolist()
    if not all(value > 0 for value in values):
        raise InputError("level", "a number not above zero", "numbers above zero")
    return values


@dataclass(frozen=True)
class Form:
    """F of the theorem as a function of M, from scalings whose structure was checked."""

    weighted: Matrix  # L D_w L, (q, q)
    D_z: Matrix  # (p, p)
    G: Matrix | None  # (q, p); None: zero

    def of(self, M: Matrix) -> Matrix:
        """Return F of a matrix M (p, q), shape (q, q)."""
        result = self.weighted - adjoint(M) * (self.D_z * M)
        if self.G is None:
            return result
        cross = self.G * M
        return result - acb(0, 1) * (cross - adjoint(cross))

    def of_sum(self, D: Matrix, C: Matrix) -> Quadratic:
        """Return F as a function of X (n, q), with ``M = D + C X``."""
        C_star = adjoint(C)
        linear = C_star * (self.D_z * D)
        if self.G is not None:
            linear = linear - acb(0, 1) * (C_star * adjoint(self.G))
        return Quadratic(self.of(D), linear, C_star * (self.D_z * C))


@dataclass(frozen=True)
class Quadratic:
    """``constant - (X^* linear + linear^* X) - X^* square X``, constant and square Hermitian."""

    constant: Matrix
    linear: Matrix
    square: Matrix

    def at(self, X: Matrix) -> Matrix:
        half = adjoint(X) * (self.linear + self.square * X * arb(0.5))
        return self.constant - half - adjoint(half)


def read_scalings(claim: Claim, q: int, p: int, *front: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return ``D_w`` (q, q), ``D_z`` (p, p), ``G`` (q, p) of a claim, with these leading axes."""
    D_w, D_z = (complex_or_real(claim, name, (*front, n, n)) for name, n in (("D_w", q), ("D_z", p)))
    return D_w, D_z, complex_or_real(claim, "G", (*front, q, p))


def scaled_form(
    blocks: Sequence[Block], D_w: NDArray[Any], D_z: NDArray[Any], G: NDArray[Any], work: Work
) -> Form | None:
    """Return the form of these scalings; None where D_w > 0 was not proved. InputError: another structure."""
    check_scalings(blocks, D_w, D_z, G)
    work.spend(len(D_w))
    if not definite(exact(D_w)).proved:
        return None
    L = diagonal([arb(block.level) for block in blocks for _ in range(block.w.start, block.w.stop)])
    return Form(L * exact(D_w) * L, exact(D_z), exact(G) if G.any() else None)


def gain_form(m: int, p: int, gamma: float) -> Form:
    """Return the form of the norm, :math:`gamma^2 I - M^* M`: one full block (m, p) of level gamma, D = 1."""
    return Form(identity(m) * arb(gamma) ** 2, identity(p), None)


def check_scalings(blocks: Sequence[Block], D_w: NDArray[Any], D_z: NDArray[Any], G: NDArray[Any]) -> None:
    """Check the theorem's structure of D_w, D_z, G to the last bit, except for D_w > 0."""
    for i, block in enumerate(blocks):
        w, z = D_w[block.w, block.w], D_z[block.z, block.z]
        if block.kind == FULL:
            d = w[0, 0]
            fits = np.imag(d) == 0 and _equal(w, d * np.eye(len(w))) and _equal(z, d * np.eye(len(z)))
        else:
            fits = _equal(w, w.conj().T) and _equal(w, z)
        if not fits:
            raise InputError(f"D of block {i}", "not of the structure", "what belongs to its kind, to the last bit")
        g = G[block.w, block.z]
        if not (_equal(g, g.conj().T) if block.kind == REAL else not g.any()):
            raise InputError(f"G of block {i}", "not of the structure", "Hermitian (real blocks), else zero")
    pairs = [(D_w, "w", "w"), (D_z, "z", "z"), (G, "w", "z")]
    for name, (X, rows, cols) in zip(("D_w", "D_z", "G"), pairs, strict=True):
        rest = X.copy()
        for block in blocks:
            rest[getattr(block, rows), getattr(block, cols)] = 0
        if rest.any():
            raise InputError(name, "entries outside the blocks", "zeros there")


def _equal(X: NDArray[Any], Y: NDArray[Any]) -> bool:
    return X.shape == Y.shape and bool((X == Y).all())


def check_delta(blocks: Sequence[Block], delta: NDArray[Any]) -> None:
    """Check the blocks' structure of ``delta`` (q, p) to the last bit."""
    rest = delta.copy()
    for i, block in enumerate(blocks):
        own: Any = delta[block.w, block.z]
        scalar = _equal(own, own[0, 0] * np.eye(len(own))) if block.kind != FULL else True
        if not scalar or (block.kind == REAL and own.imag.any()):
            raise InputError(f"delta of block {i}", "not of the structure", "what its kind allows, to the last bit")
        rest[block.w, block.z] = 0
    if rest.any():
        raise InputError("delta", "entries outside the blocks", "zeros there")


def within(blocks: Sequence[Block], delta: Matrix, allowance: arb, work: Work) -> bool:
    """Prove that each block of every Delta in the balls (of the structure) has norm <= ``allowance / level``."""
    for block in blocks:
        own, limit = part(delta, block.w, block.z), allowance / arb(block.level)
        if block.kind != FULL:
            if not own[0, 0].abs_upper() <= limit:
                return False
            continue
        work.spend(own.ncols())
        if not definite(identity(own.ncols()) * limit**2 - adjoint(own) * own).proved:
            return False
    return True
