r"""Minimising the D-G upper bound: two interior-point methods for every block structure.

With ``F(x, t) = t D_w - M^* D_z M - j (G M - M^* G^*)`` the generalised eigenvalue problem is

.. math:: \min t \quad \text{subject to} \quad F(x, t) \succeq 0, \; D(x) \succeq 0, \; \mathrm{tr} D(x) = n

The primal-dual method (compiled) solves its optimality conditions ``<Z, D_w> = 1``, ``<Z, F_i> + <Y, D_i> = eta tr
D_i``, ``F Z = 0``, ``D Y = 0`` with ``Z, Y >= 0``. The zeros of the last two are moved to ``nu I`` and followed down to
``nu = 0`` by Newton steps in Mehrotra's way (a predictor that tells how far to go, a corrector with the second-order
terms), from the analytic centre of a large t. The only product of unknowns is ``t D``; the problem is quasiconvex, so a
stationary point is the optimum. About ten Newton systems do for any size, where nu falls all the way with t. It need
not: where M is nearly real, or modes are light, the centres of smaller t have a larger nu for a while, Newton steps
towards a smaller nu lead nowhere, and the gap nu stands for is none. There the path is followed by its other parameter:
steps along the tangent in t, each centred again, about fifty systems. The gap is believed where the dual proves it.

Path following, for matrices at which that broke down, keeps x near the minimiser of

.. math:: \varphi_t(x) = -\log\det F_t(x) - \rho \log\det D_w(x) + \kappa \, \mathrm{tr} D_w(x)

while t falls along the tangent of the central path.

Every x met is feasible for its t, so stopping early costs tightness, never soundness.

References
----------
Boyd, El Ghaoui, "Method of centers for minimizing generalized eigenvalues", Linear Algebra and its Applications 188
(1993); Helmberg, Rendl, Vanderbei, Wolkowicz, "An interior-point method for semidefinite programming", SIAM J. Optim. 6
(1996) (the direction of the first method); Mehrotra, SIAM J. Optim. 2 (1992).
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.mu_analysis.matrix.scalings import ScalingSpace, hermitian, relative, supply

# of D between one component and the next, tried in turn; smaller: their coupling costs less, digits are lost
START = 1.3  # t at which a path begins, for M of norm 1: D = I, G = 0 is feasible there
RHO = 0.3  # weight of the barrier that keeps D away from singular; larger: safer, farther from the optimum
NEAR = 0.3  # squared Newton decrement below which a point counts as centred; smaller: more steps, safer ones
STEP = 0.9  # part of the way to the boundary that a predictor step goes; larger: fewer steps, less centred
NEGATIVE = -1.0  # t below this, of a matrix of norm 1, cannot make a proof of mu = 0 any firmer


def primal_dual(
    M: ComplexArray,
    space: ScalingSpace,
    tol: float = 1e-6,
    target: float | None = None,
    max_steps: int = 150,
    sure: bool = True,
) -> tuple[Array, Mask]:
    """Parameters x (k, size) of the best D, G found for each matrix of the stack M (k, p, q), and where that is all."""
    from robustlab.mu_analysis.matrix import primal_dual_kernels as kernels

    scale, goal = _scale_and_goal(M, target)
    entries, trace, orders = _sparse_map(space)
    n, size = space.q + space.p, space.size
    W, J = np.empty((kernels.MATRICES, 2 * space.q, space.q), dtype=complex), np.empty((3, n, n), dtype=complex)
    H, V = np.empty((size, size)), np.empty((kernels.VECTORS, max(size, n)))
    c = np.stack([space.coefficients, space.coefficients])
    x, settled = np.empty((len(M), size)), np.empty(len(M), dtype=bool)
    for k in range(len(M)):
        W[:], V[:] = 0.0, 0.0
        V[kernels.AT, :size], V[kernels.TRACE, :size] = space.identity, trace
        V[kernels.SHORT, :size] = kernels.SHORT_G * space.scales_with_m
        m = M[k] / scale[k]
        settled[k] = kernels.descend(W, J, H, V, m, c, entries, orders, START, tol, goal[k], max_steps, sure)
        x[k] = V[kernels.BEST, :size]
    return _in_own_unit(x, space, scale), settled


def path_following(
    M: ComplexArray, space: ScalingSpace, tol: float = 1e-6, target: float | None = None, max_steps: int = 80
) -> Array:
    """Parameters x (k, size) as those of `primal_dual`, for a whole stack at once."""
    scale, goal = _scale_and_goal(M, target)
    path = _Path(M / scale[:, None, None], space)
    active = np.arange(len(M))
    for _ in range(max_steps):
        if not len(active):
            break
        active = path.step(active, tol, goal)
    return _in_own_unit(path.best_x, space, scale)


def _scale_and_goal(M: ComplexArray, target: float | None) -> tuple[Array, Array]:
    """The norm of each matrix, by which it is divided, and the t that is aimed at then."""
    scale = np.maximum(np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    goal = np.full(len(M), -np.inf) if target is None else (np.minimum(target, 1e3 * scale) / scale) ** 2
    return scale, goal


def _in_own_unit(x: Array, space: ScalingSpace, scale: Array) -> Array:
    """Parameters for M from those for ``M / scale``: G carries the unit of M."""
    return np.where(space.scales_with_m, x * scale[:, None], x)


def _sparse_map(space: ScalingSpace) -> tuple[Indices, Array, Indices]:
    """The entries of the sparse E(x) as the compiled code reads them, the gradient of tr D_w, and orders of blocks."""
    # D_w of a full block is a multiple of the identity: diagonal blocks of order one.
    orders = np.concatenate([[1] * b.rows if b.d_order == 1 else [b.rows] for b in space.blocks])
    low = np.repeat(np.cumsum(orders) - orders, orders)  # where the block begins that a row of D_w lies in
    parameter = np.repeat(np.arange(space.size), np.diff(space.first, append=len(space.rows)))
    in_w = np.flatnonzero(space.in_w)
    of_block = low[space.rows[in_w]]
    place, begin = np.full((2, len(parameter)), -1)
    place[in_w] = space.cols[in_w] - of_block
    _, first, block = np.unique(of_block, return_index=True, return_inverse=True)
    begin[in_w] = in_w[first][block]
    trace = np.bincount(parameter, (space.in_w > 0) & (space.rows == space.cols)).astype(float)
    return np.stack([space.rows, space.cols, parameter, place, begin]), trace, np.append(space.q, orders)


class _Path:
    """State of the batch: iterate x, its t, and the best feasible pair so far."""

    def __init__(self, M: ComplexArray, space: ScalingSpace) -> None:
        k = len(M)
        self.M, self.space = M, space
        self.m = space.q
        eye = np.broadcast_to(np.eye(self.m, dtype=complex), (k, self.m, self.m))
        self.U = np.concatenate([eye, hermitian(M)], axis=2)  # (k, q, q + p)
        self.x = np.tile(space.identity, (k, 1))
        self.t = np.full(k, START)
        self.best_t = np.ones(k)
        self.best_x = self.x.copy()
        self.calm = np.zeros(k, dtype=int)

    def step(self, active: Indices, tol: float, goal: Array) -> Indices:
        """One Newton step and, where centred, one predictor step; returns the points that go on."""
        try:
            done = self._step(active, tol, goal)
        except np.linalg.LinAlgError:
            # One matrix of the stack has come to the end of its digits: find it, and let it rest at its best point.
            if len(active) == 1:
                return active[:0]
            return np.concatenate([self.step(active[i : i + 1], tol, goal) for i in range(len(active))])
        return active[~done]

    def _step(self, i: Indices, tol: float, goal: Array) -> Mask:
        x, t = self.x[i], self.t[i]
        F, Dw = self._forms(i, x, t)
        gradient, hessian, drift, P = self._derivatives(i, F, Dw, t)
        dx, tangent = _solve(hessian, -gradient, -drift)
        decrement = -(gradient * dx).sum(axis=1)
        near = decrement < NEAR
        x = x + self._line(i, dx, t, F, Dw)[:, None] * dx
        gap = 3 * self.m / np.maximum(np.einsum("kij,kji->k", P, Dw).real, 1e-300)
        x, t = self._predict(i, x, t, tangent, near)
        found = self._level(i, x)
        better = found < self.best_t[i]
        self.best_t[i] = np.where(better, found, self.best_t[i])
        self.best_x[i] = np.where(better[:, None], x, self.best_x[i])
        self.x[i], self.t[i] = x, t
        best = self.best_t[i]
        # D far from I makes the gap estimate lie now and then: two centred steps in a row have to agree.
        beyond = self.t[i] - gap > goal[i]
        calm = near & ((gap < tol * np.abs(t)) | (np.isfinite(goal[i]) & beyond))
        self.calm[i] = np.where(calm, self.calm[i] + 1, 0)
        return (self.calm[i] >= 2) | (best <= 0) | (self.t[i] < NEGATIVE) | (best <= goal[i])

    def _forms(self, i: Indices, x: Array, t: Array) -> tuple[ComplexArray, ComplexArray]:
        """``F_t(x)`` and ``D_w(x)``."""
        M = self.M[i]
        Dw, Dz, G = self.space.matrices(x)
        needed = supply(M, Dz, G)
        return t[:, None, None] * Dw - (needed + hermitian(needed)) / 2, Dw

    def _derivatives(
        self, i: Indices, F: ComplexArray, Dw: ComplexArray, t: Array
    ) -> tuple[Array, Array, Array, ComplexArray]:
        """Gradient, Hessian, derivative of the gradient by t, and ``P = F^-1``."""
        s, U = self.space, self.U[i]
        P = np.linalg.inv(F)
        P = (P + hermitian(P)) / 2
        W = hermitian(U) @ P @ U
        V = hermitian(U) @ (P @ Dw @ P) @ U
        inverse = np.zeros_like(W)
        inverse[:, : self.m, : self.m] = np.linalg.inv(Dw)
        c = s.coefficients * np.where(s.in_w > 0, t[:, None], 1.0)
        r, k = s.rows, s.cols
        entry = -c * W[:, k, r] - RHO * s.in_w * s.coefficients * inverse[:, k, r]
        entry += (1 + RHO) * s.in_w * s.coefficients * (r == k)
        drift = c * V[:, k, r] - s.in_w * s.coefficients * W[:, k, r]
        # tr(W E_a W E_b) for unit entries (r, k): W[k_b, r_a] W[k_a, r_b].
        cross = W[:, k[None, :], r[:, None]]
        cross = cross * np.swapaxes(cross, 1, 2) * (c[:, :, None] * c[:, None, :])
        own = inverse[:, k[None, :], r[:, None]]
        cw = s.in_w * s.coefficients
        cross += RHO * own * np.swapaxes(own, 1, 2) * (cw[:, None] * cw[None, :])
        hessian = np.real(np.add.reduceat(np.add.reduceat(cross, s.first, axis=1), s.first, axis=2))
        return (
            np.real(np.add.reduceat(entry, s.first, axis=1)),
            hessian,
            np.real(np.add.reduceat(drift, s.first, axis=1)),
            P,
        )

    def _line(self, i: Indices, dx: Array, t: Array, F: ComplexArray, Dw: ComplexArray) -> Array:
        """Step lengths that minimise the barrier along dx, by safeguarded Newton steps on its eigenvalue form."""
        dF, dD = self._forms(i, dx, t)
        e, d = _eigenvalues(F, dF), _eigenvalues(Dw, dD)
        slope = (1 + RHO) * np.einsum("kii->k", dD).real
        high = 0.999 / np.maximum(np.maximum(-e[:, 0], -d[:, 0]), 1e-3)
        low = np.zeros(len(high))
        a = np.minimum(1.0, 0.9 * high)
        for _ in range(10):
            qe, qd = e / (1 + a[:, None] * e), d / (1 + a[:, None] * d)
            g = slope - qe.sum(axis=1) - RHO * qd.sum(axis=1)
            h = (qe**2).sum(axis=1) + RHO * (qd**2).sum(axis=1)
            low, high = np.where(g < 0, a, low), np.where(g < 0, high, a)
            newton = a - g / np.maximum(h, 1e-300)
            a = np.where((newton > low) & (newton < high), newton, (low + high) / 2)
        return a

    def _predict(self, i: Indices, x: Array, t: Array, tangent: Array, near: Mask) -> tuple[Array, Array]:
        """Lower t along the tangent of the central path where centred; towards the level of x elsewhere."""
        F, Dw = self._forms(i, x, t)
        vF, vD = self._forms(i, tangent, t)
        e = _eigenvalues(F, Dw + vF)  # F(t - s, x - s v) = F - s (D_w + F(v)) + s^2 D_w(v)
        d = _eigenvalues(Dw, vD)
        reach = STEP / np.maximum(np.maximum(e[:, -1], d[:, -1]), 1e-12)
        own = STEP * 0.5 / np.maximum(_eigenvalues(F, Dw)[:, -1], 1e-12)
        step = np.where(near, reach, 0.0)
        good = np.zeros(len(i), dtype=bool)
        for _ in range(6):
            nx, nt = x - step[:, None] * tangent, t - step
            F1, D1 = self._forms(i, nx, nt)
            good = (np.linalg.eigvalsh(F1)[:, 0] > 0) & (np.linalg.eigvalsh(D1)[:, 0] > 0)
            if good.all():
                break
            step = np.where(good, step, step / 2)
        straight = ~(good & near & (step > own))
        return np.where(straight[:, None], x, x - step[:, None] * tangent), np.where(straight, t - own, t - step)

    def _level(self, i: Indices, x: Array) -> Array:
        """Smallest t for which x is feasible in spite of rounding; near mu = 0, G grows and digits are lost."""
        M = self.M[i]
        Dw, Dz, G = self.space.matrices(x)
        w, z = (1 / np.sqrt(np.einsum("kii->ki", d).real) for d in (Dw, Dz))
        M = M * w[:, None, :] / z[:, :, None]
        Dw = Dw * w[:, :, None] * w[:, None, :]
        Dz = Dz * z[:, :, None] * z[:, None, :]
        G = G * w[:, :, None] * z[:, None, :]
        needed = supply(M, Dz, G)
        size = np.abs(M)
        cross = np.abs(G) @ size
        bound = np.swapaxes(size, 1, 2) @ np.abs(Dz) @ size + cross + np.swapaxes(cross, 1, 2)
        rounding = 1e-14 * self.m * bound.sum(axis=2).max(axis=1)
        return _eigenvalues(Dw, (needed + hermitian(needed)) / 2)[:, -1] + rounding / np.linalg.eigvalsh(Dw)[:, 0]


def _eigenvalues(X: ComplexArray, Y: ComplexArray) -> Array:
    """Eigenvalues of Y relative to the positive definite X, ascending, (k, n)."""
    value = relative(X, Y)
    if not np.isfinite(value).all():
        raise np.linalg.LinAlgError("not finite")
    return np.linalg.eigvalsh(value)


def _solve(hessian: Array, *right: Array) -> list[Array]:
    """Newton system in diagonal scaling; directions without curvature (G of a real entry of M) stay where they are."""
    diagonal = np.einsum("kii->ki", hessian)
    largest = diagonal.max(axis=1, keepdims=True)
    if not (np.isfinite(diagonal).all() and (largest > 0).all()):
        raise np.linalg.LinAlgError("not finite")
    flat = diagonal < 1e-14 * largest
    scale = 1 / np.sqrt(np.where(flat, largest, diagonal))
    scaled = hessian * scale[:, :, None] * scale[:, None, :]
    n = hessian.shape[1]
    scaled = scaled + (1e-13 + flat.astype(float))[:, :, None] * np.eye(n)
    rhs = np.stack([r * scale for r in right], axis=2)
    solution = np.linalg.solve(scaled, rhs) * scale[:, :, None]
    return [solution[:, :, j] for j in range(len(right))]
