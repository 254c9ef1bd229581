"""Gain of a closed loop inside a search: quick, attained at a frequency, not proved.

What leaves a search is verified by `robustlab.norms.hinf_norm`; this only ranks candidates.
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.matrix_equations import balanced_eigenvalues
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation

__all__ = ["closed", "loop_gain", "responses", "trial_frequencies"]


ACCURACY = 1e-5
LEVELS = 12
GRID_PER_DECADE, LARGEST_GRID = 4, 60


def closed(p: PlantMatrices, K: Realisation) -> Realisation:
    """The loop from w to z for ``u = K y`` on a plant without D22."""
    by_y, by_w = p.B2 @ K.D, p.D12 @ K.D
    return Realisation(
        np.block([[p.A + by_y @ p.C2, p.B2 @ K.C], [K.B @ p.C2, K.A]]),
        np.vstack([p.B1 + by_y @ p.D21, K.B @ p.D21]),
        np.hstack([p.C1 + by_w @ p.C2, p.D12 @ K.C]),
        p.D11 + by_w @ p.D21,
    )


def trial_frequencies(poles: AnyArray) -> AnyArray:
    """Zero, the poles' frequencies and resonances, and a coarse grid around them."""
    size = np.abs(poles)
    size = size[size > 0]
    if not len(size):
        return np.array([0.0, 1.0])
    low, high = size.min() / 10, size.max() * 10
    points = int(np.clip(GRID_PER_DECADE * np.log10(high / low), 8, LARGEST_GRID))
    upper: AnyArray = poles[np.imag(poles) >= 0]
    resonance = np.sqrt(np.maximum(np.imag(upper) ** 2 - np.real(upper) ** 2, 0.0))
    omega = np.sort(np.concatenate([np.abs(upper), np.imag(upper), resonance, np.geomspace(low, high, points)]))
    omega = omega[omega > 0]
    # Frequencies closer than a share of the nearest pole's damping tell nothing new; keep all that are apart.
    return np.concatenate([[0.0], omega[np.append(True, np.diff(omega) > 1e-6 * omega[1:])]])


def responses(loop: Realisation, omega: AnyArray) -> AnyArray:
    """``C (jw - A)^-1 B + D`` at each frequency, shape (n_omega, n_z, n_w); infinite where w hits a pole."""
    n = loop.A.shape[0]
    if n == 0:
        return np.broadcast_to(loop.D.astype(complex), (len(omega), *loop.D.shape))
    try:
        shifted = 1j * omega[:, None, None] * np.eye(n) - loop.A
        if loop.B.shape[1] <= loop.C.shape[0]:
            return loop.C @ np.linalg.solve(shifted, loop.B[None].astype(complex)) + loop.D
        left = np.linalg.solve(shifted.transpose(0, 2, 1), loop.C.T[None].astype(complex))
        return left.transpose(0, 2, 1) @ loop.B + loop.D
    except np.linalg.LinAlgError:
        return np.full((len(omega), *loop.D.shape), np.inf + 0j)


def _largest(loop: Realisation, omega: AnyArray) -> float:
    response = responses(loop, omega)
    if not np.isfinite(response).all():
        return np.inf
    if 1 in response.shape[1:]:
        return float(np.linalg.norm(response, axis=(1, 2)).max())
    return float(np.linalg.svd(response, compute_uv=False)[:, 0].max())


def loop_gain(loop: Realisation, limit: float = np.inf) -> float:
    """H-infinity norm of a loop to about 1e-5, from below; infinite for an unstable loop and above ``limit``."""
    if not all(np.isfinite(part).all() for part in loop):
        return np.inf
    if not loop.D.size:
        return 0.0
    gain = float(np.linalg.norm(loop.D, 2))
    if not loop.A.size:
        return gain
    poles = np.linalg.eigvals(loop.A)
    if poles.real.max() >= 0 or gain > limit:
        return np.inf
    gain = max(gain, _largest(loop, trial_frequencies(poles)))
    for _ in range(LEVELS):
        if gain > limit or not np.isfinite(gain):
            return np.inf
        level = gain * (1 + ACCURACY)
        omega = _crossings(loop, level)
        if not len(omega):
            break
        found = _largest(loop, omega)
        if found <= level:
            break
        gain = found
    return gain if gain <= limit else np.inf


def _crossings(loop: Realisation, level: float) -> AnyArray:
    """Frequencies at which a singular value may cross the level, and points between them."""
    if level <= 0:
        return np.zeros(0)
    root = np.sqrt(level)
    b, c, d = loop.B / root, loop.C / root, loop.D / level
    try:
        r = np.linalg.solve(np.eye(d.shape[1]) - d.T @ d, np.hstack([d.T @ c, b.T]))
        s = np.linalg.solve(np.eye(d.shape[0]) - d @ d.T, c)
    except np.linalg.LinAlgError:
        return np.zeros(0)
    n = loop.A.shape[0]
    a1 = loop.A + b @ r[:, :n]
    hamiltonian = np.block([[a1, b @ r[:, n:]], [-c.T @ s, -a1.T]])
    values = balanced_eigenvalues(hamiltonian)
    if values is None:
        return np.zeros(0)
    size = np.abs(values)
    near = np.abs(np.real(values)) < np.maximum(1e-4 * size, 1e-10 * size.max())
    crossing = np.unique(np.abs(np.imag(values)[near]))
    if not len(crossing):
        return crossing
    return np.concatenate([crossing, 0.5 * (crossing[:-1] + crossing[1:]), [0.5 * crossing[0], 1.5 * crossing[-1]]])
