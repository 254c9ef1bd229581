r"""H-infinity synthesis by linear matrix inequalities: the fallback behind the Riccati equations.

A controller of full order with closed-loop norm below gamma exists iff there are symmetric R and S with

.. math::
    N_R^T \begin{bmatrix} A R + R A^T & R C_1^T & B_1 \\ \cdot & -\gamma I & D_{11} \\ \cdot & \cdot & -\gamma I
    \end{bmatrix} N_R \prec 0, \quad
    N_S^T \begin{bmatrix} A^T S + S A & S B_1 & C_1^T \\ \cdot & -\gamma I & D_{11}^T \\ \cdot & \cdot & -\gamma I
    \end{bmatrix} N_S \prec 0, \quad \begin{bmatrix} R & I \\ I & S \end{bmatrix} \succeq 0

(Gahinet, Apkarian 1994, theorem 4.2). Nothing is assumed about ranks of D12 and D21 or zeros on the axis.

Several plants may share R and S: those at the vertices of a polytope, between which the controllers are interpolated
(Apkarian, Gahinet, Becker 1995). One of the two may then vary from plant to plant, at bounded rates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import NOT_REPEATABLE, Budget
from robustlab.synthesis.hinf.tuning import TUNING, HinfTuning
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.synthesis.problem.scaling import Scaling

# Singular values below it, relative to the largest, span a null space.
NULL = 1e-10


# For each plant the motions of the matrix that varies: factors of its values at the plants; their sum is its
# derivative.
Slopes = Sequence[Sequence[Mapping[int, float]]]


@dataclass(frozen=True, eq=False)
class Outer:
    """R and S of each plant; equal ones where they are shared."""

    R: Sequence[AnyArray]
    S: Sequence[AnyArray]


@dataclass(frozen=True)
class LmiOutcome:
    """What a conic solver said, in words, and whether its numbers may be looked at (they are re-checked anyway)."""

    usable: bool
    text: str


def solve_conic(problem: Any, budget: Budget, work: float = 0.0, tuning: HinfTuning = TUNING) -> LmiOutcome:
    """Solve a cvxpy problem with Clarabel, counted as ``work``, and map every way in which it can end.

    Clarabel is Rust: where it panics, a ``PanicException`` comes up that is no ``Exception``.
    """
    import warnings

    import cvxpy as cp

    if budget.over:
        return LmiOutcome(False, "no work was left for the LMI")
    budget.spend(work)
    # Its iterations end it; the clock is a guard that the user may have set.
    limits: dict[str, Any] = {"max_iter": tuning.lmi_steps}
    if np.isfinite(budget.seconds_left):
        limits["time_limit"] = max(budget.seconds_left, 1e-3)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "optimal_inaccurate" is a warning there and a status here
            problem.solve(solver=cp.CLARABEL, **limits)
    except cp.SolverError as error:
        return LmiOutcome(False, f"the LMI solver gave up ({str(error).splitlines()[0][:120]})")
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return LmiOutcome(False, f"the LMI could not be posed ({error})")
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        return LmiOutcome(False, f"the LMI solver panicked ({str(error)[:120]})")
    late = problem.status == cp.USER_LIMIT and budget.over and budget.struck
    limit = NOT_REPEATABLE if late else f"the LMI solver had no answer in {tuning.lmi_steps} steps"
    known = {
        cp.OPTIMAL: (True, "solved"),
        cp.OPTIMAL_INACCURATE: (True, "solved, not to full accuracy"),
        cp.USER_LIMIT: (False, limit),
        cp.INFEASIBLE: (False, "the LMI solver says infeasible"),
        cp.INFEASIBLE_INACCURATE: (False, "the LMI solver says infeasible, not to full accuracy"),
        cp.UNBOUNDED: (False, "the LMI solver says unbounded"),
        cp.UNBOUNDED_INACCURATE: (False, "the LMI solver says unbounded, not to full accuracy"),
    }
    return LmiOutcome(*known.get(problem.status, (False, f"the LMI solver ended with {problem.status!r}")))


def lmi_controllers(
    p: PlantMatrices, scaling: Scaling, budget: Budget, tuning: HinfTuning = TUNING
) -> tuple[list[Realisation], str]:
    """Controllers from the projection LMIs, unverified, in the units of the plant; and how it went in words.

    ``p``: continuous plant without D22.
    ``scaling``: scaling in which the LMIs are solved.
    ``budget``: every solve is counted there, and none is begun once it is over.
    """
    n = p.sizes[0]
    if not n:  # matrices without rows are no variables of an LMI
        return [], "the LMI was not tried: no states"
    if n > tuning.lmi_states:
        return [], f"the LMI was not tried: {n} states, at most {tuning.lmi_states}"
    scaled = scaling.apply(p)
    gamma, _, outcome = projection([scaled], None, 1.0, budget, tuning)
    if gamma is None:
        return [], outcome.text
    found: list[Realisation] = []
    for backoff in tuning.lmi_backoffs:
        for coupling in tuning.lmi_couplings:
            level = gamma * (1 + backoff) + 1e-9
            _, outer, outcome = projection([scaled], level, coupling, budget, tuning)
            X = None if outer is None else shared(outer.R[0], outer.S[0])
            if X is None:
                continue
            K = reconstructed(scaled, X, level * (1 + 0.5 * backoff), budget, tuning)
            if K is not None:
                found.append(scaling.controller_to_plant(K))
                break
    return found, f"LMI optimum {gamma / scaling.gain:.6g} ({outcome.text}), {len(found)} controllers from it"


def _work(n: int) -> float:
    """Of one solve, as measured: 0.3 s at 10 states, 4 s at 20, 27 s at 30."""
    return 5000 + 30 * n**4


def projection(
    plants: Sequence[PlantMatrices],
    level: float | None,
    coupling: float,
    budget: Budget,
    tuning: HinfTuning = TUNING,
    varying: Literal["", "R", "S"] = "",
    slopes: Slopes = (),
) -> tuple[float | None, Outer | None, LmiOutcome]:
    """Smallest gamma (``level`` None), or R and S of small trace at a level, with ``[R t I; t I S] >= 0``.

    ``plants``: of equal sizes, without D22.
    ``level``, ``coupling``: the level asked for, and t.
    ``varying``, ``slopes``: which of the two varies with the plant, and how it may move at each: ``- dR/dt`` stands in
    the first inequality, ``dS/dt`` in the second.
    """
    import cvxpy as cp

    n, m, _, q, _ = plants[0].sizes
    count = {kind: len(plants) if kind == varying else 1 for kind in "RS"}
    found = {kind: [cp.Variable((n, n), symmetric=True) for _ in range(count[kind])] for kind in "RS"}
    gamma: Any = cp.Variable() if level is None else level
    constraints: list[Any] = []
    for k, p in enumerate(plants):
        R, S = (found[kind][k if kind == varying else 0] for kind in "RS")
        N_R, N_S = _outer_factors(p)
        left = cp.bmat([[p.A @ R + R @ p.A.T, R @ p.C1.T, p.B1], [p.C1 @ R, -gamma * np.eye(q), p.D11],
                        [p.B1.T, p.D11.T, -gamma * np.eye(m)]])  # fmt: skip
        right = cp.bmat([[p.A.T @ S + S @ p.A, S @ p.B1, p.C1.T], [p.B1.T @ S, -gamma * np.eye(m), p.D11.T],
                         [p.C1, p.D11, -gamma * np.eye(q)]])  # fmt: skip
        for kind, N, M, sign in (("R", N_R, left, -1), ("S", N_S, right, 1)):
            states = N[:n]
            for slope in slopes[k] if kind == varying else ({},):
                moving = sum(sign * part * (states.T @ found[kind][i] @ states) for i, part in slope.items())
                part = N.T @ M @ N + moving
                constraints.append(0.5 * (part + part.T) << 0)
        if k == 0 or varying:
            constraints.append(cp.bmat([[R, coupling * np.eye(n)], [coupling * np.eye(n), S]]) >> 0)
    goal = gamma if level is None else sum(cp.trace(one) / len(ones) for ones in found.values() for one in ones)
    work = _work(n) * len(constraints) / 3
    outcome = solve_conic(cp.Problem(cp.Minimize(goal), constraints), budget, work, tuning)
    values = {kind: [one.value for one in ones] for kind, ones in found.items()}
    if not outcome.usable or any(one is None for ones in values.values() for one in ones):
        return None, None, outcome
    R, S = ([np.asarray(one) for one in values[kind]] * (len(plants) // count[kind]) for kind in "RS")
    return float(gamma.value) if level is None else level, Outer(R, S), outcome


def _outer_factors(p: PlantMatrices) -> tuple[AnyArray, AnyArray]:
    """``N_R`` and ``N_S``: null spaces of ``[B2' D12']`` and ``[C2 D21]``, with identities for w and z."""
    from scipy.linalg import block_diag, null_space

    _, m, _, q, _ = p.sizes
    by_control = null_space(np.hstack([p.B2.T, p.D12.T]), NULL)
    by_measurement = null_space(np.hstack([p.C2, p.D21]), NULL)
    return np.asarray(block_diag(by_control, np.eye(m))), np.asarray(block_diag(by_measurement, np.eye(q)))


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


def reconstructed(
    p: PlantMatrices,
    X: AnyArray,
    gamma: float,
    budget: Budget,
    tuning: HinfTuning = TUNING,
    motions: Sequence[AnyArray] = (),
) -> Realisation | None:
    """Controller of full order for a given X: the bounded real LMI, linear in it, at the largest margin.

    ``motions`` are the derivatives ``dX/dt`` with which it has to hold; none where X stands still.
    """
    import cvxpy as cp
    from scipy.linalg import block_diag

    n, m, n_u, q, n_y = p.sizes
    zero, eye = np.zeros((n, n)), np.eye(n)
    values, vectors = np.linalg.eigh(X)
    if values[0] <= 1e-12 * values[-1]:
        return None
    T, T_inv = vectors / np.sqrt(values), (vectors * np.sqrt(values)).T  # in these coordinates X is the identity
    into = T_inv @ np.block([[zero, p.B2], [eye, np.zeros((n, n_u))]])
    out = np.block([[zero, eye], [p.C2, np.zeros((n_y, n))]]) @ T
    z_u, y_w = np.hstack([np.zeros((q, n)), p.D12]), np.vstack([np.zeros((n, m)), p.D21])
    K, margin = cp.Variable((n + n_u, n + n_y)), cp.Variable()
    A = T_inv @ block_diag(p.A, zero) @ T + into @ K @ out
    B = T_inv @ np.vstack([p.B1, np.zeros((n, m))]) + into @ K @ y_w
    C = np.hstack([p.C1, np.zeros((q, n))]) @ T + z_u @ K @ out
    D = p.D11 + z_u @ K @ y_w
    real = cp.bmat([[A + A.T, B, C.T], [B.T, -gamma * np.eye(m), D.T], [C, D, -gamma * np.eye(q)]])
    rest = np.zeros((m + q, m + q))
    shift = block_diag(np.eye(2 * n), rest)
    constraints: list[Any] = [margin <= 1e3]
    for motion in motions or (np.zeros_like(X),):
        moving = block_diag(T.T @ motion @ T, rest)
        constraints.append(0.5 * (real + real.T) + 0.5 * (moving + moving.T) + margin * shift << 0)
    outcome = solve_conic(cp.Problem(cp.Maximize(margin), constraints), budget, _work(n), tuning)
    value = K.value
    if not outcome.usable or value is None or not np.isfinite(value).all():
        return None
    return Realisation(value[:n, :n], value[:n, n:], value[n:, :n], value[n:, n:])
