r"""Balanced models and the methods of reduction: truncation, residualisation, Hankel norm, stochastic, coprime factors.

Square-root balancing with any two positive semidefinite matrices P, Q in place of the Gramians:

.. math:: P = L_c L_c^T, \quad Q = L_o L_o^T, \quad L_o^T L_c = U \Sigma V^T, \quad
   T = L_c V \Sigma^{-1/2}, \quad T^{-1} = \Sigma^{-1/2} U^T L_o^T

Stochastic balancing bounds the relative error by :math:`\prod_{i > r} (1 + \mu_i) / (1 - \mu_i) - 1` with
:math:`\mu_i^2 = \lambda_i(P X)`, X the observability Gramian of the minimum-phase factor W of the power spectrum, and
beta a floor of the gain (Desai, Pal, IEEE TAC 29, 1984; Green, IEEE TAC 33, 1988; Varga, Fasol 1993 for beta):

.. math:: G G^\sim + \beta^2 I = W^\sim W, \quad R = D D^T + \beta^2 I, \quad B_W = P C^T + B D^T, \quad
   A^T X + X A + (C - B_W^T X)^T R^{-1} (C - B_W^T X) = 0

Optimal Hankel-norm approximation is the all-pass dilation of balanced states (Glover, Int. J. Control 39, 1984,
theorems 6.3 and 9.7), with :math:`\Sigma = \mathrm{diag}(\Sigma_1, \sigma I)`, and A, B, C cut alike:

.. math:: U = -(C_2^T)^+ B_2, \quad \Gamma = \Sigma_1^2 - \sigma^2 I, \quad
   \hat A = \Gamma^{-1} (\sigma^2 A_{11}^T + \Sigma_1 A_{11} \Sigma_1 - \sigma C_1^T U B_1^T), \quad
   \hat B = \Gamma^{-1} (\Sigma_1 B_1 + \sigma C_1^T U), \quad \hat C = C_1 \Sigma_1 + \sigma U B_1^T, \quad
   \hat D = D - \sigma U

Its stable modes are the nearest model of their order; a constant replaces the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import balancing_factors, care, small_residual
from robustlab.linear_analysis.structural import HiddenMode, LeastOrder, least_order
from robustlab.norms import bilinear_to_continuous, bilinear_to_discrete
from robustlab.statespace import StateSpaceModel, parallel, series
from robustlab.uncertainty.gap_metric import continuous_models, coprime_factors
from robustlab.verification.balls import exact, midpoints, precision

Projection = Literal["truncation", "residualisation"]
Weights = tuple[StateSpaceModel | None, StateSpaceModel | None]  # W_i and W_o

BITS = 128  # precision of residuals
RESIDUAL = 1e-8  # relative, of the equations of the Gramians
NEGLIGIBLE = 1e-14  # Hankel values below this share of the largest are rounding: their states are truncated
EPS = float(np.finfo(float).eps)
# A pole counts as stable from this distance to the boundary on, as a share of its modulus (of 1 for a discrete one).
STABLE_MARGIN = 1e-10
HINT = "floor=: the gain below which errors count absolutely"
# D of full row rank: smallest over largest eigenvalue of D D^T. Else the gain vanishes at infinite frequency.
FULL_RANK = 1e-12
# Hankel values that agree to this share are one repeated value: division by their difference would lose more digits.
REPEATED = 1e-8


@dataclass(frozen=True, eq=False)
class SplitModel:
    """A model as the sum of a stable part with D, which can be balanced, and the rest, without signal names."""

    stable: StateSpaceModel
    apart: StateSpaceModel
    lost: StateSpaceModel | None = None  # the model less that sum; None if zero
    hidden: tuple[HiddenMode, ...] = ()  # modes removed before the split


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
    """Split a model into stable and other modes in parallel: ordered real Schur form, then a Sylvester equation."""
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
        raise NoTrustworthyNumber("stable part", "its poles cannot be distinguished from the others") from None
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
        """Return the model of this order, at most the number of states above NEGLIGIBLE."""
        if projection == "truncation" or not len(self.left):
            t, back = self.right[:, :order], self.left[:order]
            return StateSpaceModel(back @ model.A @ t, back @ model.B, model.C @ t, model.D, model.dt)
        a, b, c = self.left @ model.A @ self.right, self.left @ model.B, model.C @ self.right
        r = min(order, len(a))
        rest = (np.eye(len(a) - r) if model.is_discrete else 0.0) - a[r:, r:]
        try:
            solved = np.linalg.solve(rest, np.hstack([a[r:, :r], b[r:]]))
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("residualisation", "the states left out have no equilibrium") from None
        state, gain = solved[:, :r], solved[:, r:]
        C, D = c[:, :r] + c[:, r:] @ state, model.D + c[:, r:] @ gain
        return StateSpaceModel(a[:r, :r] + a[:r, r:] @ state, b[:r] + a[:r, r:] @ gain, C, D, model.dt)


# --- methods ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Way:
    """One method for a part of a model."""

    method: str
    split: SplitModel
    part: StateSpaceModel  # the reduced part: the stable one, or the coprime factors
    model: StateSpaceModel  # the same, or its continuous image for the methods that exist in continuous time only
    balancing: Balancing
    weights: Weights = (None, None)

    def reduced(self, order: int) -> StateSpaceModel:
        """Return the part with this order."""
        if self.method == "hankel":
            small = nearest_in_hankel_norm(self.model, self.balancing, order)
        else:
            kind = "residualisation" if self.method == "residualisation" else "truncation"
            small = self.balancing.reduced(self.model, order, kind)
        return bilinear_to_discrete(small, self.part.dt) if self.part.dt != self.model.dt else small

    def whole(self, small: StateSpaceModel) -> StateSpaceModel:
        """Return the model that belongs to a reduced part: ``N M^{-1}`` for coprime factors."""
        if self.method != "coprime":
            return parallel(small, self.split.apart) if self.split.apart.n_states else small
        p, dt = self.split.stable.n_outputs, self.split.stable.dt
        if small.n_inputs and np.linalg.cond(small.D[p:]) > 1e12:
            raise NoTrustworthyNumber("reduce_model", "the factor M of the reduced model has no inverse")
        back = np.linalg.inv(small.D[p:])
        gain, into = back @ small.C[p:], small.B @ back
        C, D = small.C[:p] - small.D[:p] @ gain, small.D[:p] @ back
        model = StateSpaceModel(small.A - into @ small.C[p:], into, C, D)
        return bilinear_to_discrete(model, dt) if dt else model

    def bound(self, order: int) -> float:
        """Return the a-priori bound of the error; NaN with weights and for a relative one."""
        factor = 1 if self.method == "hankel" else 2
        none = self.method == "stochastic" or self.weights != (None, None)
        return np.nan if none else factor * float(self.balancing.values[order:].sum())


def way_of(full: StateSpaceModel, method: str, weights: Weights = (None, None), floor: float = 0.0) -> Way:
    """Return a method for the stable part of a model, or for the coprime factors of all of it."""
    if method == "coprime":  # truncation of the normalised right factors [N; M] (continuous)
        least = least_order(full)
        unstable = any(not mode.stable for mode in least.hidden)
        full = least.model if unstable else full
        factors = coprime_factors(*continuous_models(full)).right
        nothing = StateSpaceModel([], [], [], 0 * full.D, full.dt)
        balancing = Balancing.of(*gramian_factors(factors))
        split = SplitModel(full, nothing)
        if unstable:
            split = SplitModel(full, nothing, lost_at_least_order(least), least.hidden)
        return Way(method, split, factors, factors, balancing)
    split = split_stable(full)
    stable = split.stable
    continuous = bilinear_to_continuous(stable) if stable.dt and method in ("stochastic", "hankel") else stable
    if method == "stochastic":
        return Way(method, split, stable, continuous, _stochastic(continuous, floor))
    reach, see = gramian_factors(continuous)
    into, out = weights  # the model's blocks of the Gramians of G W_i and W_o G (Enns)
    if into is not None:  # states of the series connection: weight first, then model
        reach = block_factor(gramian_factors(series(into, stable))[0][into.n_states :])
    if out is not None:
        see = block_factor(gramian_factors(series(stable, out))[1][: stable.n_states])
    return Way(method, split, stable, continuous, Balancing.of(reach, see), weights)


# --- Hankel norm ------------------------------------------------------------------------------------------------------


def _dilated(m: StateSpaceModel, values: AnyArray, k: int, unitary: bool = False) -> tuple[StateSpaceModel, AnyArray]:
    """Return the dilation of a balanced model without the (repeated) value at index k, and the other values."""
    level = values[k]
    cut = np.abs(values - level) <= REPEATED * level
    u = -np.linalg.pinv(m.C[:, cut].T) @ m.B[cut]
    if unitary:
        eye = np.eye(len(u))
        left, _, right = np.linalg.svd(u + (eye - u @ u.T) @ (eye - u.T @ u))
        u = left @ right
    s, a, b, c = values[~cut], m.A[np.ix_(~cut, ~cut)], m.B[~cut], m.C[:, ~cut]
    gamma = s**2 - level**2
    root = np.sqrt(np.abs(gamma))
    inverse = (np.sign(gamma) / root)[:, None]
    middle = level**2 * a.T + s[:, None] * a * s - level * c.T @ u @ b.T
    B, C = inverse * (s[:, None] * b + level * c.T @ u), (c * s + level * u @ b.T) / root
    return StateSpaceModel(inverse * middle / root, B, C, m.D - level * u), s


def nearest_in_hankel_norm(model: StateSpaceModel, balancing: Balancing, order: int) -> StateSpaceModel:
    """Return the nearest model of at most this order; of a lower one if the value after the cut is repeated."""
    values = balancing.values[: len(balancing.left)]
    if order >= len(values):
        return balancing.reduced(model, order, "truncation")
    order = int((values > values[order] * (1 + REPEATED)).sum())
    parts = split_stable(_dilated(balancing.reduced(model, len(values), "truncation"), values, order)[0])
    m = parts.stable
    if m.n_states != order:
        found = f"{m.n_states} stable modes where there should be {order}: digits were lost"
        raise NoTrustworthyNumber("Hankel-norm approximation", found, hint="another order, or method='truncation'")
    return StateSpaceModel(m.A, m.B, m.C, m.D + _constant_near(parts.apart))


def _constant_near(unstable: StateSpaceModel) -> AnyArray:
    """Return a constant no farther from a strictly proper antistable model than the sum of its Hankel values."""
    mirrored = StateSpaceModel(-unstable.A, -unstable.B, unstable.C, unstable.D)
    balancing = Balancing.of(*gramian_factors(mirrored))
    values = balancing.values[: len(balancing.left)]
    left = balancing.reduced(mirrored, len(values), "truncation")
    (p, m), size = left.D.shape, max(left.D.shape)
    rows, columns = (0, size - p), (0, size - m)
    square = np.pad(left.B, ((0, 0), columns)), np.pad(left.C, (rows, (0, 0))), np.pad(left.D, (rows, columns))
    left = StateSpaceModel(left.A, *square)
    while len(values):
        left, values = _dilated(left, values, len(values) - 1, unitary=True)
    return left.D[:p, :m]


# --- relative error ---------------------------------------------------------------------------------------------------


def _stochastic(model: StateSpaceModel, floor: float) -> Balancing:
    """Return the balancing of P and X of a stable continuous model; its values are the mu_i, at most 1."""
    a, b, c, d = model.A, model.B, model.C, model.D
    sizes, turn = np.linalg.eigh(d @ d.T + floor**2 * np.eye(len(d)))
    if not len(d) or sizes[0] <= FULL_RANK * sizes[-1]:
        found = "the gain vanishes at infinite frequency: D has no full row rank"
        raise InputError("reduce_model", found, "a gain that vanishes nowhere", HINT)
    root, back = turn * np.sqrt(sizes) @ turn.T, turn / np.sqrt(sizes) @ turn.T
    reach = gramian_factors(model)[0]
    into = reach @ (reach.T @ c.T) + b @ d.T
    try:
        X = care(a, into, np.zeros_like(a), -root @ root, -c.T).X
    except NoTrustworthyNumber as error:
        found = "the power spectrum has no factor: the gain vanishes at some frequency, or nearly"
        raise NoTrustworthyNumber("reduce_model", f"{found} ({error.found})", hint=HINT) from None
    return Balancing.of(reach, gramian_factors(StateSpaceModel(a, b, back @ (c - into.T @ X), d))[1])
