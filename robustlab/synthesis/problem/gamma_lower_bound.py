"""Lower bound of gamma for all controllers: Parrott's bound at points of the closed right half plane.

The closed loop T = P11 + P12 Q P21 is analytic there, so its norm is at least that of the part of P11(s) outside the
ranges of P12 and P21.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.display import AllFields
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.synthesis.problem.generalized_plant import (
    GeneralizedPlant,
    PlantMatrices,
    Scaling,
    dual,
    equilibrated,
    paths_first,
)

# sigma_min of the Popov-Belevitch-Hautus matrix below this share of its norm counts as rank loss.
PBH_TOLERANCE = 1e-11
WEAK = 1e-6  # channels weaker than this share of the fastest pole are scaled up to it before the test
AXIS = 1e-10  # real parts within this share of the largest modulus count as "on the axis"
DIRECT = 1e-6  # a singular value of D12 or D21 below this (plant scaled to order one) is regularised
# sigma_min of the system matrix below this share of its norm is a zero; candidates this near to the axis are tested.
ZERO, NEAR = 1e-9, 1e-5


def require_stabilisable(p: PlantMatrices, states: tuple[str, ...], where: str, rate: float = 1.0) -> None:
    """Apply the Popov-Belevitch-Hautus test to all unstable and marginal modes."""
    if not p.A.size:
        return
    poles = np.linalg.eigvals(p.A)
    size = max(float(np.abs(poles).max()), 1e-300)
    # The strength of a control or a measurement depends on its unit: each counts as if it were as large as A.
    into, out = _like(p.B2, 0, size), _like(p.C2, 1, size)
    faults: list[str] = []
    for pole in poles[(poles.real >= -AXIS * size) & (poles.imag >= 0)]:
        shifted = p.A - pole * np.eye(p.A.shape[0])
        for matrix, text in (
            (np.hstack([shifted, into]).conj().T, "cannot be moved by the controls"),
            (np.vstack([shifted, out]), "does not show in the measurements"),
        ):
            state = _null_state(matrix)
            if state is not None:
                kind = "unstable" if pole.real > AXIS * size else "marginal"
                s = rate * (pole.real if abs(pole.imag) <= AXIS * abs(pole) else pole)
                faults.append(f"{kind} mode s = {s:.6g} rad/s (mostly state {states[state]}) {text}")
    if faults:
        hint = "add an actuator or a sensor for it; rl.minimal takes out what is hidden from all signals"
        found = f"no stabilising controller exists: {faults[0]}"
        raise NoTrustworthyNumber(where, found, hint=hint, more=tuple(dict.fromkeys(faults[1:])))


def _like(matrix: AnyArray, axis: int, size: float) -> AnyArray:
    """Scale columns (axis 0) or rows (axis 1) up to ``size`` that would else be indistinguishable from rounding."""
    norms = np.linalg.norm(matrix, axis=axis, keepdims=True)
    weak = (norms > 0) & (norms < WEAK * size)
    return matrix * np.where(weak, size / np.where(weak, norms, 1.0), 1.0)


def _null_state(matrix: AnyArray) -> int | None:
    """Return the index of the largest entry of the null vector of a tall matrix; None if it has full column rank."""
    n = matrix.shape[1]
    _, sigma, vh = np.linalg.svd(matrix)
    if len(sigma) == n and sigma[-1] > PBH_TOLERANCE * max(float(sigma[0]), 1.0):
        return None
    return int(np.argmax(np.abs(vh[n - 1])))


def broken_assumptions(p: PlantMatrices, plant: GeneralizedPlant, rate: float = 1.0) -> tuple[str, ...]:
    """Return the assumptions of the Riccati method that the plant violates, each with its physical meaning."""
    controls, measurements = ([s.name for s in group] for group in (plant.controls, plant.measurements))
    found = [
        f"{name} has no direct penalty: no performance output limits how fast it may act (D12 lacks column rank)"
        for name in _free_channels(p.D12, controls, "control")
    ]
    found += [
        f"{name} has no direct noise: nothing limits how much it may be differentiated (D21 lacks row rank)"
        for name in _free_channels(p.D21.T, measurements, "measurement")
    ]
    states = plant.model.state_names
    missing = ("performance output showing it", "disturbance driving it through the measurements")
    for side, text in zip((p, dual(p)), missing, strict=True):
        found += [
            f"zero on the axis at {omega * (omega * rate > 1e-9) * rate:.4g} rad/s: a motion mostly of {states[state]} "
            f"can go on undamped without any {text}"
            for omega, state in _axis_zeros(side.A, side.B2, side.C1, side.D12)
        ]
    return tuple(found)


def _free_channels(D: Array, names: list[str], kind: str) -> list[str]:
    """Return the channels, or combinations of channels, in the null space of the columns of D."""
    _, sigma, vh = np.linalg.svd(D)
    rank = int((sigma > DIRECT * max(1.0, sigma.max(initial=0.0))).sum())
    free = []
    for row in vh[rank:]:
        main = np.flatnonzero(np.abs(row) > 0.1)
        if len(main) == 1:
            free.append(f"{kind} {names[main[0]]}")
        else:
            free.append(f"a combination of the {kind}s {', '.join(names[i] for i in main)}")
    return list(dict.fromkeys(free))


def _axis_zeros(A: Any, B: Any, C: Any, D: Any) -> list[tuple[float, int]]:
    """Return the frequencies at which ``[A - jw, B; C, D]`` loses column rank, with the state of largest share."""
    n, m = B.shape
    if n == 0 or len(C) < m:
        return []
    found, whole = list[tuple[float, int]](), np.block([[A, B], [C, D]]).astype(complex)
    size = float(np.linalg.norm(whole, 2))
    for zero in slicot.invariant_zeros(A, B, C, D)[0]:
        if abs(zero.real) > NEAR * max(abs(zero), 1e-3 * size) or zero.imag < 0:
            continue
        matrix = whole.copy()
        matrix[range(n), range(n)] -= 1j * zero.imag
        _, sigma, vh = np.linalg.svd(matrix)
        if sigma[n + m - 1] <= ZERO * size and not any(abs(zero.imag - w) <= 1e-6 * size for w, _ in found):
            found.append((float(zero.imag), int(np.argmax(np.abs(vh[n + m - 1, :n])))))
    return sorted(found)


RADII = 48  # points of the right half plane: radii and angles of a polar grid. More: a little higher bounds
ANGLES = (0.0, 0.5, 1.0, 1.35, 1.5, math.pi / 2)
# Refinements around the best points, number of these, and of points that every scaling has to confirm.
REFINEMENTS = 4
REFINED = 3
CONFIRMED = 12

# Share subtracted from every bound, as rounding is counted to first order; factor of eps in that count.
MARGIN, ROUNDING = 1e-7, 4.0
AT_ZERO = 1e-9  # a point nearer to zero than this counts as zero, in the plant's own time unit
# A column space is known to about eps over this; points where P12 or P21 is worse conditioned prove nothing.
CONDITION = 1e-7
LARGEST = 1e50  # responses beyond it prove nothing


@dataclass(frozen=True)
class GammaBound(AllFields):
    """A lower bound of gamma and how it is known."""

    value: float  # no stabilising controller reaches a closed-loop norm below it; 0 where nothing was found
    known: str  # one sentence: the point at which it is proved, or how it is estimated
    proved: bool  # False for an estimate


def gamma_bound(plant: GeneralizedPlant) -> GammaBound:
    """Return a lower bound of gamma over all stabilising controllers of this plant."""
    p = plant.continuous().matrices()
    return pointwise_bound(p, (paths_first(p), equilibrated(p)), plant.model.dt)


def pointwise_bound(p: PlantMatrices, scalings: Sequence[Scaling], dt: float = 0.0) -> GammaBound:
    """Return the largest of Parrott's bounds over points of the closed right half plane, refined at the best ones."""
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
    at_infinity = max(
        float(_parrott(first[None], second[None], 0.0 * first[None], 0.0 * second[None])[0])
        for first, second in ((p.D11, p.D12), (p.D11.T, p.D21.T))
    )
    best = int(np.argmax(values))
    point = complex(points[best])
    place = point * first.rate if abs(point) > AT_ZERO else 0j
    zero, at_zero = min((_at_zeros(p, scaling) for scaling in scalings), key=lambda found: found[1])
    value, known = max(
        (at_zero, f"proved at the zero {point_in_words(zero, dt)}"),
        (at_infinity, "proved: D11 leaves it at infinite frequency"),
        (float(values[best]), f"proved at {point_in_words(place, dt)}"),
        key=lambda found: found[0],
    )
    known = known if value > 0 else "at no single frequency does anything keep gamma from zero"
    return GammaBound(max(value * (1 - MARGIN), 0.0), known, True)


