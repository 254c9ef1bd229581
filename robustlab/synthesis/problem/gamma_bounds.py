r"""What no controller can get below: lower bounds of the closed-loop norm that hold for every stabilising controller.

For a stabilising K the closed loop ``T = P11 + P12 Q P21`` with ``Q = K (I - P22 K)^{-1}`` is analytic in the right
half plane, so by the maximum principle its norm is at least ``sigma_max(T(s))`` for every s there. At a single s the
matrix Q(s) may be whatever it likes; what it cannot reach is left:

.. math::
    \|T\|_\infty \ge \max\left(\sigma_{max}(U_\perp^* P_{11}(s)),\ \sigma_{max}(P_{11}(s) V_\perp)\right),
    \qquad U_\perp^* P_{12}(s) = 0, \quad P_{21}(s) V_\perp = 0

(Parrott's bound). On the axis this is what no controller, causal or not, can do better; at a zero in the right half
plane it is the price of that zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.linear_analysis.magnitude import LARGEST, is_moderate
from robustlab.synthesis.problem.partition import PlantMatrices
from robustlab.synthesis.problem.scaling import Scaling

# Points of the right half plane: radii and angles of a polar grid. More: a little higher bounds.
RADII = 48
ANGLES = (0.0, 0.5, 1.0, 1.35, 1.5, math.pi / 2)
# Refinements around the best points, how many of them, and points that every scaling has to confirm.
REFINEMENTS = 4
REFINED = 3
CONFIRMED = 12

# Taken off every bound for rounding; an error of eps over CONDITION is far below it.
MARGIN = 1e-7
# In the plant's own time unit, a point nearer to zero than this is called zero.
AT_ZERO = 1e-9
# A column space is known to about eps over this; points where P12 or P21 is worse conditioned prove nothing.
CONDITION = 1e-7


@dataclass(frozen=True)
class GammaBound:
    """A lower bound of gamma and how it is known."""

    value: float  # no stabilising controller reaches a closed-loop norm below it; 0 where nothing was found
    known: str  # one sentence: proved at which point, or estimated how
    proved: bool  # False for an estimate

    def to_json(self) -> dict[str, object]:
        return vars(self).copy()


def pointwise_bound(
    p: PlantMatrices,
    scalings: Sequence[Scaling],
    dt: float = 0.0,
) -> GammaBound:
    """The largest of Parrott's bounds over points of the closed right half plane, refined around the best ones.

    ``p``: continuous plant without D22.
    ``scalings``: scalings of it. Points are searched on the first; a bound counts only as far as all of them give it,
    because they round differently.
    ``dt``: sample time in s of the discrete plant whose bilinear image p is; points are told in its z plane.
    """
    first = scalings[0]
    scaled = first.apply(p)
    points = _points(scaled)
    values = _bounds(scaled, points)
    for _ in range(REFINEMENTS):
        order = np.argsort(-values)[:REFINED]
        around = np.concatenate([_around(complex(points[k]), points) for k in order])
        points, values = np.concatenate([points, around]), np.concatenate([values, _bounds(scaled, around)])
    top = np.argsort(-values)[:CONFIRMED]
    points, values = points[top], values[top] / first.gain
    for scaling in scalings[1:]:
        values = np.minimum(values, _bounds(scaling.apply(p), points * first.rate / scaling.rate) / scaling.gain)
    at_infinity = float(_parrott(*(part[None].astype(complex) for part in (p.D11, p.D12, p.D21)))[0])
    best = int(np.argmax(values))
    zero, at_zero = min((_at_zeros(p, scaling) for scaling in scalings), key=lambda found: found[1])
    value = max(float(values[best]), at_infinity, at_zero) * (1 - MARGIN)
    if value <= 0:
        return GammaBound(0.0, "at no single frequency does anything keep gamma from zero", True)
    if at_zero >= max(float(values[best]), at_infinity):
        return GammaBound(value, f"proved at the zero {point_in_words(zero, dt)}", True)
    if at_infinity >= values[best]:
        return GammaBound(value, "proved: D11 leaves it at infinite frequency", True)
    point = complex(points[best])
    place = point_in_words(point * first.rate if abs(point) > AT_ZERO else 0j, dt)
    return GammaBound(value, f"proved at {place}", True)


def point_in_words(s: complex, dt: float = 0.0) -> str:
    """A point of the closed right half plane in rad/s (of the z plane, with dt), and what the bound there says."""
    if abs(s.real) <= 1e-9 * abs(s):
        omega = 2 / dt * np.arctan(abs(s.imag) * dt / 2) if dt else abs(s.imag)
        return f"{omega:.4g} rad/s: no controller, causal or not, can do better"
    point = (2 / dt + s) / (2 / dt - s) if dt else s
    text = f"{point.real:.4g}" if abs(point.imag) <= 1e-3 * abs(point) else f"{point.real:.4g}{point.imag:+.4g}j"
    if dt:
        return f"z = {text}: no stable loop can do better at this point outside the unit circle"
    return f"s = {text} rad/s: no stable loop can do better at this point of the right half plane"


def _points(
    p: PlantMatrices,
) -> AnyArray:
    """Points of the closed right half plane: polar grid, mirror images and neighbours of the poles."""
    poles = np.linalg.eigvals(p.A) if p.A.size else np.zeros(0)
    size = np.abs(poles)[np.abs(poles) > AT_ZERO]
    low, high = (size.min() / 30, size.max() * 30) if len(size) else (1e-2, 1e2)
    polar = np.geomspace(low, high, RADII)[:, None] * np.exp(1j * np.array(ANGLES))
    near = np.abs(poles.real) * 1.001 + 1j * np.abs(poles.imag)
    return np.concatenate([polar.ravel(), near, 1j * np.abs(poles), [0.0]])


def _at_zeros(p: PlantMatrices, scaling: Scaling) -> tuple[complex, float]:
    """The right half plane zero of P12 or P21, where square, that costs most, and its bound, in the plant's units."""
    q = scaling.apply(p)
    best: tuple[complex, float] = (0j, 0.0)
    for A, B1, B2, C1, D11, D12 in ((q.A, q.B1, q.B2, q.C1, q.D11, q.D12),
                                    (q.A.T, q.C1.T, q.C2.T, q.B1.T, q.D11.T, q.D21.T)):  # fmt: skip
        for zero, direction in _zero_directions(A, B2, C1, D12):
            response = C1 @ np.linalg.solve(zero * np.eye(len(A)) - A, B1.astype(complex)) + D11
            value = float(np.linalg.norm(direction @ response)) / scaling.gain
            if np.isfinite(value) and value > best[1]:
                best = (zero * scaling.rate, value)
    return best


