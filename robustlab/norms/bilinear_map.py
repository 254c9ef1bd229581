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
    a = 2 / model.dt
    t, m, b, c = _in_balanced_states(model)
    plus = np.eye(model.n_states) + m
    if model.n_states and float(np.abs(np.linalg.eigvals(m)).max()) > OUTSIDE:
        found = f"a pole of modulus above {OUTSIDE:g}: the map cannot tell it from infinity"
        raise NoTrustworthyNumber("bilinear map", found, None, "a shorter sample time")
    if _is_singular(plus, 1e12):
        raise NoTrustworthyNumber("bilinear map", "a pole at z = -1 has no place in continuous time")
    e, root = np.linalg.inv(plus), np.sqrt(2 * a)
    with np.errstate(over="ignore", invalid="ignore"):
        D = model.D - c @ e @ b
        # Cancellation to rounding is zero: later scalings would take a direct path of 1e-17 for one.
        D[np.abs(D) <= 16 * EPS * (np.abs(model.D) + np.abs(c @ e) @ np.abs(b))] = 0.0
        return _mapped(model, 0.0, t, a * e @ (m - np.eye(model.n_states)), root * e @ b, root * c @ e, D)


def bilinear_to_discrete(model: StateSpaceModel, dt: float) -> StateSpaceModel:
    """Invert `bilinear_to_continuous` (Tustin's rule, with the input and output scaling that keeps Gramians)."""
    a = 2 / dt
    t, m, b, c = _in_balanced_states(model)
    minus = a * np.eye(model.n_states) - m
    if _is_singular(minus, 1e14):
        raise NoTrustworthyNumber("bilinear map", f"a pole at s = 2/dt = {a:g} has no place in discrete time")
    e, root = np.linalg.inv(minus), np.sqrt(2 * a)
    with np.errstate(over="ignore", invalid="ignore"):
        D = model.D + c @ e @ b
        return _mapped(model, dt, t, e @ (a * np.eye(model.n_states) + m), root * e @ b, root * c @ e, D)


def _mapped(
    model: StateSpaceModel, dt: float, t: AnyArray, A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray
) -> StateSpaceModel:
    """Return the mapped model in the original states, from the balanced states ``x / t``."""
    A, B, C = t[:, None] * A / t, t[:, None] * B, C / t
    refuse_overflow("bilinear map", A, B, C, D)
    signals = model.inputs, model.outputs, model.states
    return StateSpaceModel(A, B, C, D, dt, *signals, where="bilinear map")


def _is_singular(matrix: AnyArray, limit: float) -> bool:
    """Return whether the condition number exceeds ``limit`` with rows of one length: one fast pole is not singular."""
    if not matrix.size or np.linalg.cond(matrix) <= limit:
        return False
    length = np.abs(matrix).max(axis=1, keepdims=True)
    return not length.all() or bool(np.linalg.cond(matrix / length) > limit)


def _in_balanced_states(model: StateSpaceModel) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return factors t, and A, B, C in the states ``x / t``, where condition numbers depend on poles only."""
    t = balancing_factors(model.A)
    return t, model.A / t[:, None] * t, model.B / t[:, None], model.C * t
