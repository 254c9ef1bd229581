r"""H2 and H-infinity conditions on one controller with a common Lyapunov matrix, as linear matrix inequalities.

The change of variables of Scherer, Gahinet, Chilali (1997) makes them affine in X, Y and the transformed controller:

.. math:: \mathcal P = \begin{bmatrix} X & I \\ I & Y \end{bmatrix}, \quad
   \mathcal A = \begin{bmatrix} A X + B_2 \hat C & A + B_2 \hat D C_2 \\ \hat A & Y A + \hat B C_2 \end{bmatrix}

(their eqs 27 to 38). One Lyapunov matrix for both channels is a restriction: what is found is a feasible controller,
not the best one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel

__all__ = ["Channel", "CommonLyapunov"]

Array = NDArray[Any]

ACCEPTED = ("optimal", "optimal_inaccurate", "user_limit")


@dataclass(frozen=True, eq=False)
class Channel:
    """One performance channel: columns of w and rows of z in the plant's matrices."""

    B1: Array
    C1: Array
    D11: Array
    D12: Array
    D21: Array


class CommonLyapunov:
    """The problem "least H2 norm of one channel with the H-infinity norm of another below a level".

    Parameters
    ----------
    A, B2, C2
        The plant without its performance channels, D22 = 0.
    h2, hinf
        The two channels.
    gain
        A direct term of K with ``D11 + D12 gain D21 = 0`` in the H2 channel (continuous time).
    discrete
        Time domain.
    """

    def __init__(
        self, A: Array, B2: Array, C2: Array, h2: Channel, hinf: Channel, gain: Array, *, discrete: bool
    ) -> None:
        import cvxpy as cp

        n, n_u, n_y = A.shape[0], B2.shape[1], C2.shape[0]
        self.A, self.B2, self.C2 = A, B2, C2
        self.X, self.Y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
        self.Ah, self.Bh, self.Ch = cp.Variable((n, n)), cp.Variable((n, n_y)), cp.Variable((n_u, n))
        self.Dh: Any = cp.Variable((n_u, n_y))
        if not discrete:  # the direct term moves only where the H2 channel does not see it
            self.Dh = cp.Constant(gain)
            unseen, unfed = _null_space(h2.D12), _null_space(h2.D21.T)
            if unseen.shape[1]:
                self.Dh = self.Dh + unseen @ cp.Variable((unseen.shape[1], n_y))
            if unfed.shape[1]:
                self.Dh = self.Dh + cp.Variable((n_u, unfed.shape[1])) @ unfed.T
        self.w_share, self.z_share = cp.Parameter(nonneg=True), cp.Parameter(nonneg=True)
        Q = cp.Variable((h2.C1.shape[0], h2.C1.shape[0]), symmetric=True)
        P = cp.bmat([[self.X, np.eye(n)], [np.eye(n), self.Y]])
        constraints = self._h2(P, h2, Q, discrete) + self._hinf(P, hinf, discrete)
        # A little weight on the size of X and Y keeps K finite where the infimum is not attained.
        objective = cp.trace(Q) + 1e-7 * (cp.trace(self.X) + cp.trace(self.Y))
        self.problem = cp.Problem(cp.Minimize(objective), constraints)

    def _closed(self, c: Channel) -> tuple[Any, Any, Any, Any]:
        import cvxpy as cp

        A, B2, C2, X, Y = self.A, self.B2, self.C2, self.X, self.Y
        a = cp.bmat([[A @ X + B2 @ self.Ch, A + B2 @ self.Dh @ C2], [self.Ah, Y @ A + self.Bh @ C2]])
        b = cp.vstack([c.B1 + B2 @ self.Dh @ c.D21, Y @ c.B1 + self.Bh @ c.D21])
        out = cp.hstack([c.C1 @ X + c.D12 @ self.Ch, c.C1 + c.D12 @ self.Dh @ C2])
        return a, b, out, c.D11 + c.D12 @ self.Dh @ c.D21

    def _h2(self, P: Any, channel: Channel, Q: Any, discrete: bool) -> list[Any]:
        import cvxpy as cp

        a, b, c, d = self._closed(channel)
        n_w, n_2 = b.shape[1], P.shape[0]
        one = np.eye(n_w)
        if not discrete:
            return [_negative(cp.bmat([[a + a.T, b], [b.T, -one]])), _positive(cp.bmat([[P, c.T], [c, Q]]))]
        none = np.zeros((n_2, n_w))
        return [
            _positive(cp.bmat([[P, a, b], [a.T, P, none], [b.T, none.T, one]])),
            _positive(cp.bmat([[Q, c, d], [c.T, P, none], [d.T, none.T, one]])),
        ]

    def _hinf(self, P: Any, channel: Channel, discrete: bool) -> list[Any]:
        import cvxpy as cp

        a, b, c, d = self._closed(channel)
        n_w, n_z, n_2 = b.shape[1], c.shape[0], P.shape[0]
        w, z = self.w_share * np.eye(n_w), self.z_share * np.eye(n_z)
        if not discrete:
            return [_negative(cp.bmat([[a + a.T, b, c.T], [b.T, -w, d.T], [c, d, -z]]))]
        x_w, x_z = np.zeros((n_2, n_w)), np.zeros((n_2, n_z))
        return [_positive(cp.bmat([[P, a, b, x_z], [a.T, P, x_w, c.T], [b.T, x_w.T, w, d.T], [x_z.T, c, d, z]]))]

    def controller(self, level: float, share: float, seconds: float) -> StateSpaceModel | None:
        """K at this level of the H-infinity channel, or None where the solver has none; to be verified by the caller.

        ``share`` splits the square of the level between w and z, as ``share * (level^2 / share)``: for one channel
        alone that is a scaling of its Lyapunov matrix, but with a common one it is a choice. 1 fits channels that
        share w.
        Whatever the solver says about its accuracy, only the loop rebuilt from K counts.
        """
        import warnings

        import cvxpy as cp

        self.w_share.value, self.z_share.value = share, level**2 / share
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # inaccurate solutions: the rebuilt loop is the judge
                self.problem.solve(solver=cp.CLARABEL, time_limit=max(seconds, 1e-3))
        except (cp.SolverError, ValueError, ArithmeticError):
            return None
        except BaseException as error:
            # Clarabel's own panics derive from BaseException, past every except clause for errors.
            if type(error).__name__ != "PanicException":
                raise
            return None
        if self.problem.status not in ACCEPTED or self.X.value is None:
            return None
        try:
            return self._rebuilt()
        except (np.linalg.LinAlgError, NoTrustworthyNumber):
            return None

    def _rebuilt(self) -> StateSpaceModel:
        """Undo the change of variables (their eq. 35), with ``M N^T = I - X Y`` split evenly."""
        X, Y, Ah, Bh, Ch, Dh = (np.asarray(v.value) for v in (self.X, self.Y, self.Ah, self.Bh, self.Ch, self.Dh))
        if not all(np.isfinite(part).all() for part in (X, Y, Ah, Bh, Ch, Dh)):
            raise NoTrustworthyNumber("common Lyapunov matrix", "the solution is not finite")
        U, s, Vt = np.linalg.svd(np.eye(len(X)) - X @ Y)
        M, N = U * np.sqrt(s), Vt.T * np.sqrt(s)
        C = np.linalg.solve(M, (Ch - Dh @ self.C2 @ X).T).T
        B = np.linalg.solve(N, Bh - Y @ self.B2 @ Dh)
        inner = Ah - N @ B @ self.C2 @ X - Y @ self.B2 @ C @ M.T - Y @ (self.A + self.B2 @ Dh @ self.C2) @ X
        A = np.linalg.solve(M, np.linalg.solve(N, inner).T).T
        return StateSpaceModel(A, B, C, Dh, where="common Lyapunov matrix")


def _null_space(matrix: Array) -> Array:
    _, s, Vt = np.linalg.svd(matrix)
    rank = int((s > 1e-12 * max(float(s.max(initial=0.0)), 1.0)).sum())
    return Vt[rank:].T


def _positive(matrix: Any) -> Any:
    return 0.5 * (matrix + matrix.T) >> 0


def _negative(matrix: Any) -> Any:
    return 0.5 * (matrix + matrix.T) << 0
