"""The two Riccati equations of H-infinity synthesis with a general D11 (Glover and Doyle), for one gamma.

Best read with Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 17.1, at hand; names are theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.matrix_equations import care
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.partition import PlantMatrices

__all__ = ["RiccatiPair", "TwoRiccatiProblem"]

Array = NDArray[Any]

# An exact X = 0 comes out as noise of this size in a plant scaled to order one; it must not count as indefinite.
PSD_TOLERANCE = 1e-6
# The controller is verified on the plant afterwards, so a poor residual here only costs a try.
RESIDUAL = 1e-3
RANK = 1e-13
# Range of gamma that is searched, in a plant scaled to order one.
SMALLEST, LARGEST = 1e-9, 1e9


@dataclass(frozen=True, eq=False)
class RiccatiPair:
    """Solutions X, Y >= 0 at gamma with gains F, L, and ``rho(X Y) / gamma^2 < 1``."""

    gamma: float
    X: Array
    Y: Array
    F: Array
    L: Array
    coupling: float


class TwoRiccatiProblem:
    """A regular plant in the coordinates ``D12 = [0; I]``, ``D21 = [0 I]``, and the gamma test on it.

    Raises
    ------
    NoTrustworthyNumber
        D12 has no full column rank or D21 no full row rank.
    """

    def __init__(self, plant: PlantMatrices) -> None:
        _, n_w, n_u, n_z, n_y = plant.sizes
        if n_z < n_u or n_w < n_y:
            raise NoTrustworthyNumber("H-infinity Riccati test", "D12 or D21 cannot have full rank")
        U, s12, Vt = np.linalg.svd(plant.D12)
        W, s21, Rt = np.linalg.svd(plant.D21)
        if min(s12.min(), s21.min()) <= RANK * max(1.0, s12.max(), s21.max()):
            raise NoTrustworthyNumber("H-infinity Riccati test", "D12 or D21 is rank deficient")
        self.u_back = Vt.T / s12  # u = u_back @ u_normalised
        self.y_into = W.T / s21[:, None]  # y_normalised = y_into @ y
        z_turn = np.hstack([U[:, n_u:], U[:, :n_u]])
        w_turn = np.vstack([Rt[n_y:], Rt[:n_y]]).T
        self.a, self.b = n_z - n_u, n_w - n_y
        self.n_w, self.n_z, self.n_u, self.n_y = n_w, n_z, n_u, n_y
        self.A, self.B1, self.B2 = plant.A, plant.B1 @ w_turn, plant.B2 @ self.u_back
        self.C1, self.C2 = z_turn.T @ plant.C1, self.y_into @ plant.C2
        self.D11 = z_turn.T @ plant.D11 @ w_turn
        self.D12 = np.vstack([np.zeros((self.a, n_u)), np.eye(n_u)])
        self.D21 = np.hstack([np.zeros((n_y, self.b)), np.eye(n_y)])
        parts = (self.D11[: self.a], self.D11[:, : self.b])
        self.floor = max((float(np.linalg.norm(part, 2)) if part.size else 0.0) for part in parts)

    def solve(self, gamma: float) -> RiccatiPair | None:
        """The pair at this gamma, or None where the test fails (gamma too small, or lost to rounding)."""
        if gamma <= self.floor * (1 + 1e-12):
            return None
        B, row = np.hstack([self.B1, self.B2]), np.hstack([self.D11, self.D12])
        R = row.T @ row
        R[: self.n_w, : self.n_w] -= gamma**2 * np.eye(self.n_w)
        state_feedback = _positive(self.A, B, self.C1.T @ self.C1, R, self.C1.T @ row)
        if state_feedback is None:
            return None
        C, column = np.vstack([self.C1, self.C2]), np.vstack([self.D11, self.D21])
        Rt = column @ column.T
        Rt[: self.n_z, : self.n_z] -= gamma**2 * np.eye(self.n_z)
        filtering = _positive(self.A.T, C.T, self.B1 @ self.B1.T, Rt, self.B1 @ column.T)
        if filtering is None:
            return None
        (X, F), (Y, L) = state_feedback, filtering
        coupling = float(np.abs(np.linalg.eigvals(X @ Y)).max(initial=0.0)) / gamma**2
        return RiccatiPair(gamma, X, Y, F, L.T, coupling) if coupling < 1 else None

    def smallest_gamma(
        self, start: float, stop: Callable[[], bool] = lambda: False, rtol: float = 1e-4
    ) -> float | None:
        """Smallest gamma that passes the test; None where none up to ``LARGEST`` does.

        Brackets from ``start`` by growing steps, bisects, and then probes below the result, because the test in
        floating point is not monotone in gamma. ``stop`` is asked between tests; then the smallest gamma so far is
        returned.
        """
        high = max(start, self.floor * 1.01 + 1e-12)
        while self.solve(high) is None:
            high *= 4
            if high > LARGEST or stop():
                return None
        share = 0.97
        while True:
            low = max(high * share, self.floor)
            while low > self.floor and self.solve(low) is not None and not stop():
                high, share = low, max(share**2, 1e-2)
                low = max(high * share, self.floor)
                if high < SMALLEST:
                    return high
            while high - low > rtol * high and high > SMALLEST and not stop():
                middle = float(np.sqrt(max(low, 1e-3 * high) * high))
                if self.solve(middle) is None:
                    low = middle
                else:
                    high = middle
            for share in (0.93, 0.8, 0.6, 0.4, 0.2, 0.07, 0.02):
                if stop():
                    return high
                if high * share > self.floor and self.solve(high * share) is not None:
                    high, share = high * share, 0.97
                    break
            else:
                return high

    def central_controller(self, pair: RiccatiPair) -> StateSpaceModel:
        """The central controller of a pair, from y to u of the plant given.

        Raises
        ------
        NoTrustworthyNumber
            A factor of it is singular: gamma is too close to its limit.
        """
        a, b, g2 = self.a, self.b, pair.gamma**2
        D1111, D1112 = self.D11[:a, :b], self.D11[:a, b:]
        D1121, D1122 = self.D11[a:, :b], self.D11[a:, b:]
        F12, F2 = pair.F[b : self.n_w], pair.F[self.n_w :]
        L12, L2 = pair.L[:, a : self.n_z], pair.L[:, self.n_z :]
        try:
            left = np.linalg.solve(g2 * np.eye(a) - D1111 @ D1111.T, D1112)
            right = np.linalg.solve(g2 * np.eye(b) - D1111.T @ D1111, D1121.T)
            D11 = -D1121 @ D1111.T @ left - D1122
            D12 = np.linalg.cholesky(np.eye(self.n_u) - D1121 @ right)
            D21 = np.linalg.cholesky(np.eye(self.n_y) - D1112.T @ left).T
            Z = np.eye(self.A.shape[0]) - pair.Y @ pair.X / g2
            B2 = np.linalg.solve(Z, (self.B2 + L12) @ D12)
            C2 = -D21 @ (self.C2 + F12)
            B1 = -np.linalg.solve(Z, L2) + B2 @ np.linalg.solve(D12, D11)
            to_state = np.linalg.solve(D21, C2)
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("central controller", "gamma is too close to its limit") from None
        C1 = F2 + D11 @ to_state
        A = self.A + np.hstack([self.B1, self.B2]) @ pair.F + B1 @ to_state
        parts = (A, B1 @ self.y_into, self.u_back @ C1, self.u_back @ D11 @ self.y_into)
        if not all(np.isfinite(part).all() for part in parts):
            raise NoTrustworthyNumber("central controller", "the controller is not finite")
        return StateSpaceModel(*parts)


def _positive(A: Array, B: Array, Q: Array, R: Array, S: Array) -> tuple[Array, Array] | None:
    """Stabilising positive semidefinite solution and its gain, or None."""
    try:
        found = care(A, B, 0.5 * (Q + Q.T), 0.5 * (R + R.T), S, tolerance=RESIDUAL)
    except NoTrustworthyNumber:
        return None
    values, vectors = np.linalg.eigh(found.X)
    if len(values) and values[0] < -PSD_TOLERANCE * max(1.0, values[-1]):
        return None
    X = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return X, -np.linalg.solve(R, B.T @ X + S.T)
