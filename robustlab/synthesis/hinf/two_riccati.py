"""The two Riccati equations of H-infinity synthesis with a general D11, for one gamma.

Numbers in parentheses are equations of Glover, Doyle, Systems & Control Letters 11 (1988). The controller's states are
those of Zhou, Doyle, Glover (1996), theorem 17.1: Z of (27) goes into B instead of C.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import care, hamiltonian_riccati
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation, dual

# Rounding of an exact X = 0, scaled, which must not count as indefinite. Larger: false passes.
SEMIDEFINITE = 1e-6
# Largest residual of a Riccati solution; the loop is verified afterwards.
RESIDUAL = 1e-3
# Range of gamma that is searched, scaled.
SMALLEST_GAMMA = 1e-9
LARGEST_GAMMA = 1e9
# Shares of the smallest gamma found that are tested again (the first one; in a careful search all of them): the test
# in floating point is not monotone in gamma. Longer: fewer false ends, more tests.
PROBES = (0.93, 0.8, 0.6, 0.4, 0.2, 0.07, 0.02)
# Singular values of D12 or D21 below this share of the largest count as zero.
RANK = 1e-13
LARGEST = 1e150  # direct term whose square, over many channels, does not overflow


class RiccatiPair(NamedTuple):
    """Solutions X, Y >= 0 at gamma, and ``coupling = rho(X Y) / gamma^2``; the test is passed if it is below 1."""

    gamma: float
    X: AnyArray
    Y: AnyArray
    coupling: float


class TwoRiccatiProblem:
    """A regular plant in the coordinates ``D12 = [0; I]``, ``D21 = [0 I]``, and the gamma test on it."""

    def __init__(self, plant: PlantMatrices, careful: bool, budget: Budget) -> None:
        _, n_w, n_u, n_z, n_y = plant.sizes
        if n_z < n_u or n_w < n_y:
            raise NoTrustworthyNumber("H-infinity Riccati test", "D12 or D21 cannot have full rank")
        U, s12, Vt = np.linalg.svd(plant.D12)
        W, s21, Rt = np.linalg.svd(plant.D21)
        if min(s12.min(), s21.min()) <= RANK * max(1.0, s12.max(), s21.max()):
            raise NoTrustworthyNumber("H-infinity Riccati test", "D12 or D21 is rank deficient")
        self.careful, self.budget = careful, budget  # careful: a second Riccati solver where the first fails
        self.u_back = Vt.T / s12  # u = u_back @ u_normalised
        self.y_into = W.T / s21[:, None]  # y_normalised = y_into @ y
        z_turn = np.hstack([U[:, n_u:], U[:, :n_u]]).T
        w_turn = np.vstack([Rt[n_y:], Rt[:n_y]]).T
        self.a, self.b = n_z - n_u, n_w - n_y
        D11 = z_turn @ plant.D11 @ w_turn
        if not np.abs(D11).max(initial=0.0) < LARGEST:
            raise NoTrustworthyNumber("H-infinity Riccati test", "the square of D11 overflows")
        self.plant = PlantMatrices(
            plant.A, plant.B1 @ w_turn, plant.B2 @ self.u_back, z_turn @ plant.C1, self.y_into @ plant.C2, D11,
            np.eye(n_z, n_u, -self.a), np.eye(n_y, n_w, self.b),
        )  # fmt: skip
        self.equations = quadratic(self.plant), quadratic(dual(self.plant))
        parts = (D11[: self.a], D11[:, : self.b])  # [D1111 D1112] and [D1111; D1121]: no gamma below them
        self.floor = max((float(np.linalg.norm(part, 2)) if part.size else 0.0) for part in parts)

    def solve(self, gamma: float) -> RiccatiPair | None:
        """Return the pair at this gamma; None if the test fails (gamma too small, or lost to rounding)."""
        pair = self.pair(gamma)
        return pair if pair is not None and pair.coupling < 1 else None

    def pair(self, gamma: float) -> RiccatiPair | None:
        """Return both solutions for any coupling; None if one does not exist or is not positive semidefinite."""
        self.budget.spend(dense(len(self.plant.A), 3))
        control, filtering = self.equations
        X = None if gamma <= self.floor * (1 + 1e-12) else _solution(control, gamma, self.careful)
        Y = None if X is None else _solution(filtering, gamma, self.careful)
        if X is None or Y is None:
            return None
        return RiccatiPair(gamma, X, Y, float(np.abs(np.linalg.eigvals(X @ Y)).max(initial=0.0)) / gamma**2)

    def smallest_gamma(self, start: float, rtol: float, probes: tuple[float, ...]) -> float | None:
        """Return the smallest gamma that passes the test; None if none up to LARGEST_GAMMA does."""
        high, low = max(start, self.floor * 1.01 + 1e-12), self.floor
        while (at_high := self.solve(high)) is None:
            low, high = high, 4 * high
            if high > LARGEST_GAMMA or self.budget.over:
                return None
        while True:
            high = self._closed(low, at_high, rtol)
            if high < SMALLEST_GAMMA:
                return high
            for share in probes:
                if self.budget.over:
                    return high
                at_high = self.solve(high * share)
                if at_high is not None:
                    high, low = high * share, self.floor
                    break
            else:
                return high

    def _closed(self, low: float, at_high: RiccatiPair, rtol: float) -> float:
        """Return the upper end of a bracket of relative width ``rtol``, from a passing pair and a gamma below it."""
        at_low: RiccatiPair | None = None
        step = 0.03
        while not self.budget.over:
            high = at_high.gamma
            # rho(X Y) falls with gamma: below this one the coupling is 1 or more.
            low = max(low, high * float(np.sqrt(at_high.coupling)) * (1 - 1e-9), 1e-3 * high)
            if high - low <= rtol * high or high < SMALLEST_GAMMA:
                return high
            if at_low is not None and at_high.coupling > 0:
                slope = float(np.log(at_low.coupling / at_high.coupling))
                share = -float(np.log(at_high.coupling)) / slope if slope > 0 else 0.5
                # Aim half a tolerance to the passing side, so that the bracket closes from both ends.
                trial = high * (at_low.gamma / high) ** share * (1 + 0.4 * rtol)
                if at_low.coupling < 1 + rtol:
                    trial = max(trial, low * (1 + 0.9 * rtol))
                trial = min(max(trial, low * (low / high) ** -0.02), high * (low / high) ** 0.02)
            elif low < high * (1 - 3 * step):  # no lower end is known near: growing steps down
                trial, step = high * (1 - step), min(3 * step, 0.9)
            else:
                trial = float(np.sqrt(low * high))
            found = self.pair(trial)
            if found is not None and found.coupling < 1:
                at_high = found
            else:
                low, at_low = trial, found
                step = np.inf  # the bracket has a lower end: bisect from now on
        return at_high.gamma

    def central_controller(self, pair: RiccatiPair) -> Realisation:
        """Return the central controller of a pair, (19) to (27) without the free parameter, for the plant as given."""
        a, b, p, g2 = self.a, self.b, self.plant, pair.gamma**2
        n_w, n_z = p.B1.shape[1], len(p.C1)
        D1111, D1112, D1121, D1122 = p.D11[:a, :b], p.D11[:a, b:], p.D11[a:, :b], p.D11[a:, b:]
        try:
            control, filtering = self.equations
            F, L = _gain(control, pair.gamma, pair.X), _gain(filtering, pair.gamma, pair.Y).T
            F12, F2, L12, L2 = F[b:n_w], F[n_w:], L[:, a:n_z], L[:, n_z:]
            left = np.linalg.solve(g2 * np.eye(a) - D1111 @ D1111.T, D1112)
            right = np.linalg.solve(g2 * np.eye(b) - D1111.T @ D1111, D1121.T)
            D11 = -D1121 @ D1111.T @ left - D1122  # (19)
            D12 = np.linalg.cholesky(np.eye(n_z - a) - D1121 @ right)  # (20)
            D21 = np.linalg.cholesky(np.eye(n_w - b) - D1112.T @ left).T  # (21)
            Z = np.eye(len(p.A)) - pair.Y @ pair.X / g2  # the inverse of (27)
            B2 = np.linalg.solve(Z, (p.B2 + L12) @ D12)  # (22)
            C2 = -D21 @ (p.C2 + F12)  # (23)
            B1 = -np.linalg.solve(Z, L2) + B2 @ np.linalg.solve(D12, D11)  # (24)
            to_state = np.linalg.solve(D21, C2)
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("central controller", "gamma is too close to its limit") from None
        C1 = F2 + D11 @ to_state  # (25)
        A = p.A + np.hstack([p.B1, p.B2]) @ F + B1 @ to_state  # (26)
        found = Realisation(A, B1 @ self.y_into, self.u_back @ C1, self.u_back @ D11 @ self.y_into)
        if not all(np.isfinite(part).all() for part in found):
            raise NoTrustworthyNumber("central controller", "the controller is not finite")
        return found


class Quadratic(NamedTuple):
    """The state-feedback equation ``A' X + X A + Q - (X B + S) R^-1 (B' X + S') = 0`` of a plant."""

    A: AnyArray
    B: AnyArray
    Q: AnyArray
    S: AnyArray
    direct: AnyArray  # R at gamma = 0
    n_w: int

    def R(self, gamma: float) -> AnyArray:
        """Return ``[D11 D12]' [D11 D12] - gamma^2 diag(I, 0)``."""
        R = self.direct.copy()
        R[range(self.n_w), range(self.n_w)] -= gamma**2
        return R


