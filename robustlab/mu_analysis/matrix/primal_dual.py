r"""The D-G upper bound by a primal-dual interior-point method, for every block structure.

With ``F(x, t) = t D_w - M^* D_z M - j (G M - M^* G^*)`` the generalised eigenvalue problem

.. math:: \min t \quad \text{subject to} \quad F(x, t) \succeq 0, \; D(x) \succeq 0, \; \mathrm{tr} D(x) = n

has the optimality conditions ``<Z, D_w> = 1``, ``<Z, F_i> + <Y, D_i> = eta tr D_i``, ``F Z = 0``, ``D Y = 0`` with
``Z, Y >= 0``. The zeros of the last two are moved to ``nu I`` and followed down to ``nu = 0`` by Newton steps in
Mehrotra's way (a predictor that tells how far to go, a corrector with the second-order terms), from the analytic centre
of a large t. The only product of unknowns is ``t D``; the problem is quasiconvex, so a stationary point is the optimum.
About ten Newton systems do for any size.

Every x met is feasible for its t, so stopping early costs tightness, never soundness.

References
----------
Boyd, El Ghaoui, "Method of centers for minimizing generalized eigenvalues", Linear Algebra and its Applications 188
(1993); Helmberg, Rendl, Vanderbei, Wolkowicz, "An interior-point method for semidefinite programming", SIAM J. Optim. 6
(1996) (the direction); Mehrotra, SIAM J. Optim. 2 (1992).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.mu_analysis.matrix.scalings import ScalingSpace

if TYPE_CHECKING:
    from robustlab.mu_analysis.matrix.primal_dual_kernels import Pattern

__all__ = ["minimise"]


START = 1.3  # t at which the path begins, for M of norm 1: D = I, G = 0 is feasible there


def minimise(
    M: ComplexArray, space: ScalingSpace, tol: float = 1e-6, target: float | None = None, max_steps: int = 40
) -> tuple[Array, NDArray[np.bool_]]:
    """Parameters x (k, size) of the best D, G found for each matrix of the stack M (k, p, q), and where that is all.

    Parameters
    ----------
    M
        Balanced matrices.
    tol
        Stop where the estimated distance of t to its optimum falls below ``tol * t``.
    target
        Stop where this beta is reached (a point well inside is wanted, not the optimum), or is shown out of reach.

    Returns
    -------
    x, settled
        ``settled`` (k,) is False where the method came to the end of its digits before ``tol``: the x is valid, another
        method may find a better one.
    """
    from robustlab.mu_analysis.matrix.primal_dual_kernels import descend

    scale = np.maximum(np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    goal = np.full(len(M), -np.inf) if target is None else (np.minimum(target, 1e3 * scale) / scale) ** 2
    eye = np.broadcast_to(np.eye(space.q, dtype=complex), (len(M), space.q, space.q))
    tall = np.concatenate([eye, M / scale[:, None, None]], axis=1)
    pattern = _pattern(space)
    x, settled = np.empty((len(M), space.size)), np.empty(len(M), dtype=bool)
    for k in range(len(M)):
        x[k], settled[k], _ = descend(space.identity.copy(), START, tall[k], pattern, tol, goal[k], max_steps)
    # Back from M / scale: G carries the unit of M.
    return np.where(space.scales_with_m, x * scale[:, None], x), settled


def _pattern(space: ScalingSpace) -> Pattern:
    """The sparse linear map x -> E(x) as the compiled code reads it."""
    from robustlab.mu_analysis.matrix.primal_dual_kernels import Pattern

    in_w = space.in_w[space.first] > 0
    owner = np.where(in_w, space.block_of, -1)
    diagonal = (space.in_w > 0) & (space.rows == space.cols)
    trace = np.add.reduceat(diagonal.astype(float), space.first)
    # D_w of a full block is a multiple of the identity: diagonal blocks of order one.
    sizes = [[1] * b.rows if b.d_order == 1 else [b.rows] for b in space.blocks]
    corners = np.cumsum([0, *(size for part in sizes for size in part)])
    first = np.append(space.first, len(space.rows))
    return Pattern(space.rows, space.cols, space.coefficients, first, owner, trace, corners)
