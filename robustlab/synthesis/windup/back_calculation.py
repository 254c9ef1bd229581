r"""Anti-windup of a digital controller by back-calculation: :math:`x_{k+1} = (A - L C) x_k + (B - L D) u_k + L v_k`.

With A - L C stable the states stay bounded while all outputs v = sat(y) saturate; nothing is proved where only some of
several outputs saturate.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel

# Modes are mirrored at exp(-MIRROR dt / T), a little inside the limit of slow modes.
MIRROR = 1.5


def back_calculation(model: StateSpaceModel, limits: Any, time: float) -> Array:
    """Return the gain L of back-calculation (n, p): with all outputs saturated every mode decays within ``time``."""
    if not time >= model.dt:
        raise InputError("anti-windup", f"a time of {time:g} s", f"at least one sample time, {model.dt:g} s")
    scale = np.array([0.5 * (high - low) for low, high in limits])
    slowest = math.exp(-model.dt / time)
    gain = _mirroring_gain(model.A, model.C / scale[:, None], slowest, math.exp(-MIRROR * model.dt / time))
    found = np.zeros((model.n_states, model.n_outputs)) if gain is None else gain / scale
    radius = float(np.abs(np.linalg.eigvals(model.A - found @ model.C)).max(initial=0.0))
    if radius > slowest * (1 + 1e-6):
        raise InputError(
            "anti-windup",
            f"a mode of modulus {radius:.6g} that does not show in the control signals",
            f"modes slower than {time:g} s that do",
            "take it out first (robustlab synth reduce), or allow a longer time",
        )
    return found


def _mirroring_gain(A: Array, C: Array, slowest: float, mirror: float) -> Array | None:
    """Return L for outputs scaled to one; None if no mode is slow."""
    from scipy.linalg import schur, solve_discrete_lyapunov

    if not A.size:
        return None
    ordered: Any = schur(A.T, output="complex", sort=lambda pole: abs(pole) <= slowest * (1 + 1e-12))
    T, Z, n_fast = ordered
    if n_fast == len(A):
        return None
    F, modes = T[n_fast:, n_fast:] / mirror, Z[:, n_fast:]
    G = modes.conj().T @ C.T / mirror
    inverse = np.linalg.inv(F)
    driven = inverse @ G
    Y = solve_discrete_lyapunov(inverse, driven @ driven.conj().T)
    X = np.linalg.pinv(Y, rcond=1e-13, hermitian=True)
    feedback = np.linalg.solve(np.eye(G.shape[1]) + G.conj().T @ X @ G, G.conj().T @ X @ F)
    return (feedback @ modes.conj().T).real.T
