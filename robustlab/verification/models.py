r"""State-space models whose entries are balls: stored, in feedback with a controller, subtracted, or mapped.

.. math:: \dot x = A x + B u, \quad y = C x + D u \qquad (\text{discrete: } x^+ = A x + B u)

Stored models are exact; computed ones (a loop's inverse) are ball matrices around the exact model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from flint import arb
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import (
    Matrix,
    adjoint,
    diagonal,
    exact,
    identity,
    inverse,
    midpoints,
    part,
    stack,
    zeros,
)
from robustlab.verification.claim import Claim, complex_or_real, real, scalar, whole

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
    """Return the matrix ``M`` (p, q), real or complex, as a model without states."""
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

    With :math:`N = (I + A)^{-1}`: :math:`A_c = N (A - I)`, :math:`B_c = 2 N^2 B`, :math:`C_c = C`,
    :math:`D_c = D - C N B`. The angle theta of :math:`z = e^{j\theta}` is at :math:`s = j \tan(\theta/2)`.
    Proof: :math:`(1 - s)(zI - A) = (I + A)(s - A_c)`, and :math:`(1 - s) = (I - A_c) - (s - A_c)`, where
    :math:`I - A_c = 2 N`; all of these commute. None where A was not proved to be free of the eigenvalue -1.
    """
    one = identity(G.n)
    N = inverse(one + G.A)
    if N is None:
        return None
    NB = N * G.B
    return Model(N * (G.A - one), 2 * (N * NB), G.C, G.D - G.C * NB, 0.0)


def reciprocal(G: Model) -> Model | None:
    r"""Return :math:`R(s) = G(1/s)`, so that :math:`G(j\omega) = R(-j/\omega)`; None where A was not proved regular.

    :math:`A_r = A^{-1}`, :math:`B_r = A^{-1} B`, :math:`C_r = -C A^{-1}`, :math:`D_r = D - C A^{-1} B`, from
    :math:`(1/s - A)^{-1} = -s (s - A_r)^{-1} A_r` and :math:`s (s - A_r)^{-1} = I + A_r (s - A_r)^{-1}`.
    """
    A_r = inverse(G.A)
    if A_r is None:
        return None
    B_r = A_r * G.B
    return Model(A_r, B_r, -G.C * A_r, G.D - G.C * B_r, 0.0)


def shifted(G: Model, w: float) -> Matrix:
    """Return the ball matrix ``j w - A`` at the exact frequency ``w``."""
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
    """Scale the states by powers of two so that each one's row, without the diagonal of A, is as large as its column.

    Exact; it keeps floating-point hints in range.
    """
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
