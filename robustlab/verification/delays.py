r"""Models with exact delays: stability, gain and mu of the loop.

The first k inputs w and outputs z of a continuous model are closed by :math:`w_i(t) = z_i(t - \tau_i)`. With x and w
as unknowns, :math:`H = \begin{pmatrix} A & B_1 \\ C_1 & D_{11} \end{pmatrix}`, B, C what is left of columns and rows,

.. math:: M(s) = D_{22} + C F(s)^{-1} B, \qquad F(s) = \mathrm{diag}(s I, e^{s \tau_i}) - H .

**Boxes.** For :math:`\omega = \omega_0 + r e,\ |e| \le 1`: :math:`F(j\omega) = F_0 + N(e)`, N diagonal,
:math:`N = \sum_{k \ge 1} N_k e^k`, and by Taylor's rest :math:`|N(e) - \sum_{k<i} N_k e^k| \le T_i |e|^i`, with
:math:`T_1 = r\,\mathrm{diag}(I, \tau)`, :math:`T_i = \mathrm{diag}(0, (r \tau)^i / i!)`. With :math:`R = F_0^{-1}`,
:math:`X_0 = R B`, :math:`X_k = -R \sum_{1 \le i \le k} N_i X_{k-i}`, put :math:`F^{-1} B = \sum_{k<K} X_k e^k + e^K Z`.
Then :math:`|F Z| \le Q = \sum_{k<K} T_{K-k} |X_k|` entry by entry, so :math:`|Z| \le |R| Q + |R| T_1 |Z|`, and
`series.neumann` bounds Z, proves the spectral radius of :math:`|R| T_1` below one, and so F regular in the box. What
follows from it is said there.

**Beyond** :math:`\Omega`, for all :math:`|s| \ge \Omega` with :math:`\Re s \ge 0`: with
:math:`S = \mathrm{diag}(I / s, e^{-s\tau})` and :math:`|S| \le \bar S = \mathrm{diag}(I / \Omega, I)`,
:math:`F^{-1} = (I - S H)^{-1} S`. Where :math:`\bar S |H|` has a spectral radius below one F is regular there, and
:math:`|M - D_{22}| \le |C| Y` for :math:`Y > \bar S |B| + \bar S |H| Y`.

**Roots on the right.** If :math:`|E| \le \bar N` entry by entry and :math:`\bar N` has a spectral radius below one,
:math:`\log \det(I + E) = \sum_k (-1)^{k+1} \mathrm{tr}(E^k) / k` is continuous in E, zero at E = 0, and at most
:math:`-\log \det(I - \bar N)`, as :math:`|\mathrm{tr}\,E^k| \le \mathrm{tr}\,\bar N^k`. Where that is below pi, the
argument of det(I + E) that goes continuously from zero is the principal one. So in a box :math:`\arg \det F` turns by
the difference of the principal arguments of :math:`\det(R F)` at its ends; and beyond :math:`\Omega`
:math:`f(s) = e^{-s \sum \tau} \det F(s) = s^n \det(I - S H)` turns as s^n but for the principal argument
:math:`\varphi` of :math:`\det(I - S H)` at its end. f is entire, real on the real axis, and has no zero on the contour:

.. math:: N = \frac n2 + \frac 1\pi \Big( \varphi(\Omega) - \Delta_{0 \to \Omega} \arg \det F(j\omega)
   + \Omega \textstyle\sum \tau_i \Big)

roots lie right of the axis. A ball below one leaves none, one above zero leaves at least one. Where there is none, the
poles lie left of a line left of the axis (the echoes :math:`|D_{11}|` die away), and M is bounded on the right.

References
----------
Michiels, Niculescu, *Stability, Control, and Computation for Time-Delay Systems* (2014), chapters 1 and 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat

from robustlab.errors import InputError
from robustlab.verification.balls import (
    INDEFINITE,
    PRECISIONS,
    Definite,
    Matrix,
    adjoint,
    definite,
    identity,
    inverse,
    magnitudes,
    midpoints,
    part,
    precision,
    rounded_up,
    stack,
)
from robustlab.verification.claim import (
    PROVED,
    Claim,
    Verdict,
    Work,
    complex_or_real,
    not_proved,
    real,
    refuted,
    scalar,
)
from robustlab.verification.forms import Form, gain_form, read_blocks, scaled_form
from robustlab.verification.models import Model, modal, model_of, norm_exceeds
from robustlab.verification.mu import covering
from robustlab.verification.norms import climb
from robustlab.verification.series import DEGREE, REACH, neumann

DOUBLINGS = 80  # of the frequency, in the search for one beyond which bounds of the resolvent are enough
WORSE = 10.0  # modal coordinates are used where no more than this is lost in the cancellation of what they add up
NARROW = 1e-13  # a box in which M changes by less than this part will not gain from another halving

Test = Callable[[float, float, float, float], Definite]


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
        """States."""
        return self.size - len(self.delays)

    @property
    def size(self) -> int:
        """Unknowns."""
        return self.H.nrows()

    def diagonal(self, state: Any, late: Callable[[arb], Any]) -> Matrix:
        """The diagonal matrix with ``state`` for each state, ``late(tau)`` for each delay."""
        entries = [acb(state)] * self.n + [acb(late(arb(t))) for t in self.delays]
        return acb_mat(
            self.size, self.size, [x if i == j else 0 for i, x in enumerate(entries) for j in range(self.size)]
        )

    def at(self, w: float) -> Matrix:
        """F at the exact frequency ``w``."""
        return self.diagonal(acb(0, w), lambda t: _turned(w, t)) - self.H


def _turned(w: float, tau: arb) -> acb:
    return acb(0, arb(w) * tau).exp()


def delayed(claim: Claim) -> Delayed:
    """The model of a claim with its first channels closed by ``delays`` (k,) in s."""
    G, delays = model_of(claim), real(claim, "delays", (None,))
    k = len(delays)
    if G.dt or not (delays > 0).all() or k > min(G.m, G.p):
        raise InputError("delays", f"{delays.tolist()}, dt {G.dt}", "times above zero, one each of the first channels")
    apart, _ = modal(G)
    if _throughput(apart) <= WORSE * _throughput(G):
        G = apart
    own, late = slice(0, G.n), slice(0, k)
    ins, outs = slice(k, G.m), slice(k, G.p)
    return Delayed(
        stack([[G.A, part(G.B, own, late)], [part(G.C, late, own), part(G.D, late, late)]]),
        stack([[part(G.B, own, ins)], [part(G.D, late, ins)]]),
        stack([[part(G.C, outs, own), part(G.D, outs, late)]]),
        part(G.D, outs, ins),
        tuple(delays.tolist()),
    )


def _throughput(G: Model) -> float:
    """How much passes through the states, entry by entry: where modal coordinates make it large, they are no help."""
    return float((np.abs(midpoints(G.C)) @ np.abs(midpoints(G.B))).max(initial=0.0))


# --- the axis --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Box:
    """In a box of frequency: the coefficients of X(e), the rest in the last, and a bound of ``R N(e)``."""

    X: list[Matrix]
    N: Matrix


def box_of(G: Delayed, w0: float, r: float, degree: int = DEGREE) -> Box | None:
    """The box ``|w - w0| <= r`` as in the module's text; None where F was not proved to be regular in it."""
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
    if Z is None or neumann(N, _ones(G.size)) is None:
        return None
    return Box([*X, _around_zero(Z)], N)


