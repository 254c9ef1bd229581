r"""A form F(M(jw)) > 0 at every frequency: boxes of frequency, in each of which M is a polynomial with a bounded rest.

Around w0 with half width r, for :math:`\omega = \omega_0 + r e,\ |e| \le 1`, and :math:`R = (j\omega_0 - A)^{-1}`:

.. math:: M = D + C X(e), \quad X(e) = \sum_{k<K} (-j r e)^k R^{k+1} B + (-j r e)^K (I + j r e R)^{-1} R^{K+1} B .

The rest is bounded entry by entry. Let X bound :math:`|r^K R^{K+1} B|` and N bound :math:`r |R|`. A matrix Y >= 0 with
:math:`Y > X + N Y` (strictly in every entry; floating point proposes Y, balls check it) has
:math:`Y \ge \sum_k N^k X`, and, as Y > N Y and Y > 0, the spectral radius of N is below 1. So :math:`I + j r e R` is
regular, there is no pole in the box, and :math:`|(I + jreR)^{-1} r^K R^{K+1} B| \le Y`: Y is the radius of the
coefficient of :math:`e^K`, a ball around zero. `balls.definite` then judges F(e) for all e at once.

A box that fails is halved, so a lightly damped peak costs a number of boxes that grows with the logarithm of its
width. High frequencies are those of the reciprocal model around 0, infinity included; a discrete model is mapped to
a continuous one first (`models`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from flint import acb, acb_mat, arb

from robustlab.errors import InputError
from robustlab.verification.balls import (
    INDEFINITE,
    Definite,
    Matrix,
    definite,
    exact,
    inverse,
    magnitudes,
    midpoints,
    rounded_down,
    rounded_up,
)
from robustlab.verification.claim import PROVED, Verdict, Work, not_proved
from robustlab.verification.forms import Form, Quadratic
from robustlab.verification.models import Model, modal, on_the_axis, reciprocal, shifted

DEGREE = 3  # K: beyond it a box gets wider by less than its work grows
NARROW = 1e-9  # a box in which M changes by less than this part will not gain from another halving
MARGIN = 1e-4  # by which a proposed bound of a rest is wider than floating point says
TINY = 1e-300
REACH = 0.6  # half width of a box over the distance of the nearest pole, at most: the series converges with this ratio


@dataclass(frozen=True)
class Chart:
    """A continuous model, hints of its poles, and what its frequency means to the reader."""

    model: Model
    poles: np.ndarray
    frequency: Callable[[float], float]  # rad/s of the user's model


def axis(G: Model, intervals: Sequence[tuple[float, float, Form]], work: Work) -> Verdict:
    """Whether each interval's form is positive definite at each of its frequencies, the ends included.

    ``G``: M(jw) is its response, discrete that at exp(jw dt). It need not be stable; a pole in an interval fails.
    ``intervals``: low, high in rad/s; high may be inf, and what lies beyond pi/dt counts as pi/dt.
    Raises InputError: an interval of a discrete model that starts beyond pi/dt.
    """
    mapped = on_the_axis(G) if G.dt else G
    if mapped is None:
        return not_proved("the discrete model was not proved to be free of a pole at -1")
    low, high = Chart(*modal(mapped), lambda t: _unwarped(t, G.dt)), None
    for start, stop, form in intervals:
        a, b = _warped(start, G.dt, up=False), _warped(stop, G.dt, up=True)
        split = b
        if math.isinf(b):
            split = max(a, float(np.abs(low.poles).max(initial=0.0)) or 1.0)
            high = high or _around_infinity(mapped, G.dt)
            if high is None:
                return not_proved("high frequencies: A was not proved regular")
            verdict = _boxes(high, -rounded_up(1 / arb(split)), 0.0, form, work)
            if not verdict.proved:
                return verdict
        verdict = _boxes(low, a, split, form, work)
        if not verdict.proved:
            return verdict
    return PROVED


def _around_infinity(mapped: Model, dt: float) -> Chart | None:
    """The chart in which w = inf is 0, and w is ``-1/w``; None where there is none."""
    inverted = reciprocal(mapped)
    return Chart(*modal(inverted), lambda v: _unwarped(-1 / v if v else math.inf, dt)) if inverted else None


def _warped(w: float, dt: float, *, up: bool) -> float:
    """A double above (else below) ``tan(w dt / 2)``, inf where w dt may be pi; of a continuous model w itself."""
    if not dt or math.isinf(w):
        return w
    half = arb(w) * arb(dt) / 2
    if half < arb.pi() / 2:
        return rounded_up(half.tan()) if up else max(rounded_down(half.tan()), 0.0)
    if not up:
        raise InputError("low", f"{w}", f"a frequency below pi/dt, {math.pi / dt:.6g} rad/s")
    return math.inf


def _unwarped(t: float, dt: float) -> float:
    return 2 * math.atan(t) / dt if dt else t


def _boxes(chart: Chart, a: float, b: float, form: Form, work: Work) -> Verdict:
    """Whether the form is positive definite on [a, b]; its ends are doubles that neighbouring boxes share."""
    todo, quadratic = [(a, b)], form.of_sum(chart.model.D, chart.model.C)
    while todo:
        a, b = todo.pop()
        w0 = min(max(a + (b - a) / 2, a), b)
        r = max(rounded_up(arb(b) - arb(w0)), rounded_up(arb(w0) - arb(a)))
        distance = float(np.abs(1j * w0 - chart.poles).min(initial=math.inf))
        if r <= REACH * distance:
            work.spend(chart.model.size)
            answer = _box(chart.model, w0, r, quadratic)
            if answer.proved:
                continue
            if answer.least < INDEFINITE or r <= NARROW * distance:
                found = f"at {chart.frequency(w0):.9g} rad/s the form's smallest eigenvalue is {answer.least:.3g}"
                return not_proved(f"{found} of its size")
        if not a < w0 < b:
            return not_proved(f"a pole on the axis, or nearly, at {chart.frequency(w0):.9g} rad/s")
        todo += [(w0, b), (a, w0)]
    return PROVED


def _box(G: Model, w0: float, r: float, form: Quadratic) -> Definite:
    """Whether the form is positive definite for ``|w - w0| <= r``."""
    X = _polynomial(G, w0, r)
    return definite(form.at(X[0]), lambda S: form.higher(X, S)) if X is not None else Definite(False, math.nan)


def _polynomial(G: Model, w0: float, r: float) -> list[Matrix] | None:
    """Coefficients of X(e) as in the module's text, the rest in the last; None where it was not bounded."""
    R = inverse(shifted(G, w0))
    if R is None:
        return None
    step, X = R * acb(0, -r), [R * G.B]
    for _ in range(DEGREE):
        X.append(step * X[-1])
    rest = neumann(magnitudes(step), magnitudes(X.pop()))
    if rest is None:
        return None
    return [*X, acb_mat(G.n, G.m, [acb(arb(0, x), arb(0, x)) for x in rest.entries()])]


def neumann(N: Matrix, X: Matrix) -> Matrix | None:
    """A nonnegative ``Y > X + N Y`` (n, m), which proves what the module's text says; None where none was found."""
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