def point_in_words(s: complex, dt: float = 0.0) -> str:
    """Return a point of the closed right half plane in rad/s (z plane with dt), and the meaning of its bound."""
    if abs(s.real) <= 1e-9 * abs(s):
        omega = 2 / dt * np.arctan(abs(s.imag) * dt / 2) if dt else abs(s.imag)
        return f"{omega:.4g} rad/s: no controller, causal or not, can do better"
    point = (2 / dt + s) / (2 / dt - s) if dt else s
    text = f"{point.real:.4g}" if abs(point.imag) <= 1e-3 * abs(point) else f"{point.real:.4g}{point.imag:+.4g}j"
    if dt:
        return f"z = {text}: no stable loop can do better at this point outside the unit circle"
    return f"s = {text} rad/s: no stable loop can do better at this point of the right half plane"


def _points(p: PlantMatrices) -> AnyArray:
    """Return points of the closed right half plane: polar grid, mirror images and neighbours of the poles."""
    poles = np.linalg.eigvals(p.A) if p.A.size else np.zeros(0)
    size = np.abs(poles)[np.abs(poles) > AT_ZERO]
    low, high = (size.min() / 30, size.max() * 30) if len(size) else (1e-2, 1e2)
    polar = np.geomspace(low, high, RADII)[:, None] * np.exp(1j * np.array(ANGLES))
    near = np.abs(poles.real) * 1.001 + 1j * np.abs(poles.imag)
    return np.concatenate([polar.ravel(), near, 1j * np.abs(poles), [0.0]])