def _zero_directions(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray) -> list[tuple[complex, AnyArray]]:
    """Zeros of a square system in the open right half plane, with the unit row v for which ``v G(zero) = 0``."""
    from scipy.linalg import eigvals

    n, m = B.shape
    if n == 0 or C.shape[0] != m:
        return []
    whole, shift = np.block([[A, B], [C, D]]).astype(complex), np.zeros((n + m, n + m))
    shift[:n, :n] = np.eye(n)
    zeros, poles = np.asarray(eigvals(whole, shift, check_finite=False)), np.linalg.eigvals(A)
    found: list[tuple[complex, AnyArray]] = []
    for zero in zeros[np.isfinite(zeros)]:
        size = abs(zero)
        if zero.real <= 1e-9 * size or size > 1e8 * np.linalg.norm(whole) or np.abs(poles - zero).min() < 1e-6 * size:
            continue
        u, sigma, _ = np.linalg.svd(whole - zero * shift)
        direction = u[n:, -1].conj()
        length = float(np.linalg.norm(direction))
        if sigma[-1] <= 1e-10 * sigma[0] and sigma[-2] > 1e-6 * sigma[0] and length > 1e-6:
            found.append((complex(zero), direction / length))
    return found


def _around(centre: complex, points: AnyArray) -> AnyArray:
    """Points between the centre and its neighbours, in the closed right half plane."""
    distance = np.abs(points - centre)
    step = distance[distance > 0].min(initial=np.inf)
    if not np.isfinite(step):
        return np.zeros(0, complex)
    turn = np.exp(2j * np.pi * np.arange(8) / 8)
    near = centre + step * np.concatenate([0.35 * turn, 0.7 * turn])
    on_axis = 1j * (centre.imag + step * np.array([-0.7, -0.35, 0.35, 0.7])) if centre.real == 0 else np.zeros(0)
    return np.concatenate([np.maximum(near.real, 0.0) + 1j * near.imag, on_axis])


def _bounds(p: PlantMatrices, s: AnyArray) -> AnyArray:
    n, n_w, _, n_z, _ = p.sizes
    B, C = np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2])
    D = np.block([[p.D11, p.D12], [p.D21, np.zeros((p.D21.shape[0], p.D12.shape[1]))]])
    try:
        P = C @ np.linalg.solve(s[:, None, None] * np.eye(n) - p.A, B[None].astype(complex)) + D
    except np.linalg.LinAlgError:  # one of the points is a pole to the last digit
        s = s * (1 + 1e-7) + 1e-12
        try:
            P = C @ np.linalg.solve(s[:, None, None] * np.eye(n) - p.A, B[None].astype(complex)) + D
        except np.linalg.LinAlgError:
            return np.zeros(len(s))
    usable = np.asarray((np.abs(P) < LARGEST).all(axis=(1, 2)))  # and no NaN
    P = np.where(usable[:, None, None], P, 0.0)
    # Close to a pole P11 and P12 Q P21 are large and nearly cancel: such a point proves nothing in floating point.
    calm = np.linalg.norm(P, axis=(1, 2)) < 1e8
    return np.where(usable & calm, _parrott(P[:, :n_z, :n_w], P[:, :n_z, n_w:], P[:, n_z:, :n_w]), 0.0)


def _parrott(P11: AnyArray, P12: AnyArray, P21: AnyArray) -> AnyArray:
    left = _unreached(P12)
    right = _unreached(P21.conj().transpose(0, 2, 1))
    parts = [left.conj().transpose(0, 2, 1) @ P11, P11 @ right]
    values = [np.linalg.norm(part, 2, axis=(1, 2)) if part.size else np.zeros(len(P11)) for part in parts]
    return np.maximum(*values)


def _unreached(M: AnyArray) -> AnyArray:
    """Orthonormal basis of the complement of the columns of each M; zero where M is too ill-conditioned to tell."""
    rows, columns = M.shape[1:]
    if rows <= columns:
        return np.zeros((len(M), rows, 0), complex)
    if not is_moderate(M):  # what the columns span does not depend on their length
        M = M / np.maximum(np.abs(M).max(axis=1, keepdims=True), np.finfo(float).tiny)
    size = np.linalg.norm(M, axis=1, keepdims=True)
    u, sigma, _ = np.linalg.svd(M / np.where(size > 0, size, 1.0))
    # A column that is zero leaves more room than is counted here: the bound stays valid.
    kept = np.where(size[:, 0] > 0, 1.0, 0.0).sum(axis=1) == columns
    clear = (sigma[:, -1] > CONDITION * sigma[:, 0]) & kept
    return np.where(clear[:, None, None], u[:, :, columns:], 0.0)
