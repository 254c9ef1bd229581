"""A controller for the plant as given, from one for its bare matrices: direct term, states, names, the rebuilt loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import balancing_factors, refuse_overflow
from robustlab.norms.hinfinity import eigenvalue_blur
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant

# Above this condition number of I + D_K D22 the controller with D22 taken back in has lost its digits.
ILL_POSED = 1e10


def with_direct_term(K: StateSpaceModel, D22: Array) -> StateSpaceModel:
    """``K (I + D22 K)^{-1}``: the controller for a plant with D22 from the one for the plant without."""
    if not D22.any():
        return K
    loop = np.eye(K.n_outputs) + K.D @ D22
    if np.linalg.cond(loop) > ILL_POSED:
        raise NoTrustworthyNumber("controller", "I + D_K D22 is singular: the loop is not well posed")
    C, D = np.linalg.solve(loop, K.C), np.linalg.solve(loop, K.D)
    with np.errstate(over="ignore", invalid="ignore"):
        A, B = K.A - K.B @ D22 @ C, K.B - K.B @ D22 @ D
    refuse_overflow("controller", A, B, C, D)
    return StateSpaceModel(A, B, C, D, K.dt)


def named_controller(K: StateSpaceModel, inputs: Any, outputs: Any, dt: float) -> StateSpaceModel:
    """K with the signals that it connects, which it takes as they are unless they say more, and balanced states."""
    inputs = [s if isinstance(s, Taken) else Taken(*s) for s in inputs]
    names = [f"k{i + 1}" for i in range(K.n_states)]
    K = balanced_states(K)
    return StateSpaceModel(K.A, K.B, K.C, K.D, dt, inputs, outputs, names)


def balanced_states(model: StateSpaceModel) -> StateSpaceModel:
    """The same response, exactly: states scaled by powers of two, so that rows of [A B] and columns of [A; C] have
    about the same size.
    """
    n, m, p = model.n_states, model.n_inputs, model.n_outputs
    if not n:
        return model
    whole = np.zeros((n + m + p,) * 2)
    whole[:n, :n], whole[:n, n : n + m], whole[n + m :, :n] = model.A, model.B, model.C
    scale = balancing_factors(whole)[:n]
    with np.errstate(invalid="ignore", over="ignore"):
        A, B, C = model.A / scale[:, None] * scale, model.B / scale[:, None], model.C * scale
        exact = (A / scale * scale[:, None] == model.A).all() and (B * scale[:, None] == model.B).all()
        if not exact or not (C / scale == model.C).all():  # overflow, or digits lost to underflow
            return model
    return model._in_states(A, B, C)


def rebuilt_loop(
    plant: GeneralizedPlant, K: StateSpaceModel, D22: Array
) -> tuple[StateSpaceModel, StateSpaceModel] | None:
    """K with D22 taken back in and named, and the loop that it closes; None where that is not well posed or stable."""
    try:
        full = with_direct_term(K, D22)
        named = named_controller(full, plant.measurements, plant.controls, plant.model.dt)
        loop = plant.close(named)
    except (InputError, NoTrustworthyNumber):  # entries overflow, or the loop is not well posed
        return None
    return (named, loop) if surely_stable(loop) else None


def surely_stable(loop: StateSpaceModel) -> bool:
    """True where every pole is further inside the stability region than the rounding of eigenvalues may move it."""
    return not loop.n_states or loop.spectral_abscissa() < -eigenvalue_blur(loop)
