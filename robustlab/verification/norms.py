r"""Stability, H-infinity and H2 norms of a model in balls.

Bounded real lemma (strict). With :math:`\gamma > 0`, P = P^T > 0 and

.. math:: -\begin{pmatrix} A^T P + P A + C^T C & P B + C^T D \\ B^T P + D^T C & D^T D - \gamma^2 I \end{pmatrix} > 0

A is stable and :math:`\|G\|_\infty < \gamma`: the first block is Lyapunov's inequality, and for
:math:`x = (j\omega - A)^{-1} B u` the form at (x, u) is :math:`\gamma^2 |u|^2 - |G(j\omega) u|^2 > 0`, at infinity the
last block. Discrete: :math:`A^T P A - P`, :math:`A^T P B`, :math:`B^T P B` in place of the parts with P.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from flint import arb

from robustlab.verification.axis import axis
from robustlab.verification.balls import (
    PRECISIONS,
    Matrix,
    adjoint,
    definite,
    exact,
    identity,
    midpoints,
    precision,
    rounded_up,
    stack,
    zeros,
)
from robustlab.verification.claim import (
    PROVED,
    Blurred,
    Claim,
    Outcome,
    Verdict,
    Work,
    not_proved,
    real,
    refuted,
    scalar,
    symmetric,
)
from robustlab.verification.forms import gain_form
from robustlab.verification.models import Model, gain_exceeds, model_of, on_the_axis
from robustlab.verification.stability import lyapunov_form, stable

GRID = 60  # frequencies of the search for a peak
PEAKS = 3  # of them are refined
CLIMBS = 60  # steps of the golden section


def climb(attempt: Callable[[], Verdict]) -> Verdict:
    """Return the verdict in the lowest precision that decides; the last one where none does."""
    verdict = not_proved("")
    for bits in PRECISIONS:
        with precision(bits):
            try:
                verdict = attempt()
            except Blurred:
                verdict = not_proved(f"{bits} bits are not enough")
        if verdict.outcome is not Outcome.NOT_PROVED:
            break
    return verdict


def in_two_parts(claim: Claim, n: int) -> Matrix:
    """Return the claim's P, plus ``P_low``, its further digits, where given."""
    P = exact(symmetric(claim, "P", n))
    return P + exact(symmetric(claim, "P_low", n)) if "P_low" in claim.numbers else P


def prove_stable(claim: Claim, work: Work) -> Verdict:
    """Prove that A (n, n) is stable."""
    A = real(claim, "A", (None, None))
    n = len(real(claim, "A", (len(A), len(A))))
    dt = scalar(claim, "dt", zero=True)
    return climb(lambda: stable(Model(exact(A), zeros(n, 0), zeros(0, n), zeros(0, 0), dt), work))


def bounded_real_form(G: Model, P: Matrix, gamma: float) -> Matrix:
    """Return the matrix of the module's text, shape (n + m, n + m)."""
    PA, PB = P * G.A, P * G.B
    if G.dt:
        parts = adjoint(G.A) * PA - P, adjoint(G.A) * PB, adjoint(G.B) * PB
    else:
        parts = adjoint(PA) + PA, PB, zeros(G.m, G.m)
    corner = parts[0] + adjoint(G.C) * G.C
    side = parts[1] + adjoint(G.C) * G.D
    last = parts[2] + adjoint(G.D) * G.D - identity(G.m) * arb(gamma) ** 2
    return -stack([[corner, side], [adjoint(side), last]])


def prove_norm(claim: Claim, build: Callable[[Claim], Model], work: Work) -> Verdict:
    """Prove that the model of ``build`` is stable with H-infinity norm <= ``gamma``, by ``P`` where it is a proof."""
    gamma = scalar(claim, "gamma")

    def by_frequency() -> Verdict:
        G = build(claim)
        return axis(G, [(0.0, math.inf, gain_form(G.m, G.p, gamma))], work)

    if "P" in claim.numbers:
        verdict = prove_bounded_real(claim, build, work)
        if verdict.proved:
            return verdict
    with precision(PRECISIONS[0]):
        work.spend(build(claim).size)
        counterexample = gain_above(build(claim), gamma)
    if counterexample is not None:
        return counterexample
    verdict = climb(lambda: stable(build(claim), work))
    return climb(by_frequency) if verdict.proved else verdict


