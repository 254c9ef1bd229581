r"""Entropy of a closed loop at a level above its H-infinity norm: a smooth barrier for the nonsmooth norm.

.. math::
    \varphi(T, \gamma) = -\frac{1}{2\pi} \int_{-\infty}^{\infty} \ln\det\left(I - \gamma^{-2} T(j\omega)^* T(j\omega)
    \right) \frac{2 s_0}{s_0^2 + \omega^2}\,d\omega

is finite exactly where the norm of T is below gamma, and its slope grows without bound towards the norm. With the
stabilising solution of

.. math:: A^T X + X A + C^T C + F^T R F = 0, \qquad R = \gamma^2 I - D^T D, \quad F = R^{-1} (B^T X + D^T C)

the factor :math:`R^{1/2} (I - F (sI - A)^{-1} B)` is outer, and Poisson's integral gives

.. math:: \varphi = -\ln\det(R/\gamma^2) + 2 \ln\det(s_0 I - A) - 2 \ln\det(s_0 I - A - B F).

References
----------
Mustafa, Glover, *Minimum entropy H-infinity control* (1990); the derivatives are those of this expression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.matrix_equations import lapack
from robustlab.synthesis.nonsmooth.peak_gain import LoopMatrices

__all__ = ["Entropy", "entropy"]


# Residual of the Riccati equation relative to its terms above which a solution counts as none.
RESIDUAL = 1e-7


@dataclass(frozen=True)
class Entropy:
    """The entropy, its derivative with respect to gamma, and its gradients with respect to A, B, C and D."""

    value: float
    by_gamma: float
    A: AnyArray
    B: AnyArray
    C: AnyArray
    D: AnyArray


def entropy(loop: LoopMatrices, gamma: float, s0: float = 1.0) -> Entropy | None:
    """The entropy with its derivatives; None where the loop is not stable or its norm not below gamma.

    Parameters
    ----------
    loop
        A continuous loop.
    gamma
        The level.
    s0
        Where the factor is evaluated, in rad/s: frequencies about it weigh most.
    """
    a, b, c, d = loop
    n, m = b.shape
    r = gamma**2 * np.eye(m) - d.T @ d
    try:
        np.linalg.cholesky(r)
        r_inv = np.linalg.inv(r)
    except np.linalg.LinAlgError:
        return None
    if not n:
        nothing = np.zeros
        value = -float(np.linalg.slogdet(r)[1]) + 2 * m * np.log(gamma)
        by_gamma = -2 * gamma * float(np.trace(r_inv)) + 2 * m / gamma
        return Entropy(value, by_gamma, nothing((0, 0)), nothing((0, m)), nothing((len(c), 0)), 2 * d @ r_inv)
    x = _stabilising(a, b, c, d, r_inv)
    if x is None:
        return None
    f = r_inv @ (b.T @ x + d.T @ c)
    a_f = a + b @ f
    w, w_f = np.linalg.inv(s0 * np.eye(n) - a), np.linalg.inv(s0 * np.eye(n) - a_f)
    _, log_a = np.linalg.slogdet(s0 * np.eye(n) - a)
    _, log_f = np.linalg.slogdet(s0 * np.eye(n) - a_f)
    value = -float(np.linalg.slogdet(r)[1]) + 2 * m * np.log(gamma) + 2 * float(log_a - log_f)
    v = w_f @ b @ r_inv
    s = v @ b.T
    y = _lyapunov(a_f, s + s.T)
    if y is None or not np.isfinite(value):
        return None
    q = v + y @ f.T
    fv = f @ v
    by_r = r_inv + fv + fv.T + f @ y @ f.T
    return Entropy(
        value,
        -2 * gamma * float(np.trace(by_r)) + 2 * m / gamma,
        2 * (w_f - w + y @ x).T,
        2 * (f @ w_f).T + 2 * x @ q,
        2 * d @ q.T + 2 * c @ y,
        2 * c @ q + 2 * d @ by_r,
    )


def _stabilising(a: AnyArray, b: AnyArray, c: AnyArray, d: AnyArray, r_inv: AnyArray) -> AnyArray | None:
    """X from the stable invariant subspace of the Hamiltonian; None where there is none or A is not stable."""
    n = len(a)
    a1 = a + b @ (r_inv @ (d.T @ c)) if d.any() else a
    low = c.T @ (c + d @ (r_inv @ (d.T @ c))) if d.any() else c.T @ c
    hamiltonian = np.block([[a1, b @ r_inv @ b.T], [-low, -a1.T]])
    if not np.isfinite(hamiltonian).all():
        return None
    real, _, _, _, info = lapack().dgeev(a, compute_vl=0, compute_vr=0)
    if info or real.max() >= 0:
        return None
    _, stable, real, _, z, _, info = lapack().dgees(lambda re, im: re < 0, hamiltonian, sort_t=1)
    if info or stable != n or np.abs(real).min() < 1e-13 * np.abs(hamiltonian).max():
        return None
    try:
        x = np.linalg.solve(z[:n, :n].T, z[n:, :n].T)
    except np.linalg.LinAlgError:
        return None
    x = 0.5 * (x + x.T)
    if not np.isfinite(x).all():
        return None
    terms = x @ a1, x @ hamiltonian[:n, n:] @ x
    residual = np.abs(terms[0] + terms[0].T + low + terms[1]).max()
    return x if residual <= RESIDUAL * max(np.abs(t).max() for t in (*terms, low)) else None


def _lyapunov(a: AnyArray, q: AnyArray) -> AnyArray | None:
    """``A Y + Y A^T + Q = 0`` for a stable A."""
    t, _, _, _, z, _, info = lapack().dgees(lambda re, im: 0, a)
    if info:
        return None
    y, scale, info = lapack().dtrsyl(t, t, -(z.T @ q @ z), tranb=b"T")
    y = z @ (y * scale) @ z.T
    return y if not info and np.isfinite(y).all() else None
