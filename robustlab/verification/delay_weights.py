r"""Weights that bound the error of a rational delay, for every delay of a range and at every frequency.

At each frequency :math:`|e^{-j\omega\tau} - R|` is largest at an end of the range of tau, unless the arc of all
:math:`e^{-j\omega\tau}` contains the point opposite to R; and it is never above 1 + |R|. So below a frequency both ends
are tested in boxes of the model :math:`[e^{-s\tau} - R;\; W]` with its exact delay, and so is the arc; above it the
weight exceeds 1 + |R|, a statement about rational models (`axis`).

**Boxes.** With the states x and the outputs w of the delays as unknowns, H = (A B_1; C_1 D_11),
:math:`M(s) = D + C F(s)^{-1} B,\ F(s) = \mathrm{diag}(s I, e^{s \tau_i}) - H`. For :math:`\omega = \omega_0 + r e,\
|e| \le 1`: :math:`F(j\omega) = F_0 + N(e)`, N diagonal, :math:`N = \sum_{k \ge 1} N_k e^k`, and by Taylor's rest
:math:`|N(e) - \sum_{k<i} N_k e^k| \le T_i |e|^i`, with :math:`T_1 = r\,\mathrm{diag}(I, \tau)`, :math:`T_i =
\mathrm{diag}(0, (r \tau)^i / i!)`. With :math:`R = F_0^{-1}`, :math:`X_0 = R B`, :math:`X_k = -R \sum_{1 \le i \le k}
N_i X_{k-i}`, put :math:`F^{-1} B = \sum_{k<K} X_k e^k + e^K Z`. Then :math:`|F Z| \le Q = \sum_{k<K} T_{K-k} |X_k|`
entry by entry, so :math:`|Z| \le |R| Q + |R| T_1 |Z|`, and `neumann` bounds Z, proves the spectral radius of
:math:`|R| T_1` below one, and so F regular in the box.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat

from robustlab.errors import InputError
from robustlab.verification.axis import axis
from robustlab.verification.balls import (
    INDEFINITE,
    Definite,
    Matrix,
    definite,
    diagonal,
    exact,
    identity,
    inverse,
    magnitudes,
    midpoints,
    rounded_up,
    stack,
    zeros,
)
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar
from robustlab.verification.forms import Form
from robustlab.verification.models import Model, stored
from robustlab.verification.norms import climb
from robustlab.verification.stability import stable

DEGREE = 3  # of a polynomial before its remainder: beyond it a box grows by less than its cost
REACH = 0.6  # half width of a box over the distance of the nearest pole, at most: the ratio of the series
MARGIN = 1e-4  # by which a proposed bound of a remainder exceeds its floating-point value
TINY = 1e-300
NARROW = 1e-13  # a box in which M changes by less than this part does not gain from another halving
SMALL = 12  # K for weights: at low frequencies the error is small, the difference of numbers that are not

Test = Callable[[float, float, float, float], Definite]


def prove_delay_weight(claim: Claim, work: Work) -> Verdict:
    r"""Prove that R is stable, and at all frequencies for all tau of the ``range`` (2,), in s

    .. math:: |e^{-j\omega\tau} - R(j\omega)|^2 \le |W(j\omega)|^2 + \varepsilon^2 .

    ``R_A ..``, ``W_A ..``: models of one input and output. ``tolerance``: epsilon. Evidence: ``far``, in rad/s, from
    where on :math:`|W|^2 + \varepsilon^2 > 2 + 2 |R|^2 \ge (1 + |R|)^2`.
    """
    low, high = real(claim, "range", (2,)).tolist()
    far, epsilon = scalar(claim, "far"), scalar(claim, "tolerance", zero=True)
    R, W = (stored(claim, name) for name in ("R_{}", "W_{}"))
    if not 0 <= low <= high or R.dt or (R.m, R.p, W.m, W.p) != (1, 1, 1, 1):
        raise InputError("range, R, W", f"{low}, {high}", "in order; one input, one output")

    def attempt() -> Verdict:
        R, W = (stored(claim, name) for name in ("R_{}", "W_{}"))
        verdict = stable(R, None, work)
        if verdict.proved:
            form = Form(arb_mat([[arb(epsilon) ** 2 - 2]]), diagonal([arb(2), arb(-1)]), None)
            verdict = axis(_common_input(R, W), [(far, math.inf, form)], work)
        for tau in dict.fromkeys((low, high)):
            if verdict.proved:
                verdict = _end_of_range(R, W, tau, epsilon, far, work)
        if verdict.proved and low < high:
            verdict = _no_opposite(R, low, high, far, work)
        return verdict

    return climb(attempt)


def _common_input(R: Model, W: Model) -> Model:
    """Stack the outputs of R and W, which have one common input."""
    A = stack([[R.A, zeros(R.n, W.n)], [zeros(W.n, R.n), W.A]])
    C = stack([[R.C, zeros(1, W.n)], [zeros(1, R.n), W.C]])
    return Model(A, stack([[R.B], [W.B]]), C, stack([[R.D], [W.D]]), 0.0)


def _end_of_range(R: Model, W: Model, tau: float, epsilon: float, far: float, work: Work) -> Verdict:
    """Prove the inequality for one delay up to ``far``, for the model ``[e^(-s tau) - R; W]``."""
    both = _common_input(R, W)
    n, sign = both.n, diagonal([arb(-1), arb(1)])
    G = Delayed(
        stack([[both.A, zeros(n, 1)], [zeros(1, n), zeros(1, 1)]]), stack([[both.B], [identity(1)]]),
        stack([[sign * both.C, arb_mat([[1], [0]])]]), sign * both.D, (tau,),
    )  # fmt: skip
    quadratic = Form(arb_mat([[arb(epsilon) ** 2]]), diagonal([arb(1), arb(-1)]), None).of_sum(G.D, G.C)

    def test(a: float, w0: float, b: float, r: float) -> Definite:
        X = expansion(G, w0, r, SMALL)
        if X is None:
            return Definite(False, math.nan)
        return definite(quadratic.at(X[0]), lambda S: quadratic.higher(X, S))

    return sweep(G, 0.0, far, test, work)


def _no_opposite(R: Model, low: float, high: float, far: float, work: Work) -> Verdict:
    """Prove that the arc of all delays does not contain the point opposite to R up to ``far``."""
    G = Delayed(R.A, R.B, R.C, R.D, ())
    half, middle = (arb(high) - arb(low)) / 2, (arb(low) + arb(high)) / 2

    def test(a: float, w0: float, b: float, r: float) -> Definite:
        X = expansion(G, w0, r)
        if X is None:
            return Definite(False, math.nan)
        value = (G.D + G.C * sum((x * arb(0, 1) for x in X[1:]), X[0]))[0, 0]
        angle = (value.conjugate() * acb(0, -middle * arb(w0, r)).exp()).arg()
        return Definite(bool(angle.abs_upper() + arb(b) * half < arb.pi()), math.nan)

    return sweep(G, 0.0, far, test, work)


# --- boxes of a model with exact delays -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Delayed:
    """The unknowns (x, w) of the module's text: ball matrices H (n + k, n + k), B, C, D, and the exact delays in s."""

    H: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    delays: tuple[float, ...]

    @property
    def n(self) -> int:
        return self.size - len(self.delays)

    @property
    def size(self) -> int:
        """Unknowns."""
        return self.H.nrows()

    def diagonal(self, state: Any, late: Callable[[arb], Any]) -> Matrix:
        """Return the diagonal matrix with ``state`` for each state, ``late(tau)`` for each delay."""
        entries = [acb(state)] * self.n + [acb(late(arb(t))) for t in self.delays]
        return acb_mat(
            self.size, self.size, [x if i == j else 0 for i, x in enumerate(entries) for j in range(self.size)]
        )

    def at(self, w: float) -> Matrix:
        return self.diagonal(acb(0, w), lambda t: _turned(w, t)) - self.H


