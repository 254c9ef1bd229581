"""The bilinear map between continuous and discrete time: it keeps stability and the H-infinity norm."""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balancing_factors, refuse_overflow
from robustlab.statespace import StateSpaceModel

EPS = float(np.finfo(float).eps)
# Poles in z above this modulus become s = 2/dt to the last digit.
OUTSIDE = 1e15


def bilinear_to_continuous(model: StateSpaceModel) -> StateSpaceModel:
    """Return the continuous model ``G_c(s) = G(z)`` under ``s = (2/dt)(z - 1)/(z + 1)``, of the same norm."""
    t, m, one, a = *_in_balanced_states(model), np.eye(model.n_states), 2 / model.dt
    if model.n_states and float(np.abs(np.linalg.eigvals(m)).max()) > OUTSIDE:
        found = f"a pole of modulus above {OUTSIDE:g}: the map cannot distinguish it from infinity"
        raise NoTrustworthyNumber("bilinear map", found, None, "a shorter sample time")
    if _is_singular(one + m, 1e12):
        raise NoTrustworthyNumber("bilinear map", "a pole at z = -1 has no place in continuous time")
    e = np.linalg.inv(one + m)
    return _mapped(model, 0.0, t, a * e @ (m - one), e, a)


def bilinear_to_discrete(model: StateSpaceModel, dt: float) -> StateSpaceModel:
    """Invert `bilinear_to_continuous` (Tustin's rule, with the input and output scaling that keeps Gramians)."""
    t, m, one, a = *_in_balanced_states(model), np.eye(model.n_states), 2 / dt
    if _is_singular(a * one - m, 1e14):
        raise NoTrustworthyNumber("bilinear map", f"a pole at s = 2/dt = {a:g} has no place in discrete time")
    e = np.linalg.inv(a * one - m)
    return _mapped(model, dt, t, e @ (a * one + m), e, a)


def _mapped(model: StateSpaceModel, dt: float, t: AnyArray, A: AnyArray, e: AnyArray, a: float) -> StateSpaceModel:
    """Return the mapped model in the original states, from the balanced states ``x / t``."""
    b, c, root = model.B / t[:, None], model.C * t, np.sqrt(2 * a)
    with np.errstate(over="ignore", invalid="ignore"):
        A, B, C = t[:, None] * A / t, t[:, None] * (root * e @ b), root * c @ e / t
        D = model.D + c @ e @ b if dt else model.D - c @ e @ b
        if not dt:  # Cancellation to rounding is zero: later scalings would take a direct path of 1e-17 for one.
            D[np.abs(D) <= 16 * EPS * (np.abs(model.D) + np.abs(c @ e) @ np.abs(b))] = 0.0
    refuse_overflow("bilinear map", A, B, C, D)
    signals = model.inputs, model.outputs, model.states
    return StateSpaceModel(A, B, C, D, dt, *signals, where="bilinear map")


def _is_singular(matrix: AnyArray, limit: float) -> bool:
    """Return whether the condition number exceeds ``limit`` with rows of one length: one fast pole is not singular."""
    if not matrix.size or np.linalg.cond(matrix) <= limit:
        return False
    length = np.abs(matrix).max(axis=1, keepdims=True)
    return not length.all() or bool(np.linalg.cond(matrix / length) > limit)


def _in_balanced_states(model: StateSpaceModel) -> tuple[AnyArray, AnyArray]:
    """Return factors t, and A in the states ``x / t``, where condition numbers depend on poles only."""
    t = balancing_factors(model.A)
    return t, model.A / t[:, None] * t
