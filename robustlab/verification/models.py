r"""State-space models whose entries are balls, blocks of Delta, and the form whose definiteness bounds mu.

Stored models are exact; computed ones (a loop's inverse) are ball matrices around the exact model. The loop is
:math:`w = \Delta z,\ z = M w`, singular where :math:`\det(I - M \Delta) = 0`. Block i may have the norm
:math:`1/\ell_i`, with :math:`\ell_i` its level. The theorem about the form, with its proof: theorems.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, arb
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import (
    Matrix,
    adjoint,
    definite,
    diagonal,
    exact,
    identity,
    inverse,
    midpoints,
    part,
    stack,
    zeros,
)
from robustlab.verification.claim import Claim, Work, complex_or_real, real, scalar, whole

TINY = 1e-300  # lower limit of entries in the choice of units of states
SWEEPS = 10  # through all states


@dataclass(frozen=True)
class Model:
    """Ball matrices A (n, n), B (n, m), C (p, n), D (p, m), and dt in seconds (0: continuous)."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    dt: float

    @property
    def n(self) -> int:
        return self.A.nrows()

    @property
    def p(self) -> int:
        return self.D.nrows()

    @property
    def m(self) -> int:
        return self.D.ncols()

    @property
    def size(self) -> int:
        """Rows of the largest matrix in a test, for the effort."""
        return max(self.n, self.m, self.p)


def stored(claim: Claim, name: str = "{}") -> Model:
    """Return the model of the datasets ``name`` with A, B, C, D in place of the braces, and ``dt``."""
    A, B, C, D = (real(claim, name.format(letter), (None, None)) for letter in "ABCD")
    n, (p, m) = len(A), D.shape
    for letter, shape in (("A", (n, n)), ("B", (n, m)), ("C", (p, n))):
        real(claim, name.format(letter), shape)
    return Model(exact(A), exact(B), exact(C), exact(D), scalar(claim, "dt", zero=True))


def loop(claim: Claim) -> Model:
    r"""Return the lower LFT of plant ``P_A ..`` and controller ``K_A ..``, states in this order.

    u = K y (no sign is added) connects the last ``n_meas`` outputs y and ``n_con`` inputs u of the plant. With
    :math:`N = (I - D_{22} D_K)^{-1}`: :math:`y = N (C_2 x + D_{22} C_K x_K + D_{21} w)`, :math:`u = C_K x_K + D_K y`.
    Raises InputError: sizes that do not fit, a loop that was not proved to be well posed.
    """
    P, K = stored(claim, "P_{}"), stored(claim, "K_{}")
    y, u = (int(whole(claim, name, ())) for name in ("n_meas", "n_con"))
    if (K.m, K.p) != (y, u) or y > P.p or u > P.m:
        raise InputError("n_meas, n_con", f"{y}, {u}", "the controller's inputs and outputs, some of the plant's")
    states, w, con = slice(0, P.n), slice(0, P.m - u), slice(P.m - u, P.m)
    z, meas = slice(0, P.p - y), slice(P.p - y, P.p)
    B1, B2 = part(P.B, states, w), part(P.B, states, con)
    C1, C2 = part(P.C, z, states), part(P.C, meas, states)
    D11, D12, D21, D22 = (part(P.D, rows, cols) for rows in (z, meas) for cols in (w, con))
    N = inverse(identity(y) - D22 * K.D)
    if N is None:
        raise InputError("the loop", "I - D22 DK was not proved regular", "a well-posed loop")
    # y = Y_x x + Y_k x_K + Y_w w, and u likewise
    Y_x, Y_k, Y_w = N * C2, N * D22 * K.C, N * D21
    U_x, U_k, U_w = K.D * Y_x, K.C + K.D * Y_k, K.D * Y_w
    A = stack([[P.A + B2 * U_x, B2 * U_k], [K.B * Y_x, K.A + K.B * Y_k]])
    B = stack([[B1 + B2 * U_w], [K.B * Y_w]])
    return Model(A, B, stack([[C1 + D12 * U_x, D12 * U_k]]), D11 + D12 * U_w, P.dt)


def model_of(claim: Claim) -> Model:
    """Return the model: the loop of a plant ``P_A ..``, the difference of ``A1 ..`` and ``A2 ..``, or ``A ..``."""
    there = [name for name in ("P_A", "A1", "A") if name in claim.numbers]
    if len(there) > 1:
        raise InputError("the model", f"the datasets {' and '.join(there)}", "those of one model")
    return {"P_A": loop, "A1": difference}.get("".join(there), stored)(claim)


def static(claim: Claim) -> Model:
    M = complex_or_real(claim, "M", (None, None))
    p, q = M.shape
    return Model(zeros(0, 0), zeros(0, q), zeros(p, 0), exact(M), 0.0)


