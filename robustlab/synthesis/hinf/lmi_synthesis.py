"""H-infinity synthesis by linear matrix inequalities, for scheduled plants that share R and S.

Gahinet, Apkarian 1994, theorem 4.2; Apkarian, Gahinet, Becker 1995 for several plants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.synthesis.problem.semidefinite import Inequalities, equal_rows, symmetric_basis

# Steps of the solver: three times what it ever needed.
LMI_STEPS = 200
# Largest eigenvalue of R and S in the coordinates of the solver: without it many optima are not attained.
LMI_BOUND = 1e5

# Singular values below it, relative to the largest, span a null space.
NULL = 1e-10


@dataclass(frozen=True, eq=False)
class Outer:
    """R and S, which all plants share."""

    R: AnyArray
    S: AnyArray


@dataclass(frozen=True)
class LmiOutcome:
    """What a conic solver said, in words, and whether its numbers may be looked at (they are re-checked anyway)."""

    usable: bool
    text: str


def projection(
    plants: Sequence[PlantMatrices], level: float | None, coupling: float, budget: Budget, widest: bool = False
) -> tuple[float | None, Outer | None, LmiOutcome]:
    """Smallest gamma (``level`` None), or R and S at a level, with ``[R t I; t I S] >= 0`` and both bounded."""
    if budget.over:
        return None, None, LmiOutcome(False, "no work was left for the LMI")
    n = plants[0].sizes[0]
    basis = symmetric_basis(n)
    size = len(basis)
    last = 2 * size  # gamma, or the margin; before it R, then S
    conditions = Inequalities(last + 1)
    for p in plants:
        _add_outer(conditions, _dual(p), basis, 0, last, level)
        _add_outer(conditions, p, basis, size, last, level)
    corners = np.zeros((2, size, 2 * n, 2 * n))
    corners[0, :, :n, :n] = corners[1, :, n:, n:] = basis
    across = np.kron([[0.0, coupling], [coupling, 0.0]], np.eye(n))
    conditions.add({0: corners[0], size: corners[1]}, across)
    for first in (0, size):
        conditions.add({first: -basis}, LMI_BOUND * np.eye(n))
    cost = np.zeros(last + 1)
    if level is None:
        cost[last] = 1.0
    elif widest:
        cost[last] = -1.0
    else:
        cost[:last] = np.tile(np.einsum("bii->b", basis), 2)
        conditions.add({last: -np.ones((1, 1, 1))}, np.zeros((1, 1)))
    if level is not None:
        conditions.add({last: np.ones((1, 1, 1))}, np.zeros((1, 1)))
    answer = conditions.least(cost, budget, LMI_STEPS)
    if answer.x is None:
        return None, None, LmiOutcome(False, f"the LMI solver says {answer.text}")
    R, S = np.einsum("kb,bij->kij", answer.x[:last].reshape(2, size), basis)
    gamma = float(answer.x[last]) if level is None else level
    return gamma, Outer(R, S), LmiOutcome(True, answer.text)


def _dual(p: PlantMatrices) -> PlantMatrices:
    return PlantMatrices(p.A.T, p.C1.T, p.C2.T, p.B1.T, p.B2.T, p.D11.T, p.D21.T, p.D12.T)


def _add_outer(
    conditions: Inequalities, p: PlantMatrices, basis: AnyArray, at: int, last: int, level: float | None
) -> None:
    """The second inequality of a plant, in an orthonormal basis of its null space and rows of one size."""
    from scipy.linalg import block_diag, null_space

    n, m, _, q, _ = p.sizes
    wide, whole = n + m, n + m + q
    N: AnyArray = np.asarray(block_diag(null_space(np.hstack([p.C2, p.D21]), NULL), np.eye(q)))
    part = np.zeros((len(basis), whole, whole))
    made = basis @ np.hstack([p.A, p.B1])
    part[:, :n, :wide] += made
    part[:, :wide, :n] += np.swapaxes(made, 1, 2)
    fixed = np.zeros((whole, whole))
    fixed[wide:, :wide] = np.hstack([p.C1, p.D11])
    levels = np.diag(np.append(np.zeros(n), np.ones(m + q)))
    fixed = fixed + fixed.T
    diagonal = np.einsum("bii->b", basis) > 0
    size = np.diag(np.abs(N).T @ (np.abs(fixed) + np.abs(part[diagonal]).sum(axis=0) + levels) @ np.abs(N))
    N = N / np.sqrt(np.where(size > 0, size, 1.0))
    columns = {at: -(N.T @ part @ N)}
    fixed = -(N.T @ fixed @ N)
    if level is None:
        columns[last] = (N.T @ levels @ N)[None]
    else:
        fixed = fixed + level * N.T @ levels @ N
        columns[last] = -np.eye(N.shape[1])[None]
    conditions.add(columns, fixed)


def shared(R: AnyArray, S: AnyArray) -> AnyArray | None:
    """The closed loop's Lyapunov matrix of one R and S, with ``M N^T = I - R S`` split evenly; None where singular."""
    U, s, Vt = np.linalg.svd(np.eye(len(R)) - R @ S)
    M, N = U * np.sqrt(s), Vt.T * np.sqrt(s)
    zero, eye = np.zeros_like(R), np.eye(len(R))
    try:
        X = np.linalg.solve(np.block([[R, eye], [M.T, zero]]).T, np.block([[eye, S], [zero, N.T]]).T)
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (X + X.T)


