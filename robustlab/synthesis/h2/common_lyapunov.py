r"""H2 and H-infinity conditions on one controller with a common Lyapunov matrix, as linear matrix inequalities.

The change of variables of Scherer, Gahinet, Chilali (1997) makes them affine in X, Y and the transformed controller:

.. math:: \mathcal P = \begin{bmatrix} X & I \\ I & Y \end{bmatrix}, \quad
   \mathcal A = \begin{bmatrix} A X + B_2 \hat C & A + B_2 \hat D C_2 \\ \hat A & Y A + \hat B C_2 \end{bmatrix}

(their eqs 27 to 38). One Lyapunov matrix for both channels is a restriction: what is found is a feasible controller,
not the best one. The inequalities go to Clarabel directly: their coefficients are taken once, by evaluating them at the
unit vectors of the unknowns, and another level changes a few constants only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.conic import triangle
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.h2.tuning import TUNING, H2Tuning
from robustlab.synthesis.problem.partition import PlantMatrices
from robustlab.synthesis.problem.semidefinite import solve_semidefinite

__all__ = ["CommonLyapunov", "solver_work"]


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """X, Y, the transformed controller, and the bound Q of the H2 channel's output covariance."""

    X: AnyArray
    Y: AnyArray
    A: AnyArray
    B: AnyArray
    C: AnyArray
    D: AnyArray
    Q: AnyArray


def solver_work(n: int, n_h2: int, n_hinf: int) -> tuple[float, float]:
    """Work of setting up, and of one step of the solver, as measured.

    A step cannot be interrupted, so a problem that is too large for the work left must not be begun.

    Parameters
    ----------
    n, n_h2, n_hinf
        States; channels of w and z together in the H2 and in the H-infinity channel.
    """
    unknowns = 2 * n * n + n * (n_h2 + 4)
    rows = 0.5 * ((2 * n + n_h2) ** 2 * 2 + (2 * n + n_hinf) ** 2)
    return 1.2 * unknowns * rows, 2.4e-4 * unknowns**2 * rows