def prove_bounded_real(claim: Claim, build: Callable[[Claim], Model], work: Work) -> Verdict:
    """Prove the same by ``P`` alone (`in_two_parts`)."""
    gamma = scalar(claim, "gamma")

    def attempt() -> Verdict:
        G = build(claim)
        P = in_two_parts(claim, G.n)
        work.spend(G.size)
        proved = definite(P).proved and definite(bounded_real_form(G, P, gamma)).proved
        return PROVED if proved else not_proved("P is no proof")

    return climb(attempt)


def gain_above(G: Model, gamma: float) -> Verdict | None:
    """Return the refutation of ``norm <= gamma`` by a frequency with a larger gain; None where none was found."""
    mapped = on_the_axis(G) if G.dt else G
    if mapped is None or not (G.m and G.p):
        return None
    for w in (*peaks(mapped), math.inf):
        if gain_exceeds(mapped, w, gamma):
            at = 2 * math.atan(w) / G.dt if G.dt else w
            return refuted(f"the gain at {at:.9g} rad/s was proved to be larger")
    return None


def peaks(G: Model) -> list[float]:
    """Estimate frequencies of the largest gain of a continuous model."""
    A, B, C, D = (midpoints(X) for X in (G.A, G.B, G.C, G.D))
    if not G.n or not all(np.isfinite(X).all() for X in (A, B, C, D)):
        return [0.0]
    poles = np.linalg.eigvals(A)
    sizes = np.clip(np.abs(poles), 1e-100, 1e100)
    grid = np.geomspace(sizes.min() / 10, sizes.max() * 10, GRID)
    points = np.unique(np.concatenate([[0.0], sizes, np.abs(poles.imag), grid]))

    def gain(w: float) -> float:
        try:
            value = D + C @ np.linalg.solve(1j * w * np.eye(G.n) - A, B)
        except np.linalg.LinAlgError:
            return 0.0
        return float(np.linalg.norm(value, 2)) if np.isfinite(value).all() else 0.0

    values = np.array([gain(w) for w in points])
    best = np.argsort(-values, kind="stable")[:PEAKS]
    return [_climbed(gain, float(points[max(i - 1, 0)]), float(points[min(i + 1, len(points) - 1)])) for i in best]


def _climbed(gain: Callable[[float], float], a: float, b: float) -> float:
    """Return the result of a golden section between ``a`` and ``b``, or the better end."""
    ends, ratio = (a, b), (math.sqrt(5) - 1) / 2
    for _ in range(CLIMBS):
        left, right = b - ratio * (b - a), a + ratio * (b - a)
        if gain(left) > gain(right):
            b = right
        else:
            a = left
    return max((*ends, (a + b) / 2), key=gain)


def prove_gramian(claim: Claim, work: Work) -> Verdict:
    r"""Prove that the model is stable with H2 norm <= ``value``, by ``P`` (n, n; `in_two_parts`).

    With P > 0 and :math:`-(A^T P + P A + C^T C) > 0` (discrete :math:`P - A^T P A - C^T C > 0`) P is above the
    observability Gramian, so the norm's square is at most :math:`\mathrm{tr}(B^T P B)`, discrete plus
    :math:`\mathrm{tr}(D^T D)`. A continuous model needs D = 0, to the last bit.
    """
    value = scalar(claim, "value", zero=True)

    def attempt() -> Verdict:
        G = model_of(claim)
        P = in_two_parts(claim, G.n)
        if not G.dt and any(x != 0 for x in G.D.entries()):
            return refuted("D is not zero, so the H2 norm is infinite")
        if not G.dt and not all(x == 0 for x in G.D.entries()):  # a loop's D may hide in a ball around zero
            return not_proved("D = 0 was not proved")
        work.spend(G.n)
        if not definite(P).proved:
            return not_proved("P > 0 was not proved")
        answer = definite(lyapunov_form(G, P) - adjoint(G.C) * G.C)
        if not answer.proved:
            return not_proved(
                f"Lyapunov's inequality was not proved: smallest eigenvalue {answer.least:.3g} of its size"
            )
        square: arb = sum((X[i, i] for X in (adjoint(G.B) * P * G.B, adjoint(G.D) * G.D) for i in range(G.m)), arb(0))
        if square <= arb(value) ** 2:
            return PROVED
        return not_proved(f"P proves {rounded_up(square.sqrt()):.17g}")

    return climb(attempt)
