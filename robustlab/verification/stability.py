r"""Stability: every eigenvalue of A left of the imaginary axis (discrete: inside the unit circle).

Lyapunov: A is stable if some P > 0 has :math:`-(A^T P + P A) > 0` (discrete: :math:`P - A^T P A > 0`). Floating
point finds P; else the eigenvalues are enclosed.
"""

from __future__ import annotations

import numpy as np
from flint import acb, acb_mat
from numpy.typing import NDArray

from robustlab.verification.balls import Matrix, adjoint, definite, exact, midpoints
from robustlab.verification.claim import PROVED, Verdict, Work, not_proved, refuted
from robustlab.verification.models import Model, exponents

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