def _at_zeros(p: PlantMatrices, scaling: Scaling) -> tuple[complex, float]:
    """Return the right half plane zero of P12 or P21 (if square) of the largest bound, and that bound, unscaled."""
    q = scaling.apply(p)
    best: tuple[complex, float] = (0j, 0.0)
    for side in (q, dual(q)):
        if len(side.C1) != side.B2.shape[1] or not len(side.A):
            continue
        zeros = slicot.invariant_zeros(side.A, side.B2, side.C1, side.D12)[0]  # hidden modes among them
        for zero in zeros[zeros.real > 1e-9 * np.abs(zeros)].tolist():
            value = _cost_of_zero(side, zero) / scaling.gain
            if value > best[1]:
                best = (zero * scaling.rate, value)
    return best


def _cost_of_zero(p: PlantMatrices, zero: complex) -> float:
    """Return ``|v P11|`` at the zero of P12 next to this one, less rounding of both; 0 if P12 has no zero there."""
    # With v P12 = 0 to rounding, the true zero is within (|v P12| + e) / |v P12' u|.
    A, B, C, n_w = p.A, np.hstack([p.B1, p.B2]), p.C1, p.B1.shape[1]
    (P,), (error,) = _responses(A, B, C, np.hstack([p.D11, p.D12]), np.array([zero]))
    if not (np.isfinite(P).all() and np.isfinite(error).all()):
        return 0.0
    left, sigma, right = np.linalg.svd(P[:, n_w:])
    v, u, rounding = left[:, -1].conj(), right[-1].conj(), float(np.linalg.norm(error[:, n_w:]))
    if sigma[-1] > 4 * rounding:  # a hidden mode, not a zero of the response
        return 0.0
    X = np.linalg.inv(zero * np.eye(len(A)) - A)
    slope = -C @ X @ X @ B
    distance = (sigma[-1] + rounding) / max(abs(v @ slope[:, n_w:] @ u), np.finfo(float).tiny)
    turned = (distance * np.linalg.norm(slope[:, n_w:]) + rounding) / sigma[-2] if len(sigma) > 1 else 0.0
    lost = np.linalg.norm(error[:, :n_w]) + distance * np.linalg.norm(slope[:, :n_w])
    value = float(np.linalg.norm(v @ P[:, :n_w]) - lost - turned * np.linalg.norm(P[:, :n_w]))
    return value if distance < 1e-3 * zero.real else 0.0