class CommonLyapunov:
    """The problem "least H2 norm of one channel with the H-infinity norm of another below a level".

    Parameters
    ----------
    h2, hinf
        The plant with one of its performance channels each, D22 = 0.
    gain
        A direct term of K with ``D11 + D12 gain D21 = 0`` in the H2 channel (continuous time).
    budget
        Every step of the solver is counted there.
    discrete
        Time domain.
    """

    def __init__(
        self,
        h2: PlantMatrices,
        hinf: PlantMatrices,
        gain: AnyArray,
        budget: Budget,
        *,
        discrete: bool,
        tuning: H2Tuning = TUNING,
    ) -> None:
        self.A, self.B2, self.C2, self.h2, self.hinf = h2.A, h2.B2, h2.C2, h2, hinf
        self.gain, self.budget, self.discrete, self.tuning = gain, budget, discrete, tuning
        setup, self.step_work = solver_work(len(h2.A), _channels(h2), _channels(hinf))
        budget.spend(setup)
        _, _, n_u, _, n_y = h2.sizes
        # In continuous time the direct term moves only where the H2 channel does not see it.
        self.unseen = np.eye(n_u) if discrete else _null_space(h2.D12)
        self.unfed = np.zeros((n_y, 0)) if discrete else _null_space(h2.D21.T)
        self.nothing = np.zeros(self._count())
        base = self._inequalities(self.nothing, 0.0, 0.0)
        self.rows = np.empty((sum(len(m) * (len(m) + 1) // 2 for m in base), self._count()))
        self.cost = np.empty(self._count())
        for k in range(self._count()):
            unit = self.nothing.copy()
            unit[k] = 1.0
            parts = self._inequalities(unit, 0.0, 0.0)
            self.rows[:, k] = np.concatenate([triangle(m - b) for m, b in zip(parts, base, strict=True)])
            self.cost[k] = self._cost(self._unknowns(unit))

    def _count(self) -> int:
        n, _, n_u, q, n_y = self.h2.sizes
        free = self.unseen.shape[1] * n_y + n_u * self.unfed.shape[1]
        return n * (n + 1) + n * n + n * n_y + n_u * n + free + q * (q + 1) // 2

    def _unknowns(self, x: AnyArray) -> _Unknowns:
        n, _, n_u, q, n_y = self.h2.sizes
        sizes = [n * (n + 1) // 2] * 2 + [n * n, n * n_y, n_u * n]
        sizes += [self.unseen.shape[1] * n_y, n_u * self.unfed.shape[1]]
        X, Y, A, B, C, free, other, Q = np.split(x, np.cumsum(sizes))
        D = self.gain + self.unseen @ free.reshape(-1, n_y) + other.reshape(n_u, -1) @ self.unfed.T
        return _Unknowns(
            _symmetric(X, n), _symmetric(Y, n), A.reshape(n, n), B.reshape(n, n_y), C.reshape(n_u, n), D,
            _symmetric(Q, q),
        )  # fmt: skip

    def _closed(self, v: _Unknowns, c: PlantMatrices) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        A, B2, C2 = self.A, self.B2, self.C2
        a = np.block([[A @ v.X + B2 @ v.C, A + B2 @ v.D @ C2], [v.A, v.Y @ A + v.B @ C2]])
        b = np.vstack([c.B1 + B2 @ v.D @ c.D21, v.Y @ c.B1 + v.B @ c.D21])
        out = np.hstack([c.C1 @ v.X + c.D12 @ v.C, c.C1 + c.D12 @ v.D @ C2])
        return a, b, out, c.D11 + c.D12 @ v.D @ c.D21

    def _inequalities(self, x: AnyArray, w_share: float, z_share: float) -> list[AnyArray]:
        """Symmetric matrices that have to be positive semidefinite."""
        v = self._unknowns(x)
        n = len(self.A)
        P = np.block([[v.X, np.eye(n)], [np.eye(n), v.Y]])
        a, b, c, d = self._closed(v, self.h2)
        one, none = np.eye(b.shape[1]), np.zeros((2 * n, b.shape[1]))
        if self.discrete:
            found = [
                np.block([[P, a, b], [a.T, P, none], [b.T, none.T, one]]),
                np.block([[v.Q, c, d], [c.T, P, none], [d.T, none.T, one]]),
            ]
        else:
            found = [-np.block([[a + a.T, b], [b.T, -one]]), np.block([[P, c.T], [c, v.Q]])]
        a, b, c, d = self._closed(v, self.hinf)
        w, z = w_share * np.eye(b.shape[1]), z_share * np.eye(c.shape[0])
        if self.discrete:
            x_w, x_z = np.zeros((2 * n, len(w))), np.zeros((2 * n, len(z)))
            return [*found, np.block([[P, a, b, x_z], [a.T, P, x_w, c.T], [b.T, x_w.T, w, d.T], [x_z.T, c, d, z]])]
        return [*found, -np.block([[a + a.T, b, c.T], [b.T, -w, d.T], [c, d, -z]])]

    def controller(self, level: float, share: float) -> StateSpaceModel | None:
        """K at this level of the H-infinity channel, or None where the solver has none; to be verified by the caller.

        ``share`` splits the square of the level between w and z, as ``share * (level^2 / share)``: for one channel
        alone that is a scaling of its Lyapunov matrix, but with a common one it is a choice. 1 fits channels that
        share w. Whatever the solver says about its accuracy, only the loop rebuilt from K counts.
        """
        constant = self._inequalities(self.nothing, share, level**2 / share)
        right, sizes = np.concatenate([triangle(m) for m in constant]), [len(m) for m in constant]
        x = solve_semidefinite(
            self.cost, -self.rows, right, 0, sizes, self.budget, self.tuning.lyapunov_steps, self.step_work
        ).x
        if x is None:
            return None
        try:
            return self._rebuilt(self._unknowns(x))
        except (np.linalg.LinAlgError, NoTrustworthyNumber, InputError):  # InputError: entries are not finite
            return None

    def _cost(self, v: _Unknowns) -> float:
        return float(np.trace(v.Q) + self.tuning.lyapunov_size * (np.trace(v.X) + np.trace(v.Y)))

    def _rebuilt(self, v: _Unknowns) -> StateSpaceModel:
        """Undo the change of variables (their eq. 35), with ``M N^T = I - X Y`` split evenly."""
        U, s, Vt = np.linalg.svd(np.eye(len(v.X)) - v.X @ v.Y)
        M, N = U * np.sqrt(s), Vt.T * np.sqrt(s)
        C = np.linalg.solve(M, (v.C - v.D @ self.C2 @ v.X).T).T
        B = np.linalg.solve(N, v.B - v.Y @ self.B2 @ v.D)
        inner = v.A - N @ B @ self.C2 @ v.X - v.Y @ self.B2 @ C @ M.T
        inner -= v.Y @ (self.A + self.B2 @ v.D @ self.C2) @ v.X
        A = np.linalg.solve(M, np.linalg.solve(N, inner).T).T
        return StateSpaceModel(A, B, C, v.D, where="common Lyapunov matrix")


def _channels(p: PlantMatrices) -> int:
    """Channels of w and z together."""
    return p.B1.shape[1] + p.C1.shape[0]


def _null_space(matrix: AnyArray) -> AnyArray:
    _, s, Vt = np.linalg.svd(matrix)
    rank = int((s > 1e-12 * max(float(s.max(initial=0.0)), 1.0)).sum())
    return Vt[rank:].T


def _symmetric(entries: AnyArray, n: int) -> AnyArray:
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n)] = entries
    return matrix + np.triu(matrix, 1).T
