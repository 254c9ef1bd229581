"""A controller for the plant as given, from one for its bare matrices: direct term, names, and the rebuilt loop."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.magnitude import balancing_factors, refuse_overflow
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.partition import GeneralizedPlant

__all__ = ["named_controller", "rebuilt_loop", "surely_stable", "with_direct_term"]

# Above this condition number of I + D_K D22 the controller with D22 taken back in has lost its digits.
ILL_POSED = 1e10


def with_direct_term(K: StateSpaceModel, D22: NDArray[np.float64]) -> StateSpaceModel:
    r"""``K (I + D22 K)^{-1}``: the controller for a plant with D22 from the one for the plant without.

    Raises
    ------
    NoTrustworthyNumber
        I + D_K D22 is singular.
    """
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
    """K with the signals that it connects, and states k1, k2, ..."""
    names = [f"k{i + 1}" for i in range(K.n_states)]
    return StateSpaceModel(K.A, K.B, K.C, K.D, dt, inputs, outputs, names)


def rebuilt_loop(
    plant: GeneralizedPlant, K: StateSpaceModel, D22: NDArray[np.float64]
) -> tuple[StateSpaceModel, StateSpaceModel] | None:
    """K with D22 taken back in and named, and the loop that it closes; None where that is not well posed or not
    stable.
    """
    try:
        full = with_direct_term(K, D22)
        named = named_controller(full, plant.measurements, plant.controls, plant.model.dt)
        loop = plant.close(named)
    except (InputError, NoTrustworthyNumber):  # entries overflow, or the loop is not well posed
        return None
    return (named, loop) if surely_stable(loop) else None


def surely_stable(loop: StateSpaceModel) -> bool:
    """True where every pole is further inside the stability region than the rounding of eigenvalues may move it."""
    if not loop.n_states:
        return True
    t = balancing_factors(loop.A)
    size = float(np.linalg.norm(loop.A / t[:, None] * t, 1))
    return loop.spectral_abscissa() < -10 * float(np.finfo(float).eps) * max(size, 1.0 if loop.is_discrete else 0.0)
