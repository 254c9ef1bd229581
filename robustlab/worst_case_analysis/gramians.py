"""Gramians of many members at once: on the infinite horizon by the squared Smith iteration, on a finite one."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robustlab.worst_case_analysis.ensemble import Ensemble

__all__ = ["finite_gramians", "gramians", "stable_members"]

Array = NDArray[np.float64]

# The iteration's error is squared each time; a pole at a distance of 1e-12 of its size from the boundary is through.
DOUBLINGS = 46
# Steps of the finite horizon are halved until |A| h is below this; the series then has a dozen terms.
SMALL = 0.25
TERMS = 12


def stable_members(ensemble: Ensemble) -> NDArray[np.bool_]:
    """Which members are asymptotically stable and well-posed, (k,); all well-posed ones where there are no states."""
    if not ensemble.A.shape[1]:
        return ~ensemble.ill_posed
    return ~ensemble.ill_posed & (ensemble.spectral_abscissa() < 0)


def gramians(ensemble: Ensemble, kind: Literal["controllability", "observability"]) -> Array:
    r"""Gramians of stable members, shape (k, n_x, n_x).

    .. math:: A P + P A^T + B B^T = 0 \quad\text{or}\quad A P A^T - P + B B^T = 0

    A continuous equation is made discrete by the Cayley map, :math:`A_d = (p I + A)(p I - A)^{-1}`, and
    :math:`P = \sum_j A_d^j Q A_d^{jT}` is summed by doubling.

    References
    ----------
    Smith, "Matrix equation XA + BX = C", SIAM J. Appl. Math. 16 (1968).
    """
    a, n = ensemble.A, ensemble.A.shape[1]
    source = ensemble.B
    if kind == "observability":
        a, source = a.transpose(0, 2, 1), ensemble.C.transpose(0, 2, 1)
    q = source @ source.transpose(0, 2, 1)
    if n and not ensemble.dt:
        size = np.abs(np.linalg.eigvals(ensemble.A))
        rate = np.sqrt(size.min(axis=1) * size.max(axis=1))[:, None, None]
        inverse = np.linalg.inv(rate * np.eye(n) - a)
        q = 2.0 * rate * inverse @ q @ inverse.transpose(0, 2, 1)
        a = (rate * np.eye(n) + a) @ inverse
    power, total = a, q
    with np.errstate(under="ignore"):
        for _ in range(DOUBLINGS):
            total = total + power @ total @ power.transpose(0, 2, 1)
            power = power @ power
            # Powers that shrink below the smallest normal numbers would slow down everything.
            power = np.where(np.abs(power) < 1e-150, 0.0, power)
    return 0.5 * (total + total.transpose(0, 2, 1))


def finite_gramians(ensemble: Ensemble, duration: float, norm: float) -> Array:
    r"""Controllability Gramians on [0, T], shape (k, n_x, n_x); members may be unstable.

    .. math:: W(T) = \int_0^T e^{A t} B B^T e^{A^T t} dt, \qquad W(2 h) = W(h) + e^{A h} W(h) e^{A^T h}

    and of a discrete model the sum over ``round(T / dt)`` samples.

    Parameters
    ----------
    duration
        T in s.
    norm
        Size of A in 1/s, which decides the first step: one for all members of a set.
    """
    a, n = ensemble.A, ensemble.A.shape[1]
    q = ensemble.B @ ensemble.B.transpose(0, 2, 1)
    if ensemble.dt:
        total, state = np.zeros_like(q), np.broadcast_to(np.eye(n), a.shape)
        for _ in range(max(1, round(duration / ensemble.dt))):
            total = total + state @ q @ state.transpose(0, 2, 1)
            state = a @ state
        return total
    halvings = max(0, int(np.ceil(np.log2(max(norm * duration / SMALL, 1.0)))))
    h = duration / 2**halvings
    # Taylor series of W(h): its derivatives at 0 follow W' = A W + W A^T + Q.
    term, total = q * h, q * h
    phi, power = np.eye(n) + a * h, a * h
    for j in range(2, TERMS + 1):
        term = (a @ term + term @ a.transpose(0, 2, 1)) * (h / j)
        total = total + term
        power = power @ a * (h / j)
        phi = phi + power
    for _ in range(halvings):
        total = total + phi @ total @ phi.transpose(0, 2, 1)
        phi = phi @ phi
    return 0.5 * (total + total.transpose(0, 2, 1))
