r"""Weights that cover what a rational delay misses, for every delay of a range and at every frequency.

At each frequency :math:`|e^{-j\omega\tau} - R|` is largest at an end of the range of tau, unless the arc of all
:math:`e^{-j\omega\tau}` has the point opposite to R; and it is never above 1 + |R|. So below a frequency both ends are
looked at, in boxes of the model :math:`[e^{-s\tau} - R;\; W]` with its exact delay (`delays`), and the arc; above it
the weight has passed 1 + |R|, a statement about rational models (`axis`).
"""

from __future__ import annotations

import math

from flint import acb, arb, arb_mat, fmpq_mat

from robustlab.errors import InputError
from robustlab.verification.axis import axis
from robustlab.verification.balls import Definite, definite, diagonal, identity, inverse, stack, zeros
from robustlab.verification.claim import Claim, Verdict, Work, not_proved, real, scalar
from robustlab.verification.delays import Delayed, box_of, sweep
from robustlab.verification.forms import Form
from robustlab.verification.models import Model, stored
from robustlab.verification.norms import climb
from robustlab.verification.sets import fraction
from robustlab.verification.stability import stable

SMALL = 6  # K for weights: what they cover is small at low frequencies, the difference of numbers that are not


def prove_delay_weight(claim: Claim, work: Work) -> Verdict:
    r"""R is stable, and at all frequencies for all tau of the ``range`` (2,), in s

    .. math:: |e^{-j\omega\tau} - R(j\omega)|^2 \le |W(j\omega)|^2 + \varepsilon^2 .

    ``R_A ..``, ``W_A ..``: models of one input and output. ``tolerance``: epsilon, zero where left out. Evidence:
    ``far``, in rad/s, from where on :math:`|W|^2 + \varepsilon^2 > 2 + 2 |R|^2 \ge (1 + |R|)^2`. Without a tolerance R
    is the number 1, W(0) = 0 by rational numbers, and up to ``near`` :math:`|W / j\omega| > \tau_{\max}`, as
    :math:`|e^{-j\omega\tau} - 1| \le \omega \tau`; :math:`W(s) = s\, C (sI - A)^{-1} A^{-1} B`.
    """
    low, high = real(claim, "range", (2,)).tolist()
    far, exactly = scalar(claim, "far"), "tolerance" not in claim.numbers
    near, epsilon = (scalar(claim, "near"), 0.0) if exactly else (0.0, scalar(claim, "tolerance"))
    R, W = (stored(claim, name) for name in ("R_{}", "W_{}"))
    if not 0 <= low <= high or not near <= far or R.dt or (R.m, R.p, W.m, W.p) != (1, 1, 1, 1):
        raise InputError("range, near, far, R, W", f"{low}, {high}, {near}, {far}", "in order; one input, one output")

    def attempt() -> Verdict:
        R, W = (stored(claim, name) for name in ("R_{}", "W_{}"))
        verdict = stable(R, None, work)
        if exactly and verdict.proved:
            verdict = _slope(R, W, near, high, work)
        if verdict.proved:
            form = Form(arb_mat([[arb(epsilon) ** 2 - 2]]), diagonal([arb(2), arb(-1)]), None)
            verdict = axis(_beside(R, W), [(far, math.inf, form)], work)
        for tau in dict.fromkeys((low, high)):
            if verdict.proved:
                verdict = _end_of_range(R, W, tau, epsilon, near, far, work)
        if verdict.proved and low < high:
            verdict = _no_opposite(R, low, high, near, far, work)
        return verdict

    return climb(attempt)


def _beside(R: Model, W: Model) -> Model:
    """R and W of one input, the outputs in this order."""
    A = stack([[R.A, zeros(R.n, W.n)], [zeros(W.n, R.n), W.A]])
    C = stack([[R.C, zeros(1, W.n)], [zeros(1, R.n), W.C]])
    return Model(A, stack([[R.B], [W.B]]), C, stack([[R.D], [W.D]]), 0.0)


def _slope(R: Model, W: Model, near: float, tau: float, work: Work) -> Verdict:
    """``|e^(-jw t) - 1| <= w tau <= |W|`` up to ``near``, as the claim says."""
    A, B, C, D = (
        fmpq_mat(X.nrows(), X.ncols(), [fraction(float(x)) for x in X.entries()]) for X in (W.A, W.B, W.C, W.D)
    )
    try:
        zero = (D - C * A.solve(B))[0, 0] == 0
    except ZeroDivisionError:
        zero = False
    over = inverse(W.A)
    if R.n or R.D[0, 0] != 1 or not zero or over is None:
        return not_proved("low frequencies: R is not 1, or W(0) is not zero")
    form = Form(arb_mat([[-(arb(tau) ** 2)]]), -identity(1), None)
    return axis(Model(W.A, over * W.B, W.C, zeros(1, 1), 0.0), [(0.0, near, form)], work)


def _end_of_range(R: Model, W: Model, tau: float, epsilon: float, near: float, far: float, work: Work) -> Verdict:
    """The inequality for one delay between ``near`` and ``far``: of the model ``[e^(-s tau) - R; W]``."""
    both = _beside(R, W)
    n, sign = both.n, diagonal([arb(-1), arb(1)])
    G = Delayed(
        stack([[both.A, zeros(n, 1)], [zeros(1, n), zeros(1, 1)]]), stack([[both.B], [identity(1)]]),
        stack([[sign * both.C, arb_mat([[1], [0]])]]), sign * both.D, (tau,),
    )  # fmt: skip
    quadratic = Form(arb_mat([[arb(epsilon) ** 2]]), diagonal([arb(1), arb(-1)]), None).of_sum(G.D, G.C)

    def test(a: float, w0: float, b: float, r: float) -> Definite:
        box = box_of(G, w0, r, SMALL)
        if box is None:
            return Definite(False, math.nan)
        return definite(quadratic.at(box.X[0]), lambda S: quadratic.higher(box.X, S))

    return sweep(G, near, far, test, work)


def _no_opposite(R: Model, low: float, high: float, near: float, far: float, work: Work) -> Verdict:
    """The arc of all delays has nowhere between ``near`` and ``far`` the point opposite to R."""
    G = Delayed(R.A, R.B, R.C, R.D, ())
    half, middle = (arb(high) - arb(low)) / 2, (arb(low) + arb(high)) / 2

    def test(a: float, w0: float, b: float, r: float) -> Definite:
        box = box_of(G, w0, r)
        if box is None:
            return Definite(False, math.nan)
        value = (G.D + G.C * sum((X * arb(0, 1) for X in box.X[1:]), box.X[0]))[0, 0]
        angle = (value.conjugate() * acb(0, -middle * arb(w0, r)).exp()).arg()
        return Definite(bool(angle.abs_upper() + arb(b) * half < arb.pi()), math.nan)

    return sweep(G, near, far, test, work)
