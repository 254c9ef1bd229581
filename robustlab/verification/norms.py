r"""Stability, H-infinity and H2 norms of a model in balls.

Lyapunov: A is stable (every eigenvalue left of the imaginary axis; discrete: inside the unit circle) if some P > 0 has
:math:`-(A^T P + P A) > 0` (discrete: :math:`P - A^T P A > 0`). Floating point finds P; else the eigenvalues are
enclosed.

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
from flint import acb, acb_mat, arb
from numpy.typing import NDArray

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
from robustlab.verification.models import Model, exponents, gain_exceeds, model_of

DOUBLINGS = 60  # sums 2^60 terms of a Lyapunov equation's solution; eigenvalues decide slower decay


def lyapunov_form(G: Model, P: Matrix) -> Matrix:
    """``-(A' P + P A)``, discrete ``P - A' P A``, shape (n, n)."""
    if G.dt:
        return P - adjoint(G.A) * P * G.A
    product = P * G.A
    return -(adjoint(product) + product)


def stable(G: Model, work: Work) -> Verdict:
    """Prove that every matrix in the balls of A is stable, or refute it by an eigenvalue enclosed outside."""
    work.spend(G.n)
    hint = lyapunov_hint(G)
    if hint is not None:
        candidate = exact(hint)
        work.spend(G.n)
        if definite(candidate).proved and definite(lyapunov_form(G, candidate)).proved:
            return PROVED
    work.spend(2 * G.n)
    values = eigenvalues(G.A)
    for value in values:
        if outside(value, G.dt):
            return refuted(f"A has an eigenvalue near {complex(value):.6g}, enclosed beyond the stability boundary")
    if len(values) == G.n and all(_inside(value, G.dt) for value in values):
        return PROVED
    nearest = max((abs(v) - 1 if G.dt else v.real for v in map(complex, values)), default=np.nan)
    return not_proved(f"stability of A: no P that proves it, rightmost eigenvalue {nearest:.3g} from the boundary")


def eigenvalues(A: Matrix) -> list[acb]:
    """Enclose all eigenvalues, each ball holding one (flint); empty where that failed."""
    try:
        return acb_mat(A).eig(multiple=True)
    except ValueError:
        return []


def outside(value: acb, dt: float) -> bool:
    """Test whether all of the ball is beyond the stability boundary."""
    return bool(value.abs_lower() > 1 if dt else value.real > 0)


def _inside(value: acb, dt: float) -> bool:
    return bool(value.abs_upper() < 1 if dt else value.real < 0)


def lyapunov_hint(G: Model) -> NDArray[np.float64] | None:
    r"""Estimate P in floating point as :math:`\sum_k (F^k)^T F^k`, summed by doubling; None where it fails.

    F is A, or :math:`(I + hA)(I - hA)^{-1}` of a continuous model: then P solves
    :math:`A^T P + P A = -(I - hA)^T (I - hA) / (2h)`.
    """
    A = midpoints(G.A)
    if not G.n or not np.isfinite(A).all():
        return None
    d = np.exp2(exponents(np.abs(A), np.zeros((G.n, 0)), np.zeros((0, G.n))))
    A = d[:, None] * A / d
    if not 1e-100 < np.abs(A).max() < 1e100:
        return None
    F, one = A, np.eye(G.n)
    if not G.dt:
        h = 1 / np.linalg.norm(A)
        if abs(np.linalg.det(one - h * A)) == 0:
            return None
        F = np.linalg.solve(one - h * A, one + h * A)
    P = one
    for _ in range(DOUBLINGS):
        step = F.T @ P @ F
        if not np.isfinite(step).all():
            return None
        P, F = P + step, F @ F
        if np.abs(step).max() <= 1e-17 * np.abs(P).max():
            return (P + P.T) / 2 * d * d[:, None]
    return None


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
        verdict = axis(G, [(0.0, math.inf, gain_form(G.m, G.p, gamma))], work)
        if verdict.at is not None and gain_exceeds(G, verdict.at, gamma):
            return refuted(f"the gain at {verdict.at:.9g} rad/s was proved to be larger")
        return verdict

    if "P" in claim.numbers:
        verdict = prove_bounded_real(claim, build, work)
        if verdict.proved:
            return verdict
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