def _around(centre: complex, points: AnyArray) -> AnyArray:
    """Return points between the centre and its neighbours, in the closed right half plane."""
    distance = np.abs(points - centre)
    step = distance[distance > 0].min(initial=np.inf)
    if not np.isfinite(step):
        return np.zeros(0, complex)
    turn = np.exp(2j * np.pi * np.arange(8) / 8)
    near = centre + step * np.concatenate([0.35 * turn, 0.7 * turn])
    on_axis = 1j * (centre.imag + step * np.array([-0.7, -0.35, 0.35, 0.7])) if centre.real == 0 else np.zeros(0)
    return np.concatenate([np.maximum(near.real, 0.0) + 1j * near.imag, on_axis])


def _bounds(p: PlantMatrices, s: AnyArray) -> AnyArray:
    _, n_w, _, n_z, _ = p.sizes
    P, error = _responses(*p.whole(), s)
    usable = np.asarray((np.abs(P) < LARGEST).all(axis=(1, 2)) & (error < LARGEST).all(axis=(1, 2)))  # and no NaN
    P, error = (np.where(usable[:, None, None], part, 0.0) for part in (P, error))
    upright = (P[:, :n_z, :n_w], P[:, :n_z, n_w:], error[:, :n_z, :n_w], error[:, :n_z, n_w:])
    turned = (P[:, :n_z, :n_w], P[:, n_z:, :n_w], error[:, :n_z, :n_w], error[:, n_z:, :n_w])
    return np.maximum(_parrott(*upright), _parrott(*(part.conj().transpose(0, 2, 1) for part in turned)))


def _responses(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return ``C (s I - A)^-1 B + D`` at each s, and the rounding error of each entry."""
    shifted = s[:, None, None] * np.eye(len(A)) - A
    try:
        inverse = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:  # some point is a pole to the last digit: no bound there
        shifted[np.linalg.slogdet(shifted)[0] == 0] = np.nan
        inverse = np.linalg.inv(shifted)
    before, after = C @ inverse, inverse @ B
    left, right = np.abs(before), np.abs(after)
    terms = left @ (np.abs(shifted) @ right) + np.abs(C) @ right + left @ np.abs(B) + np.abs(D)
    return C @ after + D, ROUNDING * np.finfo(float).eps * terms


def _parrott(P11: AnyArray, P12: AnyArray, error11: AnyArray, error12: AnyArray) -> AnyArray:
    """Return the part of each P11 outside the range of P12, less the error ``|e11| + |e12| |P11| / s_min``."""
    rows, columns = P12.shape[1:]
    if rows <= columns:
        return np.zeros(len(P12))
    size = np.linalg.norm(P12, axis=1, keepdims=True)  # the span of columns does not depend on their lengths
    # A zero column spans less than is counted here: the bound stays valid.
    kept = (size[:, 0] > 0).all(axis=1)
    size = np.where(size > 0, size, 1.0)
    u, sigma, _ = np.linalg.svd(P12 / size)
    least = np.where(kept & (sigma[:, -1] > CONDITION * sigma[:, 0]), sigma[:, -1], np.inf)
    value = np.linalg.norm(u[:, :, columns:].conj().transpose(0, 2, 1) @ P11, 2, axis=(1, 2))
    turned = np.linalg.norm(error12 / size, axis=(1, 2)) / least * np.linalg.norm(P11, axis=(1, 2))
    lost = np.linalg.norm(error11, axis=(1, 2)) + turned
    return np.where(np.isfinite(least), np.maximum(value - lost, 0.0), 0.0)