def reconstructed(p: PlantMatrices, X: AnyArray, gamma: float, budget: Budget) -> Realisation | None:
    """Controller of full order for a given X: the bounded real LMI, linear in it, at the largest margin."""
    n, m, n_u, q, n_y = p.sizes
    values, vectors = np.linalg.eigh(X)
    if values[0] <= 1e-12 * values[-1]:
        return None
    T, T_inv = vectors / np.sqrt(values), (vectors * np.sqrt(values)).T  # in these coordinates X is the identity
    whole, wide = 2 * n + m + q, 2 * n + m
    # The closed loop's [A B; C D] is that without a controller and left K right.
    left, right = np.zeros((whole - m, n + n_u)), np.zeros((n + n_y, wide))
    left[: 2 * n] = T_inv @ np.block([[np.zeros((n, n)), p.B2], [np.eye(n), np.zeros((n, n_u))]])
    left[2 * n :, n:], right[n:, 2 * n :] = p.D12, p.D21
    right[:, : 2 * n] = np.block([[np.zeros((n, n)), np.eye(n)], [p.C2, np.zeros((n_y, n))]]) @ T
    open_loop = np.zeros((whole - m, wide))
    open_loop[: 2 * n, : 2 * n] = T_inv[:, :n] @ p.A @ T[:n]
    open_loop[: 2 * n, 2 * n :] = T_inv[:, :n] @ p.B1
    open_loop[2 * n :, : 2 * n], open_loop[2 * n :, 2 * n :] = p.C1 @ T[:n], p.D11
    added = np.einsum("ia,bj->abij", left, right).reshape(-1, whole - m, wide)

    def symmetric(loops: AnyArray) -> AnyArray:
        """L of stacked [A B; C D]."""
        L = np.zeros((len(loops), whole, whole))
        L[:, : 2 * n, :wide], L[:, wide:, :wide] = loops[:, : 2 * n], loops[:, 2 * n :]
        return L + np.swapaxes(L, 1, 2)

    fixed, parts = symmetric(open_loop[None])[0], symmetric(added)
    fixed[2 * n :, 2 * n :] -= gamma * np.eye(m + q)
    conditions = Inequalities(len(parts) + 1)
    unit = equal_rows(fixed)
    conditions.add({0: -unit[:, None] * parts * unit, len(parts): -np.eye(whole)[None]}, -unit[:, None] * fixed * unit)
    cost = np.append(np.zeros(len(parts)), -1.0)
    answer = conditions.least(cost, budget, LMI_STEPS)
    if answer.x is None:
        return None
    K = answer.x[:-1].reshape(n + n_u, n + n_y)
    return Realisation(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:])
