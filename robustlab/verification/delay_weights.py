"""Weights that bound the error of a rational delay, for every delay of a range and at every frequency.

The theorem and the expansion of functions in boxes are in theorems.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import flint
from flint import acb, acb_poly, acb_series, arb

from robustlab.errors import InputError
from robustlab.verification.balls import rounded_up
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar
from robustlab.verification.models import Model, stored
from robustlab.verification.norms import climb, stable

TERMS = 20  # of the series: at low frequencies the error is small, the difference of numbers that are not

Series = Any  # acb_series of a real variable
Fraction = tuple[acb_poly, acb_poly]
Function = Callable[[arb, Series], Series]  # of a point and the step from there
Sign = Callable[[acb, arb], bool]  # of the function's value in a box, and the box


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
        verdict = stable(R, work)
        (r, r_back), (w, w_back), floor = _fractions(R), _fractions(W), arb(epsilon) ** 2

        def above(v: arb, h: Series) -> Series:
            s = acb_poly([acb(0, -v), acb(0, -1)])  # the inverse of j (v + h)
            return _size(_value(w_back, s, h)) + floor - 2 - _size(_value(r_back, s, h)) * 2

        def at_an_end(omega: arb, h: Series, tau: float) -> Series:
            s = acb_poly([acb(0, omega), acb(0, 1)])
            error = (_at(s, h) * -arb(tau)).exp() - _value(r, s, h)
            return _size(_value(w, s, h)) + floor - _size(error)

        def arc(omega: arb, h: Series) -> Series:
            s = acb_poly([acb(0, omega), acb(0, 1)])
            return _value(r, -s, h) * (_at(s, h) * (-(arb(low) + arb(high)) / 2)).exp()

        def apart(value: acb, omega: arb) -> bool:
            return bool(value.arg().abs_upper() + omega.upper() * (arb(high) - arb(low)) / 2 < arb.pi())

        tests: list[tuple[Function, Sign, float, bool]] = [(above, _positive, rounded_up(1 / arb(far)), True)]
        tests += [(partial(at_an_end, tau=tau), _positive, far, False) for tau in dict.fromkeys((low, high))]
        tests += [(arc, apart, far, False)] if low < high else []
        for function, sign, stop, inverse in tests:
            if verdict.proved:
                verdict = _holds(function, sign, stop, inverse, work)
        return verdict

    cap, flint.ctx.cap = flint.ctx.cap, TERMS + 1
    try:
        return climb(attempt)
    finally:
        flint.ctx.cap = cap


def _fractions(G: Model) -> tuple[Fraction, Fraction]:
    """Return numerator and denominator of G(s), and of it as a function of 1/s.

    They are ``det(sI - A + B C) + (D - 1) det(sI - A)`` and ``det(sI - A)``.
    """
    below = G.A.charpoly()
    both = ((G.A - G.B * G.C).charpoly() + below * (G.D[0, 0] - 1), below)
    forward, back = ([acb_poly([p[k] for k in order]) for p in both]
                     for order in (range(G.n + 1), range(G.n, -1, -1)))  # fmt: skip
    return (forward[0], forward[1]), (back[0], back[1])


def _at(polynomial: acb_poly, h: Series) -> Series:
    found = acb_series([0])
    for c in reversed(polynomial.coeffs()):
        found = found * h + c
    return found


def _value(fraction: Fraction, s: acb_poly, h: Series) -> Series:
    """Return the fraction at ``s(h)``: as polynomials in h, which is small, its balls stay small."""
    return _at(fraction[0](s), h) / _at(fraction[1](s), h)


def _size(x: Series) -> Series:
    """Return the square of the modulus of a series of a real variable."""
    return x * acb_series([c.conjugate() for c in x.coeffs()])


def _positive(value: acb, box: arb) -> bool:
    return bool(value.real > 0)


def _holds(function: Function, sign: Sign, stop: float, inverse: bool, work: Work) -> Verdict:
    """Prove the sign of the function in boxes that cover [0, stop], from left to right."""

    def test(x0: float, r: float) -> bool:
        work.spend(1)
        try:
            middle, wide = (function(arb(x0), acb_series([h, 1])) for h in (arb(0), arb(0, r)))
        except ValueError:  # a denominator may be zero in the box
            return False
        value, reach = acb(0), arb(1)
        for k in range(TERMS + 1):
            c = (middle if k < TERMS else wide)[k]
            value, reach = value + acb(c.real * reach, c.imag * reach), reach * arb(0, r)
        return sign(value, arb(x0, r))

    todo = [(0.0, stop)]
    while todo:
        a, b = todo.pop()
        x0 = min(max(a + (b - a) / 2, a), b)
        if test(x0, max(rounded_up(arb(b) - arb(x0)), rounded_up(arb(x0) - arb(a)))):
            continue
        if not a < x0 < b or not test(x0, 0.0):
            at = 1 / x0 if inverse and x0 else x0
            return not_proved(f"at {at:.9g} rad/s what has to be positive was not proved to be")
        todo += [(x0, b), (a, x0)]
    return PROVED
