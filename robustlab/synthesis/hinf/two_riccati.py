"""The two Riccati equations of H-infinity synthesis with a general D11, for one gamma.

Numbers in parentheses are equations of Glover, Doyle, Systems & Control Letters 11 (1988). The controller's states are
those of Zhou, Doyle, Glover (1996), theorem 17.1: Z of (27) goes into B instead of C.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import hamiltonian_riccati
from robustlab.synthesis.problem.generalized_plant import PlantMatrices, Realisation, dual

# Rounding of an exact X = 0, scaled, which must not count as indefinite. Larger: false passes.
SEMIDEFINITE = 1e-6
RESIDUAL = 1e-3  # largest residual of a Riccati solution; the loop is verified afterwards
SMALLEST_GAMMA = 1e-9  # a gamma below it, scaled, is not made smaller
MAX_TESTS, SECANTS = 40, 15  # tests for one level, and those of them after which the bracket is only bisected
SLOPE = -4.0  # first guess of the derivative of log rho(X Y) by log beta
# Share of the smallest gamma found that is tested again: the test in floating point is not monotone in gamma.
PROBE = 0.93
RANK = 1e-13  # singular values of D12 or D21 below this share of the largest count as zero
LARGEST = 1e150  # direct term whose square, over many channels, does not overflow


class RiccatiPair(NamedTuple):
    """Solutions X, Y >= 0 at gamma, and ``coupling = rho(X Y) / gamma^2``; the test is passed if it is below 1."""

    gamma: float
    X: AnyArray
    Y: AnyArray
    coupling: float


class TwoRiccatiProblem:
    """A regular plant in the coordinates ``D12 = [0; I]``, ``D21 = [0 I]``, and the gamma test on it."""

    def __init__(self, plant: PlantMatrices, budget: Budget) -> None:
        _, n_w, n_u, n_z, n_y = plant.sizes
        U, s12, Vt = np.linalg.svd(plant.D12)
        W, s21, Rt = np.linalg.svd(plant.D21)
        if n_z < n_u or n_w < n_y or min(s12.min(), s21.min()) <= RANK * max(1.0, s12.max(), s21.max()):
            raise NoTrustworthyNumber("H-infinity Riccati test", "D12 or D21 is rank deficient")
        self.budget = budget
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
        X = None if gamma <= self.floor * (1 + 1e-12) else _solution(control, gamma)
        Y = None if X is None else _solution(filtering, gamma)
        if X is None or Y is None:
            return None
        return RiccatiPair(gamma, X, Y, float(np.abs(np.linalg.eigvals(X @ Y)).max(initial=0.0)) / gamma**2)

    def smallest_gamma(self, start: float, rtol: float) -> float | None:
        """Return the smallest gamma that passes the test; None where none was found."""

        def coupling(gamma: float) -> float | None:
            pair = self.pair(gamma)
            return None if pair is None else pair.coupling

        high = max(start, self.floor * 1.01 + 1e-12)
        while (found := smallest_level(coupling, high, rtol, self.budget, 0.03)) is not None:
            high = found[0]
            if high < SMALLEST_GAMMA or self.budget.over or self.solve(high * PROBE) is None:
                return high
            high *= PROBE
        return None

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


def smallest_level(
    coupling: Callable[[float], float | None], start: float, rtol: float, budget: Budget, step: float
) -> tuple[float, bool, bool] | None:
    """Return the smallest level that passes, near ``start``; None where none does within e^80 of it.

    ``coupling`` gives rho(X Y) over the square of a level, below 1 where it passes, or None without solutions. Also
    returned: whether the coupling is 1 there, and whether a level below was seen to fail.
    """
    # Secants of f = log coupling over t = log level in a bracket: above the level f < 0.
    t = float(np.log(max(start, 1e-300)))
    low, high, smooth, slope = -np.inf, np.inf, False, SLOPE
    last: tuple[float, float] | None = None
    for k in range(MAX_TESTS):
        rho = coupling(float(np.exp(t)))
        f = np.nan if rho is None else float(np.log(max(rho, 1e-300)))
        if last is not None and abs(t - last[0]) > 3 * rtol and (f - last[1]) * (t - last[0]) < 0:
            slope = (f - last[1]) / (t - last[0])
        last = (t, f) if rho is not None else last
        if f < 0:
            high = t
            if slope != SLOPE and f / slope <= rtol:
                low, smooth = t, True
        else:
            low, smooth = t, rho is not None
        if high - low <= rtol or step > 60 or budget.over:
            break
        bracketed, aim = high - low < np.inf, t - f / slope + 0.3 * rtol if k < SECANTS else np.nan
        if low < aim < high and (bracketed or abs(aim - t) < 1):
            t = aim
        elif bracketed:
            t = 0.5 * (low + high)
        else:
            t, step = t + (step if high == np.inf else -step), 4 * step
    return None if high == np.inf else (float(np.exp(high)), smooth, low > -np.inf)


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
    row = np.hstack([p.D11, p.D12])
    R = row.T @ row
    return Quadratic(p.A, np.hstack([p.B1, p.B2]), p.C1.T @ p.C1, p.C1.T @ row, 0.5 * (R + R.T), p.B1.shape[1])


def _solution(equation: Quadratic, gamma: float) -> AnyArray | None:
    """Return the stabilising positive semidefinite X, or None."""
    (A, B, Q, S, _, _), R, n = equation, equation.R(gamma), len(equation.A)
    try:
        solved = np.linalg.solve(R, np.vstack([B, S]).T)
    except np.linalg.LinAlgError:
        return None
    by_B, by_S = solved[:, :n], solved[:, n:]
    G, Q_left = B @ by_B, Q - S @ by_S
    X = hamiltonian_riccati(A - B @ by_S, 0.5 * (G + G.T), 0.5 * (Q_left + Q_left.T), tolerance=RESIDUAL)
    if X is None:
        return None
    values, vectors = np.linalg.eigh(X)
    if n and values[0] < -SEMIDEFINITE * max(1.0, values[-1]):
        return None
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _gain(equation: Quadratic, gamma: float, X: AnyArray) -> AnyArray:
    """Return ``-R^-1 (B' X + S')``: F of (11), and of the dual plant the transposed L of (12)."""
    return -np.linalg.solve(equation.R(gamma), equation.B.T @ X + equation.S.T)