def _turned(w: float, tau: arb) -> acb:
    return acb(0, arb(w) * tau).exp()


def expansion(G: Delayed, w0: float, r: float, degree: int = DEGREE) -> list[Matrix] | None:
    """Return the coefficients of X(e) for ``|w - w0| <= r``, the last with the remainder; None: F may be singular."""
    R = inverse(G.at(w0))
    if R is None:
        return None
    turns = [arb(1)] + [arb(r) ** i / math.factorial(i) for i in range(1, degree + 1)]

    def moved(i: int) -> Matrix:
        state, power = acb(0, r) if i == 1 else acb(0), acb(0, 1) ** i * turns[i]
        return G.diagonal(state, lambda t: power * t**i * _turned(w0, t))

    def rest(i: int) -> Matrix:
        return magnitudes(G.diagonal(r if i == 1 else 0, lambda t: turns[i] * t**i))

    X, steps = [R * G.B], [R * moved(i) for i in range(1, degree)]
    for k in range(1, degree):
        X.append(-sum((steps[i - 1] * X[k - i] for i in range(2, k + 1)), steps[0] * X[k - 1]))
    size = magnitudes(R)
    N, Q = size * rest(1), rest(degree) * magnitudes(X[0])
    for k in range(1, degree):
        Q = Q + rest(degree - k) * magnitudes(X[k])
    Z = neumann(N, size * Q)
    if Z is None or neumann(N, arb_mat(G.size, 1, [1] * G.size)) is None:
        return None
    return [*X, acb_mat(Z.nrows(), Z.ncols(), [acb(arb(0, x), arb(0, x)) for x in Z.entries()])]


