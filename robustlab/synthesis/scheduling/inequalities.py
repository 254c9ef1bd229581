"""Linear matrix inequalities in cvxpy: the front to the solver, and H-infinity synthesis for plants that share R and S.

Gahinet, Apkarian 1994, theorem 4.2; Apkarian, Gahinet, Becker 1995 for several plants.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation, dual

# Steps of the solver: three times what it ever needed.
STEPS = 200
# Largest eigenvalue of R and S in the coordinates of the solver: without it many optima are not attained.
LARGEST = 1e5
# Singular values below it, relative to the largest, span a null space.
NULL = 1e-10


def least(cost: Any, conditions: Sequence[Any], budget: Budget) -> str:
    """The least cost: its variables have values then, which whoever asked proves; empty, or why they have none."""
    import cvxpy as cp
    from cvxpy.error import SolverError

    problem = cp.Problem(cp.Minimize(cost), list(conditions))
    unknowns = sum(variable.size for variable in problem.variables())
    work = 4e-3 * unknowns**2 * sum(c.shape[0] if c.shape else 1 for c in conditions)
    options: dict[str, Any] = {"max_iter": int(np.clip(budget.left / work, 1, STEPS)), "accept_unknown": True}
    if np.isfinite(budget.seconds_left):
        options["time_limit"] = max(budget.seconds_left, 1e-3)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
            problem.solve(solver=cp.CLARABEL, warm_start=False, **options)
    except SolverError as error:
        return f"the LMI solver says {error}"
    budget.spend((problem.solver_stats.num_iters or 0) * work)
    found = [variable.value for variable in problem.variables()]
    sound = all(value is not None and np.isfinite(value).all() for value in found)
    return "" if sound else f"the LMI solver says {problem.status}"


def value_of(variable: Any) -> AnyArray:
    """What the solver found for a variable."""
    return np.asarray(variable.value)


def bounded_real(top: Any, C: Array, D: Array, gamma: Any) -> Any:
    """``[top_A, top_B, C^T; ., -gamma I, D^T; ., ., -gamma I]`` with ``top = [top_A, top_B]``, top_A symmetric."""
    import cvxpy as cp

    n, (q, m) = C.shape[1], D.shape
    return cp.bmat([[top[:, :n], top[:, n:], C.T], [top[:, n:].T, -gamma * np.eye(m), D.T], [C, D, -gamma * np.eye(q)]])


def equal_rows(matrix: Array) -> Array:
    """Factors d with which the largest entry of each row of ``d_i m_ij d_j`` is about one (Ruiz 2001)."""
    # The rows of fast states drown those of slow ones otherwise.
    size, d = np.abs(matrix), np.ones(len(matrix))
    for _ in range(10):
        largest = (d[:, None] * size * d).max(axis=1, initial=0.0)
        d /= np.sqrt(np.where(largest > 0, largest, 1.0))
    return d


def projection(
    plants: Sequence[PlantMatrices], level: float | None, coupling: float, budget: Budget, widest: bool = False
) -> tuple[float | None, tuple[AnyArray, AnyArray] | None, str]:
    """Smallest gamma (``level`` None), or R and S at a level, with ``[R t I; t I S] >= 0`` and both bounded.

    R and S are those of the largest margin (``widest``), else of small trace.
    """
    if budget.over:
        return None, None, "no work was left for the LMI"
    import cvxpy as cp

    n = plants[0].sizes[0]
    R, S = (cp.Variable((n, n), symmetric=True) for _ in range(2))
    last = cp.Variable()  # gamma, or the margin at a level
    gamma, margin = (last, 0.0) if level is None else (level, last)
    conditions = [cp.bmat([[R, coupling * np.eye(n)], [coupling * np.eye(n), S]]) >> 0]
    conditions += [LARGEST * np.eye(n) - X >> 0 for X in (R, S)]
    for p in plants:
        conditions += [_outer(q, X, gamma, margin) for q, X in ((dual(p), R), (p, S))]
    if level is not None:
        conditions += [last >= 0] if widest else [last == 0]
    cost = last if level is None else -last if widest else cp.trace(R) + cp.trace(S)
    failed = least(cost, conditions, budget)
    if failed:
        return None, None, failed
    return float(value_of(last)) if level is None else level, (value_of(R), value_of(S)), ""


def _outer(p: PlantMatrices, S: Any, gamma: Any, margin: Any) -> Any:
    """The second inequality of a plant, in an orthonormal basis of its null space and rows of one size."""
    import cvxpy as cp
    from scipy.linalg import block_diag, null_space

    _, m, _, q, _ = p.sizes
    N: AnyArray = np.asarray(block_diag(null_space(np.hstack([p.C2, p.D21]), NULL), np.eye(q)))
    a, b, c, d = (np.abs(x) for x in (p.A, p.B1, p.C1, p.D11))
    sizes = np.block([[a + a.T, b, c.T], [b.T, np.eye(m), d.T], [c, d, np.eye(q)]])
    size = np.diag(np.abs(N).T @ sizes @ np.abs(N))
    N = N / np.sqrt(np.where(size > 0, size, 1.0))
    whole = bounded_real(cp.hstack([p.A.T @ S + S @ p.A, S @ p.B1]), p.C1, p.D11, gamma)
    return -(N.T @ whole @ N) - margin * np.eye(N.shape[1]) >> 0


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
    import cvxpy as cp

    n, m, n_u, q, n_y = p.sizes
    values, vectors = np.linalg.eigh(X)
    if values[0] <= 1e-12 * values[-1]:
        return None
    T, T_inv = vectors / np.sqrt(values), (vectors * np.sqrt(values)).T  # in these coordinates X is the identity
    # The closed loop's [A B; C D] is that without a controller and left K right.
    zero, eye = np.zeros, np.eye(n)
    left = np.block([[zero((n, n)), p.B2], [eye, zero((n, n_u))], [zero((q, n)), p.D12]])
    right = np.block([[zero((n, n)), eye, zero((n, m))], [p.C2, zero((n_y, n)), p.D21]])
    open_loop = np.block([[p.A, zero((n, n)), p.B1], [zero((n, 2 * n + m))], [p.C1, zero((q, n)), p.D11]])
    for one in (left, open_loop):
        one[: 2 * n] = T_inv @ one[: 2 * n]
    for one in (right, open_loop):
        one[:, : 2 * n] = one[:, : 2 * n] @ T
    K, margin = cp.Variable((n + n_u, n + n_y)), cp.Variable()
    loop = open_loop + left @ K @ right
    A, B, C, D = _quarters(loop, 2 * n)
    whole = cp.bmat([[A + A.T, B, C.T], [B.T, -gamma * np.eye(m), D.T], [C, D, -gamma * np.eye(q)]])
    a, b, c, d = _quarters(open_loop, 2 * n)
    unit = equal_rows(np.block([[a + a.T, b, c.T], [b.T, -gamma * np.eye(m), d.T], [c, d, -gamma * np.eye(q)]]))
    if least(-margin, [-(np.diag(unit) @ whole @ np.diag(unit)) - margin * np.eye(len(unit)) >> 0], budget):
        return None
    return Realisation(*_quarters(value_of(K), n))


def _quarters(matrix: Any, n: int) -> tuple[Any, Any, Any, Any]:
    """A, B, C, D of ``[A B; C D]`` with n states."""
    return matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]
