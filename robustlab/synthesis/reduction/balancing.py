r"""Square-root balancing: Hankel values, truncation and residualisation of a model from factors of two Gramians.

.. math:: P = L_c L_c^T, \quad Q = L_o L_o^T, \quad L_o^T L_c = U \Sigma V^T, \quad
   T = L_c V \Sigma^{-1/2}, \quad T^{-1} = \Sigma^{-1/2} U^T L_o^T

Any two positive semidefinite matrices may replace the Gramians: those of a weighted model, or of a closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import balancing_factors, small_residual
from robustlab.linear_analysis.structural import HiddenMode, LeastOrder, least_order
from robustlab.statespace import StateSpaceModel, parallel
from robustlab.verification.balls import exact, midpoints, precision

Projection = Literal["truncation", "residualisation"]
BITS = 128  # precision of residuals
RESIDUAL = 1e-8  # relative, of the equations of the Gramians

# Hankel values below this share of the largest are rounding: their states are truncated.
NEGLIGIBLE = 1e-14
EPS = float(np.finfo(float).eps)
# A pole counts as stable from this distance to the boundary on, as a share of its modulus (of 1 for a discrete one).
STABLE_MARGIN = 1e-10


@dataclass(frozen=True, eq=False)
class SplitModel:
    """A model as the sum of a stable part with D, which can be balanced, and the rest, without signal names."""

    stable: StateSpaceModel
    apart: StateSpaceModel
    lost: StateSpaceModel | None = None  # the model less that sum; None if zero
    hidden: tuple[HiddenMode, ...] = ()  # modes removed before the split

    def joined(self, reduced: StateSpaceModel) -> StateSpaceModel:
        """Return the sum with a reduced stable part, whose states come first."""
        return parallel(reduced, self.apart) if self.apart.n_states else reduced


def lost_at_least_order(least: LeastOrder) -> StateSpaceModel | None:
    """Return the model given less that of least order; None if zero."""
    first = _lost(least.given, least.right, least.reached)
    dual = _lost(_transposed(least.reached), least.left.T, _transposed(least.model))
    return first if dual is None else _sum(first, _transposed(dual))


def _lost(m: StateSpaceModel, t: AnyArray, parts: StateSpaceModel) -> StateSpaceModel | None:
    r"""Return the error of the change to states T, exact up to one rounding of each residual; None if zero.

    .. math:: C (sI - A)^{-1} (R_A (sI - \Lambda)^{-1} \hat B + R_B) + R_C (sI - \Lambda)^{-1} \hat B, \qquad
       R_A = A T - T \Lambda, \quad R_B = B - T \hat B, \quad R_C = C T - \hat C
    """
    with precision(BITS):
        T = exact(t)
        a = midpoints(exact(m.A) * T - T * exact(parts.A))
        b = midpoints(exact(m.B) - T * exact(parts.B))
        c = midpoints(exact(m.C) * T - exact(parts.C))
    if not (a.any() or b.any() or c.any()):
        return None
    return StateSpaceModel(
        np.block([[parts.A, np.zeros((t.shape[1], len(t)))], [a, m.A]]), np.vstack([parts.B, b]),
        np.hstack([c, m.C]), np.zeros_like(m.D), m.dt,
    )  # fmt: skip


def _sum(first: StateSpaceModel | None, second: StateSpaceModel | None) -> StateSpaceModel | None:
    return parallel(first, second) if first and second else first or second


def _transposed(m: StateSpaceModel) -> StateSpaceModel:
    return StateSpaceModel(m.A.T, m.C.T, m.B.T, m.D.T, m.dt)


def split_stable(model: StateSpaceModel) -> SplitModel:
    r"""Split a model into stable and other modes in parallel: ordered real Schur form, then a Sylvester equation.

    .. math:: A = Q \begin{bmatrix} A_{11} & A_{12} \\ 0 & A_{22} \end{bmatrix} Q^T, \qquad
       A_{11} X - X A_{22} + A_{12} = 0, \qquad T = Q \begin{bmatrix} I & X \\ 0 & I \end{bmatrix}

    A pole that rounding may move to the boundary does not count as stable. Unstable modes that are uncontrollable or
    unobservable are removed before.

    References
    ----------
    Safonov, Jonckheere, Verma, Limebeer, "Synthesis of positive real multivariable feedback systems" (1987).
    """
    n, dt, D = model.n_states, model.dt, model.D
    poles = model.poles()
    scale = balancing_factors(model.A)
    a, b, c = model.A / scale[:, None] * scale, model.B / scale[:, None], model.C * scale
    margin = np.maximum(STABLE_MARGIN * (1.0 if dt else np.abs(poles)), 10 * EPS * np.abs(a).sum(axis=0).max(initial=0))
    stable = (1 - np.abs(poles) if dt else -np.real(poles)) > margin
    static = StateSpaceModel([], [], [], 0 * D, dt)
    if stable.all():
        return SplitModel(model, static)
    least = least_order(model)
    if not all(mode.stable for mode in least.hidden):
        split = split_stable(least.model)
        return replace(split, lost=_sum(split.lost, lost_at_least_order(least)), hidden=least.hidden)
    if not stable.any():
        return SplitModel(replace(static, D=D), StateSpaceModel(model.A, model.B, model.C, 0 * D, dt))
    from scipy.linalg import LinAlgError, schur, solve_sylvester

    try:
        form = schur(a, output="real", sort=lambda x, y: bool(stable[np.abs(poles - complex(x, y)).argmin()]))
        t, q, k = np.asarray(form[0]), np.asarray(form[1]), int(form[-1])
        x = solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:]) if 0 < k < n else np.zeros((k, n - k))
    except LinAlgError:
        raise NoTrustworthyNumber("stable part", "its poles cannot be told from the others") from None
    with np.errstate(over="ignore", invalid="ignore"):
        residual = np.linalg.norm(t[:k, :k] @ x - x @ t[k:, k:] + t[:k, k:])
        size = np.linalg.norm(t)
    if not residual <= 1e-8 * (1 + np.linalg.norm(x)) * size < np.inf:
        raise NoTrustworthyNumber("stable part", f"its poles cannot be told from the others (residual {residual:.1e})")
    basis = np.hstack([q[:, :k], q[:, :k] @ x + q[:, k:]])
    out, low = c @ basis, q.T @ b
    parts = (
        StateSpaceModel(t[:k, :k], low[:k] - x @ low[k:], out[:, :k], D, dt),
        StateSpaceModel(t[k:, k:], low[k:], out[:, k:], 0 * D, dt),
    )
    return SplitModel(*parts, _lost(StateSpaceModel(a, b, c, D, dt), basis, parallel(*parts)))


def gramian_factors(model: StateSpaceModel) -> tuple[AnyArray, AnyArray]:
    """Return factors ``(L_c, L_o)`` of the Gramians of a stable model, each (n, n), checked by their residuals."""
    if not model.n_states:
        return np.zeros((0, 0)), np.zeros((0, 0))
    t, discrete = balancing_factors(model.A), model.is_discrete
    A, B, C = model.A / t[:, None] * t, model.B / t[:, None], model.C * t
    reach, see = slicot.gramian_factors(A, B, C, discrete)
    for a, X, known in ((A, reach @ reach.T, B @ B.T), (A.T, see @ see.T, C.T @ C)):
        small_residual("gramians", 0.5 * (a @ X @ a.T - X) if discrete else a @ X, known, RESIDUAL)
    return t[:, None] * reach, see / t[:, None]


def block_factor(rows: AnyArray) -> AnyArray:
    """Return a square factor of the diagonal block of ``L L^T`` that belongs to some rows of L."""
    return np.asarray(np.linalg.qr(rows.T, mode="r")).T


@dataclass(frozen=True, eq=False)
class Balancing:
    """Balancing transformation of a pair of Gramian factors."""

    values: AnyArray  # Hankel values, the singular values of `L_o^T L_c`, (n,), in decreasing order
    right: AnyArray  # T for the m states above NEGLIGIBLE, (n, m)
    left: AnyArray  # left inverse of T, (m, n)

    @classmethod
    def of(cls, reach: AnyArray, see: AnyArray) -> Balancing:
        """Balance ``L_c`` and ``L_o``, each with n rows."""
        u, values, vt = np.linalg.svd(see.T @ reach)
        values = values[: len(reach)]
        values.setflags(write=False)
        m = int((values > NEGLIGIBLE * values.max(initial=0.0)).sum())
        root = np.sqrt(values[:m])
        return cls(values, reach @ vt[:m].T / root, (see @ u[:, :m] / root).T)

    def reduced(self, model: StateSpaceModel, order: int, projection: Projection) -> StateSpaceModel:
        """Return the model of this order, at most the number of states above NEGLIGIBLE.

        Residualisation sets the derivatives of the other states to zero (discrete: their change), which keeps the gain
        at zero frequency exactly.
        """
        if projection == "truncation" or not len(self.left):
            t, back = self.right[:, :order], self.left[:order]
            return _model(model, back @ model.A @ t, back @ model.B, model.C @ t, model.D)
        a, b, c = self.left @ model.A @ self.right, self.left @ model.B, model.C @ self.right
        r = min(order, len(a))
        rest = (np.eye(len(a) - r) if model.is_discrete else 0.0) - a[r:, r:]
        try:
            solved = np.linalg.solve(rest, np.hstack([a[r:, :r], b[r:]]))
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("residualisation", "the states left out have no equilibrium") from None
        state, gain = solved[:, :r], solved[:, r:]
        return _model(
            model, a[:r, :r] + a[:r, r:] @ state, b[:r] + a[:r, r:] @ gain, c[:, :r] + c[:, r:] @ state,
            model.D + c[:, r:] @ gain,
        )  # fmt: skip


def _model(like: StateSpaceModel, a: AnyArray, b: AnyArray, c: AnyArray, d: AnyArray) -> StateSpaceModel:
    return StateSpaceModel(a, b, c, d, like.dt, like.inputs, like.outputs, where="reduced model")
