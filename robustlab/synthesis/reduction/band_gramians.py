r"""Gramians of a stable model over a band of frequencies, from factors of them: quadrature along the axis.

.. math:: P = \frac{1}{\pi} \int_{\omega_1}^{\omega_2} \mathrm{Re} \, F(j\omega) B B^T F(j\omega)^* \, d\omega, \qquad
   Q = \frac{1}{\pi} \int_{\omega_1}^{\omega_2} \mathrm{Re} \, F(j\omega)^* C^T C F(j\omega) \, d\omega, \qquad
   F(s) = (sI - A)^{-1}

(discrete: F at exp(j omega dt), times dt). Each node of the rule gives two columns of the factor for each input, so
that small values keep their digits; the closed form by a matrix logarithm would subtract them from large ones.

References
----------
Gawronski, Juang, "Model reduction in limited time and frequency intervals", Int. J. Systems Science 21 (1990).
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import panel_ends
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.reduction.balancing import triangular_root

__all__ = ["band_gramian_factors"]

# Points of Gauss and Legendre's rule in a panel; how much wider panels get away from a pole, and beyond all of them.
NODES, GROWTH = 10, 4.0
# Frequencies at a time.
CHUNK = 1000


def band_gramian_factors(model: StateSpaceModel, low: float, high: float) -> tuple[AnyArray, AnyArray]:
    """Factors ``(L_c, L_o)`` of both Gramians over a band in rad/s, each (n, n); high may be infinite."""
    n = model.n_states
    if not n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    omega, weights = _rule(model, low, high)
    return _factor(model.A, model.B, model.dt, omega, weights), _factor(model.A.T, model.C.T, model.dt, omega, weights)


def _rule(model: StateSpaceModel, low: float, high: float) -> tuple[AnyArray, AnyArray]:
    """Nodes and weights over the band, in rad/s; continuous and beyond all poles in 1 / omega."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    poles: AnyArray = model.poles()
    if model.is_discrete:
        ends = panel_ends(np.log(poles[np.abs(poles) > 1e-12]) / model.dt, model.dt, GROWTH)
    else:
        ends = panel_ends(poles, 0.0, GROWTH)[:-1]
    last = ends[-1]
    inside = np.unique(np.concatenate([ends[(ends > low) & (ends < high)], [low, min(high, max(low, last))]]))
    half = 0.5 * np.diff(inside)
    at, weight = inside[:-1, None] + half[:, None] * (1 + x), half[:, None] * w
    omega, weights = [at.ravel()], [weight.ravel()]
    if high > last and not model.is_discrete:  # omega = 1 / t: the integrand is smooth in t down to t = 0
        near, far = 1 / max(low, last), 1 / high
        t = 0.5 * (near + far) + 0.5 * (near - far) * x
        omega.append(1 / t)
        weights.append(0.5 * (near - far) * w / t**2)
    return np.concatenate(omega), np.concatenate(weights)


def _factor(A: AnyArray, B: AnyArray, dt: float, omega: AnyArray, weights: AnyArray) -> AnyArray:
    n = len(A)
    if not B.size:
        return np.zeros((n, n))
    states = StateSpaceModel(A, B, np.eye(n), np.zeros((n, B.shape[1])), dt)
    root: AnyArray = np.zeros((0, n))
    for k in range(0, len(omega), CHUNK):
        part = slice(k, k + CHUNK)
        scale = np.sqrt(weights[part] * (dt or 1.0) / np.pi)
        x = (frequency_response(states, omega[part]) * scale[:, None, None]).transpose(0, 2, 1).reshape(-1, n)
        root = triangular_root(np.vstack([root, x.real, x.imag]))
    square = np.zeros((n, n))
    square[:, : len(root)] = root.T
    return square