def quadratic(p: PlantMatrices) -> Quadratic:
    """Return the equation of a plant."""
    row = np.hstack([p.D11, p.D12])
    R = row.T @ row
    return Quadratic(p.A, np.hstack([p.B1, p.B2]), p.C1.T @ p.C1, p.C1.T @ row, 0.5 * (R + R.T), p.B1.shape[1])


def _solution(equation: Quadratic, gamma: float, careful: bool) -> AnyArray | None:
    """Return the stabilising positive semidefinite X, or None."""
    (A, B, Q, S, _, _), R, n = equation, equation.R(gamma), len(equation.A)
    try:
        solved = np.linalg.solve(R, np.vstack([B, S]).T)
    except np.linalg.LinAlgError:
        return None
    by_B, by_S = solved[:, :n], solved[:, n:]
    G, Q_left = B @ by_B, Q - S @ by_S
    X = hamiltonian_riccati(A - B @ by_S, 0.5 * (G + G.T), 0.5 * (Q_left + Q_left.T), tolerance=RESIDUAL)
    if X is None and careful:
        with suppress(NoTrustworthyNumber):
            X = care(A, B, Q, R, S, tolerance=RESIDUAL).X
    if X is None:
        return None
    values, vectors = np.linalg.eigh(X)
    if n and values[0] < -SEMIDEFINITE * max(1.0, values[-1]):
        return None
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _gain(equation: Quadratic, gamma: float, X: AnyArray) -> AnyArray:
    """Return ``-R^-1 (B' X + S')``: F of (11), and of the dual plant the transposed L of (12)."""
    return -np.linalg.solve(equation.R(gamma), equation.B.T @ X + equation.S.T)