def sweep(G: Delayed, a: float, b: float, test: Test, work: Work) -> Verdict:
    """Prove ``test(low, middle, high, half width)``, in rad/s, in boxes that cover [a, b], from left to right.

    A box is halved if it fails, or if it is wider than the estimated distance of its nearest root.
    """
    todo, H = [(a, b)], midpoints(G.H)
    delays = np.array(G.delays)
    weights = np.concatenate([np.ones(G.n), delays])
    while todo:
        a, b = todo.pop()
        w0 = min(max(a + (b - a) / 2, a), b)
        r = max(rounded_up(arb(b) - arb(w0)), rounded_up(arb(w0) - arb(a)))
        F = np.diag(np.concatenate([np.full(G.n, 1j * w0), np.exp(1j * w0 * delays)])) - H
        speeds = np.abs(np.linalg.eigvals(np.abs(np.linalg.inv(F)) * weights)) if len(F) else np.zeros(1)
        distance = 1 / max(float(speeds.max()), 1e-300)
        if r <= REACH * distance:
            work.spend(G.size)
            answer = test(a, w0, b, r)
            if answer.proved:
                continue
            if answer.least < INDEFINITE or r <= NARROW * distance:
                return not_proved(f"at {w0:.9g} rad/s what has to be positive is {answer.least:.3g} of its size")
        if not a < w0 < b:
            return not_proved(f"a root on the axis, or nearly, at {w0:.9g} rad/s")
        todo += [(w0, b), (a, w0)]
    return PROVED


def neumann(N: Matrix, X: Matrix) -> Matrix | None:
    """Return Y >= 0, ``Y > X + N Y`` (n, m), proposed in floating point and checked in balls; None if none was found.

    Then ``Y >= sum_k N^k X``, and as Y > N Y the spectral radius of N is below one: for all ``|S| <= N``, ``|Z| <= X``
    entry by entry I - S is regular, and ``|(I - S)^-1 Z| <= Y``.
    """
    n, x = midpoints(N), midpoints(X)
    if not x.size:
        return X
    if not (np.isfinite(n).all() and np.isfinite(x).all()):
        return None
    try:
        y = np.linalg.solve(np.eye(len(n)) - n, x * (1 + MARGIN) + MARGIN * MARGIN * x.max() + TINY)
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(y).all() and (y >= 0).all()):
        return None
    Y = exact(y)
    return Y if all(v > s for v, s in zip(Y.entries(), (X + N * Y).entries(), strict=True)) else None