def _ones(n: int) -> Matrix:
    return arb_mat(n, 1, [1] * n)


def _around_zero(radii: Matrix) -> Matrix:
    """Complex balls around zero that hold all numbers of at most these sizes."""
    return acb_mat(radii.nrows(), radii.ncols(), [acb(arb(0, x), arb(0, x)) for x in radii.entries()])


def narrow_arguments(N: Matrix) -> bool:
    """Whether the principal argument of det(I + E) is the one that is continuous, for all ``|E| <= N`` (radius < 1)."""
    return bool((identity(N.nrows()) - N).det() > (-arb.pi()).exp())


def sweep(G: Delayed, a: float, b: float, test: Test, work: Work) -> Verdict:
    """Whether ``test(low, middle, high, half width)``, in rad/s, holds in boxes that cover [a, b], from left to right.

    A box that fails is halved; so is one that floating point sees to be wider than its roots are far.
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


def prove_axis(G: Delayed, intervals: Sequence[tuple[float, float, Form | None]], work: Work) -> Verdict:
    """The loop is stable, and each interval's form is positive definite at each of its frequencies.

    ``intervals``: low, high in rad/s, one after the other from 0 to inf; a form of None asks for stability alone.
    Refuted: a root right of the axis was counted.
    """
    end = beyond(G, intervals[-1][2], intervals[-1][0], work)
    if end is None:
        return not_proved("high frequencies: bounds of the resolvent and of the echoes did not end the axis")
    turned, determinants = arb(0), dict[float, acb]()

    def argument(w: float, w0: float) -> arb:
        for x in (w, w0):
            determinants.setdefault(x, G.at(x).det())
        return (determinants[w] / determinants[w0]).arg()

    for low, high, form in intervals:
        quadratic = None if form is None else form.of_sum(G.D, G.C)

        def test(a: float, w0: float, b: float, r: float, quadratic: Any = quadratic) -> Definite:
            nonlocal turned
            box = box_of(G, w0, r)
            if box is None or not narrow_arguments(box.N):
                return Definite(False, math.nan)
            answer = Definite(True, 1.0)
            if quadratic is not None:
                answer = definite(quadratic.at(box.X[0]), lambda S: quadratic.higher(box.X, S))
            if answer.proved:
                turned += argument(b, w0) - argument(a, w0)
            return answer

        verdict = sweep(G, low, min(high, end), test, work)
        if not verdict.proved:
            return verdict
    S = G.diagonal(1 / acb(0, end), lambda t: _turned(-end, t))
    last = (identity(G.size) - S * G.H).det().arg()
    roots = arb(G.n) / 2 + (last - turned + arb(end) * sum(map(arb, G.delays), arb(0))) / arb.pi()
    if roots < 1:
        return PROVED
    return refuted("a root right of the axis was counted") if roots > 0 else not_proved("the roots were not counted")


def beyond(G: Delayed, form: Form | None, start: float, work: Work) -> float | None:
    """A frequency from ``start`` on beyond which there is no root, and the form holds; None where none was found."""
    H, B, C = (magnitudes(X) for X in (G.H, G.B, G.C))
    speed = float(np.abs(np.linalg.eigvals(midpoints(H)[: G.n, : G.n])).max(initial=0.0))
    end = max(start, speed, *(1e-3 / t for t in G.delays)) or 1.0
    for _ in range(DOUBLINGS):
        work.spend(G.size)
        S = magnitudes(G.diagonal(1 / arb(end), lambda t: 1))
        N = S * H
        if neumann(N, _ones(G.size)) is not None and narrow_arguments(N):
            Y = neumann(N, S * B)
            if form is None or (Y is not None and _holds_about(form, G.D, C * Y)):
                return end
        end *= 1.5
    return None


def _holds_about(form: Form, D: Matrix, radii: Matrix) -> bool:
    r"""Whether the form is positive definite at every M with ``|M - D| <= radii`` entry by entry.

    In balls; or, of D_z diagonal and not negative, G = 0: for any t > 0 (Young)
    :math:`M^* D_z M \le (1 + t) D^* D_z D + (1 + 1/t) \lambda I`, where :math:`\lambda I` is above
    :math:`\mathrm{radii}^T D_z\, \mathrm{radii}`. Floating point takes t.
    """
    if definite(form.of(D + _around_zero(radii))).proved:
        return True
    if form.G is not None or not _is_diagonal(form.D_z):
        return False
    inner, outer = adjoint(D) * (form.D_z * D), radii.transpose() * (form.D_z * radii)
    largest, size = (float(np.abs(np.linalg.eigvals(midpoints(X))).max(initial=0.0)) for X in (outer, inner))
    above, t = arb(largest * (1 + 1e-9)), math.sqrt(largest / max(size, 1e-12 * largest)) if largest else 1.0
    one = identity(D.ncols())
    return (
        definite(one * above - outer).proved
        and definite(form.of(D) - inner * arb(t) - one * (above * (1 + 1 / arb(t)))).proved
    )


def _is_diagonal(X: Matrix) -> bool:
    """And not negative."""
    n = X.nrows()
    return all(X[i, j] == 0 if i != j else X[i, i].real >= 0 for i in range(n) for j in range(n))


# --- claims ----------------------------------------------------------------------------------------------------------


def prove_delayed_stable(claim: Claim, work: Work) -> Verdict:
    """All roots of the loop with its ``delays`` lie left of the axis."""
    return climb(lambda: prove_axis(delayed(claim), [(0.0, math.inf, None)], work))


def prove_delayed_norm(claim: Claim, work: Work) -> Verdict:
    """That, and its gain is at most ``gamma`` at all frequencies; ``frequency`` may be that of a counterexample."""
    gamma = scalar(claim, "gamma")
    if "frequency" in claim.numbers:
        w = scalar(claim, "frequency", zero=True)
        with precision(PRECISIONS[0]):
            G = delayed(claim)
            R = inverse(G.at(w))
            if R is not None and norm_exceeds(G.D + G.C * R * G.B, gamma):
                return refuted(f"the gain at {w:.9g} rad/s was proved to be larger")

    def attempt() -> Verdict:
        G = delayed(claim)
        return prove_axis(G, [(0.0, math.inf, gain_form(G.D.ncols(), G.D.nrows(), gamma))], work)

    return climb(attempt)


def prove_delayed_mu(claim: Claim, work: Work) -> Verdict:
    """The loop with its ``delays`` is stable for every Delta of the ``blocks`` within 1/``level``: `prove_mu_axis`."""
    if "band" in claim.numbers:
        raise InputError("band", "a band", "none: the claim is that at all frequencies")
    G = delayed(claim)
    p, m = G.D.nrows(), G.D.ncols()
    blocks, pieces, k = read_blocks(claim, m, p), covering(claim, 0.0), len(claim.numbers["low"])
    D_w, D_z, X = (
        complex_or_real(claim, name, (k, *shape)) for name, shape in (("D_w", (m, m)), ("D_z", (p, p)), ("G", (m, p)))
    )

    def attempt() -> Verdict:
        forms = [(a, b, scaled_form(blocks, D_w[i], D_z[i], X[i], work)) for i, a, b in pieces]
        if any(form is None for *_, form in forms):
            return not_proved("D_w > 0 was not proved")
        return prove_axis(delayed(claim), forms, work)

    return climb(attempt)
