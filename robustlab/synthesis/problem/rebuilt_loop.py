"""The controller of the plant as given, from one for its bare matrices: direct term, states, names."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import in_states
from robustlab.linear_analysis.matrices import balancing_factors, refuse_overflow
from robustlab.norms.hinfinity import eigenvalue_blur
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import Realisation

# Largest condition number of I + D_K D22 at which the controller with D22 included keeps its digits.
ILL_POSED = 1e10
# Smallest singular values of I + D22 D_K that replace smaller ones.
DISTANCES = (1e-4, 1e-3, 1e-2, 1e-1)
# Largest condition number of a basis of modes.
NO_BASIS = 1e12
# Skeel's condition number above which other states are tried.
HIDDEN = 1e6


def with_direct_term(K: StateSpaceModel, D22: Array) -> StateSpaceModel:
    """Return ``K (I + D22 K)^{-1}``, the controller for a plant with D22, from that for the plant without."""
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


def well_posed_neighbours(K: Realisation, D22: AnyArray) -> list[Realisation]:
    """K itself where ``I + D22 D_K`` is far from singular; else controllers with the smallest change of ``D_K``.

    A single weight on S has its optimum at such a K: of ten such test plants mixsyn failed on four without them.
    """
    with np.errstate(all="ignore"):
        back = np.eye(len(D22)) + D22 @ K.D
    if not np.isfinite(back).all():  # K overflows
        return []
    U, s, Vt = np.linalg.svd(back)
    if s[-1] >= DISTANCES[0]:
        return [K]
    inverse = np.linalg.pinv(D22, rcond=1e-10)
    return [K._replace(D=K.D + inverse @ (U * np.maximum(delta - s, 0.0)) @ Vt) for delta in DISTANCES]


def named_controller(K: StateSpaceModel, inputs: Any, outputs: Any, dt: float) -> StateSpaceModel:
    """Return K in balanced states, with the names of its signals and the takes of its inputs (by default ``y``)."""
    inputs = [s if isinstance(s, Taken) else Taken(*s) for s in inputs]
    names = [f"k{i + 1}" for i in range(K.n_states)]
    K = balanced_states(K)
    return StateSpaceModel(K.A, K.B, K.C, K.D, dt, inputs, outputs, names)


def balanced_states(model: StateSpaceModel) -> StateSpaceModel:
    """Scale states by powers of two, exactly, so that rows of [A B] and columns of [A; C] have about one size."""
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


def moderate_states(model: StateSpaceModel) -> StateSpaceModel:
    """Return a model in the states that keep its digits."""
    balanced = balanced_states(model)
    hidden = _cancellation(balanced.A)
    modes = separated_modes(model) if hidden > HIDDEN else None
    return balanced if modes is None or _cancellation(modes.A) >= 1e-2 * hidden else modes


def _cancellation(A: Array) -> float:
    """Compute Skeel's condition number: the effect of relative errors of A's entries on A^-1."""
    try:
        return float((np.abs(np.linalg.inv(A)) @ np.abs(A)).sum(axis=1).max(initial=0.0))
    except np.linalg.LinAlgError:
        return float("inf")


def separated_modes(model: StateSpaceModel) -> StateSpaceModel | None:
    """Return the model in coordinates of its modes, each entry rounded once; None if these are no basis."""
    if model.n_states < 2:
        return None
    m = balanced_states(model)
    values, vectors = np.linalg.eig(m.A)
    # real and imaginary part of a conjugate pair
    basis = np.where(np.imag(values) < 0, np.imag(vectors), np.real(vectors))
    if not np.isfinite(basis).all() or not np.linalg.cond(basis) < NO_BASIS:
        return None
    modes = in_states(m, basis)
    return None if modes is None else balanced_states(modes)


def surely_stable(loop: StateSpaceModel) -> bool:
    """Return whether every pole is further inside the stability region than rounding of eigenvalues may move it."""
    return not loop.n_states or loop.spectral_abscissa() < -eigenvalue_blur(loop)
