"""Nonsmooth descent from a controller that is known: a seam for methods that want a last improvement."""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.laws.controller_laws import AffineBuilder, AffineLaw, Parameter, model_of
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.structure_search import central_path, polished
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices

__all__ = ["descend", "law_around"]


# Condition number of the modes of A_K up to which they are taken as coordinates.
MODES_WELL_APART = 1e6
# Dense quasi-Newton steps are quick up to this number of parameters.
MANY = 700
# The controller is near its optimum already: the path starts where the barrier is weak.
WEIGHTS = (0.3, 0.1, 0.03)


def descend(
    plant: GeneralizedPlant | PlantMatrices,
    K0: StateSpaceModel,
    budget: Budget,
    weights: tuple[float, ...] = WEIGHTS,
) -> StateSpaceModel:
    """A controller of the order of K0 with a norm that is at most K0's, by descent from K0.

    K0 is written in modal coordinates (or keeps its own where the modes almost coincide) and all its entries move. With
    more than 700 of them only its inputs, outputs and direct term do.

    Parameters
    ----------
    plant
        The generalised plant, or its matrices (continuous, D22 = 0).
    K0
        A stabilising controller, ``u = K y`` with positive feedback.
    budget
        Evaluations are counted there; once it is over the descent ends.
    weights
        Weights of the barrier, largest first: larger ones look further around.

    Returns
    -------
    StateSpaceModel
        K0 itself where nothing better was found or K0 does not stabilise. Nothing here is verified: the caller does.
    """
    if isinstance(plant, PlantMatrices):
        plant = GeneralizedPlant(plant.model(), plant.sizes[4], plant.sizes[2])
    if (K0.n_inputs, K0.n_outputs) != (plant.n_meas, plant.n_con):
        found = f"K0 has {K0.n_inputs} inputs and {K0.n_outputs} outputs"
        raise InputError("descend", found, f"{plant.n_meas} and {plant.n_con}")
    law, p = law_around(K0)
    problem = DesignProblem([plant], law, "hinf", (), budget)
    v = problem.variables(p)
    before = problem.norm(v)[0]
    if not np.isfinite(before) or budget.over:
        return K0
    v, _ = central_path(problem, v, weights)
    q, after = polished(problem, problem.parameters(v)[0])
    if not after < before:
        return K0
    return model_of(law, q, K0.dt, K0.inputs, K0.outputs)


def law_around(K: StateSpaceModel) -> tuple[AffineLaw, AnyArray]:
    """A law that contains K, in coordinates with few parameters, and its parameters for K."""
    A, B, C = _modal(K)
    k, n_u, n_y = K.n_states, K.n_outputs, K.n_inputs
    builder = AffineBuilder(k, n_u, n_y)
    values: list[float] = []
    theta = np.block([[A, B], [C, K.D]])
    moves = (theta != 0) | (np.arange(k + n_u)[:, None] >= k) | (np.arange(k + n_y)[None, :] >= k)
    near = np.abs(np.subtract.outer(np.arange(k), np.arange(k))) <= 1
    moves[:k, :k] |= near
    if moves.sum() > MANY:
        builder.base[:k, :k], moves[:k, :k] = A, False
    for i, j in np.argwhere(moves):
        builder.parameter(Parameter(f"Theta[{i + 1},{j + 1}]"), (int(i), int(j), 1.0))
        values.append(float(theta[i, j]))
    return builder.law(), np.array(values)


def _modal(K: StateSpaceModel) -> tuple[AnyArray, AnyArray, AnyArray]:
    """A, B, C with A in real modal form, or as given where the modes are not well apart."""
    if not K.n_states:
        return K.A, K.B, K.C
    values, vectors = np.linalg.eig(K.A)
    columns: list[AnyArray] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:
            columns += [vector.real, vector.imag]
        elif value.imag == 0:
            columns.append(vector.real)
    T = np.column_stack(columns)
    if np.linalg.cond(T) > MODES_WELL_APART:
        return K.A, K.B, K.C
    inverse = np.linalg.inv(T)
    A, B, C = inverse @ K.A @ T, inverse @ K.B, K.C @ T
    near = np.abs(np.subtract.outer(np.arange(len(A)), np.arange(len(A)))) <= 1
    A = np.where(near, A, 0.0)  # entries elsewhere are rounding
    size = np.sqrt(np.maximum(np.linalg.norm(B, axis=1), 1e-300) / np.maximum(np.linalg.norm(C, axis=0), 1e-300))
    size = np.where((size > 1e-8) & (size < 1e8), size, 1.0)
    return A * size[None, :] / size[:, None], B / size[:, None], C * size
