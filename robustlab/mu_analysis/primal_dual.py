r"""The D-G upper bound by a primal-dual interior-point method, for every block structure.

With ``F(x, t) = t D_w - M^* D_z M - j (G M - M^* G^*)`` the generalised eigenvalue problem

.. math:: \min t \quad \text{subject to} \quad F(x, t) \succeq 0, \; D(x) \succeq 0, \; \mathrm{tr} D(x) = n

has the optimality conditions ``<Z, D_w> = 1``, ``<Z, F_i> + <Y, D_i> = eta tr D_i``, ``F Z = 0``, ``D Y = 0`` with
``Z, Y >= 0``. Their zeros on the right are moved to ``nu I`` and followed down to ``nu = 0`` by Newton steps in Mehrotra's
way (a predictor that tells how far to go, a corrector with the second-order terms), from the analytic centre of a large
t. A linear problem with one product of unknowns, ``t D``, results; it is quasiconvex, so its stationary points are global.

Every x met is feasible for its t, so stopping early costs tightness, never soundness.

References
----------
Boyd, El Ghaoui, "Method of centers for minimizing generalized eigenvalues", Linear Algebra and its Applications 188
(1993); Helmberg, Rendl, Vanderbei, Wolkowicz, "An interior-point method for semidefinite programming", SIAM J. Optim. 6
(1996) (the direction); Mehrotra, SIAM J. Optim. 2 (1992).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.scalings import ScalingSpace
from robustlab.uncertainty.blocks import FullBlock

if TYPE_CHECKING:
    from robustlab.mu_analysis.primal_dual_kernels import Pattern

__all__ = ["minimise"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

START = 1.3  # t at which the path begins, for M of norm 1: D = I, G = 0 is feasible there


def minimise(
    M: ComplexArray, space: ScalingSpace, tol: float = 1e-6, target: float | None = None, max_steps: int = 80
) -> Array:
    """Parameters x (k, size) of the best D, G found for each matrix of the stack M (k, p, q).

    Parameters
    ----------
    M
        Balanced matrices.
    tol
        Stop where the estimated distance of t to its optimum falls below ``tol * t``.
    target
        Stop where this beta is reached (a point well inside is wanted, not the optimum), or is shown out of reach.
    """
    from robustlab.mu_analysis.primal_dual_kernels import descend

    scale = np.maximum(np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    goal = np.full(len(M), -np.inf) if target is None else (np.minimum(target, 1e3 * scale) / scale) ** 2
    tall = np.concatenate([np.broadcast_to(np.eye(space.q), (len(M), space.q, space.q)), M / scale[:, None, None]], 1)
    pattern = _pattern(space)
    x = np.empty((len(M), space.size))
    for k in range(len(M)):
        x[k] = descend(space.identity.copy(), START, tall[k], pattern, tol, goal[k], max_steps)[0]
    # Back from M / scale: G carries the unit of M.
    return np.where(space.scales_with_m, x * scale[:, None], x)


def _pattern(space: ScalingSpace) -> Pattern:
    """The sparse linear maps x -> E(x) and x -> D(x) as the compiled code reads them."""
    from robustlab.mu_analysis.primal_dual_kernels import Pattern

    n = space.size
    ends = np.append(space.first, len(space.rows))
    owner, trace = np.full(n, -1), np.zeros(n)
    d_rows: list[int] = []
    d_cols: list[int] = []
    d_coefficients: list[complex] = []
    d_first, corners, i = [0], [0], 0
    for b, (block, (w, _)) in enumerate(zip(space.blocks, space.slices, strict=True)):
        full = isinstance(block, FullBlock)
        size = 1 if full else block.rows
        # The parameters of D are those with entries in D_w; those of G follow them.
        while i < n and space.in_w[ends[i]] and w.start <= space.rows[ends[i]] < w.stop:
            for e in range(ends[i], ends[i] + 1 if full else ends[i + 1]):
                if space.in_w[e]:
                    d_rows.append(int(space.rows[e]) - w.start + corners[-1])
                    d_cols.append(int(space.cols[e]) - w.start + corners[-1])
                    d_coefficients.append(space.coefficients[e])
                    trace[i] += float(space.rows[e] == space.cols[e])
            owner[i] = b
            d_first.append(len(d_rows))
            i += 1
        while i < n and not space.in_w[ends[i]]:
            d_first.append(len(d_rows))
            i += 1
        corners.append(corners[-1] + size)
    whole = (d_rows, d_cols)
    return Pattern(
        space.rows,
        space.cols,
        space.coefficients,
        space.in_w,
        ends,
        *(np.array(part, dtype=int) for part in whole),
        np.array(d_coefficients, dtype=complex),
        np.array(d_first, dtype=int),
        np.array(corners, dtype=int),
        owner,
        trace,
    )