def difference(claim: Claim) -> Model:
    """Return G1 - G2 of ``A1 .. D1`` and ``A2 .. D2``, states in this order."""
    G1, G2 = stored(claim, "{}1"), stored(claim, "{}2")
    if (G1.p, G1.m) != (G2.p, G2.m):
        raise InputError("D2", f"shape {(G2.p, G2.m)}", f"shape {(G1.p, G1.m)}")
    A = stack([[G1.A, zeros(G1.n, G2.n)], [zeros(G2.n, G1.n), G2.A]])
    return Model(A, stack([[G1.B], [G2.B]]), stack([[G1.C, -G2.C]]), G1.D - G2.D, G1.dt)


def on_the_axis(G: Model) -> Model | None:
    r"""Return the continuous model with the response of the discrete one, :math:`z = (1 + s)/(1 - s)`, or None.

    The angle theta of :math:`z = e^{j\theta}` is at :math:`s = j \tan(\theta/2)`. Proof: :math:`(1 - s)(zI - A) =
    (I + A)(s - A_c)`, and :math:`(1 - s) = (I - A_c) - (s - A_c)`, where :math:`I - A_c = 2 N`; all of these commute.
    None where A was not proved to be free of the eigenvalue -1.
    """
    one = identity(G.n)
    N = inverse(one + G.A)
    if N is None:
        return None
    NB = N * G.B
    return Model(N * (G.A - one), 2 * (N * NB), G.C, G.D - G.C * NB, 0.0)


def reciprocal(G: Model) -> Model | None:
    r"""Return :math:`R(s) = G(1/s)`, so that :math:`G(j\omega) = R(-j/\omega)`; None where A was not proved regular.

    From :math:`(1/s - A)^{-1} = -s (s - A_r)^{-1} A_r` and :math:`s (s - A_r)^{-1} = I + A_r (s - A_r)^{-1}`.
    """
    A_r = inverse(G.A)
    if A_r is None:
        return None
    B_r = A_r * G.B
    return Model(A_r, B_r, -G.C * A_r, G.D - G.C * B_r, 0.0)


def shifted(G: Model, w: float) -> Matrix:
    return exact(1j * w * np.eye(G.n)) - G.A


def gain_exceeds(G: Model, w: float, gamma: float) -> bool:
    r"""Prove :math:`|G(jw) u| > gamma |u|` for the direction u that floating point finds; w = inf: u through D.

    Discrete: at the frequency whose image on the axis (`on_the_axis`) is a double next to that of w. Exact: u is exact,
    the response at it a ball.
    """
    mapped = on_the_axis(G) if G.dt else G
    if mapped is None or not G.m or not G.p:
        return False
    G, w, M = mapped, math.tan(w * G.dt / 2) if G.dt else w, mapped.D
    if np.isfinite(w) and G.n:
        try:
            M = G.D + G.C * shifted(G, w).solve(exact(np.eye(G.n, dtype=complex)) * G.B)
        except ZeroDivisionError:
            return False
    hint = midpoints(M)
    if not np.isfinite(hint).all():
        return False
    u = exact(np.linalg.svd(hint)[2][:1].conj().T)
    response = M * u
    out, into = (adjoint(X) * X for X in (response, u))
    return bool(out[0, 0].real > arb(gamma) ** 2 * into[0, 0].real)


def balanced(G: Model) -> Model:
    """Scale the states by powers of two, exactly, to keep floating-point hints in range; see `exponents`."""
    sizes = [np.abs(midpoints(X)) for X in (G.A, G.B, G.C)]
    if not all(np.isfinite(X).all() for X in sizes):
        return G
    np.fill_diagonal(sizes[0], 0.0)
    unit = exponents(*sizes)
    T, back = (diagonal([arb(2) ** int(sign * x) for x in unit]) for sign in (1, -1))
    return Model(T * G.A * back, T * G.B, G.C * back, G.D, G.dt)


def exponents(A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exponents of two (n,) for the rows of A and B that make each as large as its column in A and C."""
    A, B, C = (np.log2(np.maximum(X, TINY)) for X in (A, B, C))
    unit = np.zeros(len(A))
    for i in list(range(len(A))) * SWEEPS:
        row = max((A[i] + unit[i] - unit).max(initial=-np.inf), B[i].max(initial=-np.inf) + unit[i])
        column = max((A[:, i] - unit[i] + unit).max(initial=-np.inf), C[:, i].max(initial=-np.inf) - unit[i])
        unit[i] += np.rint((column - row) / 2) if np.isfinite(column - row) else 0
    return unit


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
