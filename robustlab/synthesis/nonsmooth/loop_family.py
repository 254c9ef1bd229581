r"""Closed loops of one plant with every controller of a packed form, and derivatives with respect to the controller.

A controller of n_K states is packed as :math:`\Theta = [A_K, B_K; C_K, D_K]`; with the plant extended by n_K
integrators the loop is affine in it,

.. math::
    \dot x = (A + B \Theta C) x + (B_1 + B \Theta D_{21}) w, \qquad z = (C_1 + D_{12} \Theta C) x + (D_{11} + D_{12}
    \Theta D_{21}) w,

and a direct term D22 of the plant is first taken into :math:`\Theta (I - D_{22} \Theta)^{-1}`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.matrix_equations import lapack
from robustlab.synthesis.nonsmooth.objectives import (
    LoopMatrices,
    PeakFinder,
    bilinear,
    bilinear_pullback,
    entropy,
    resolvent_point,
)
from robustlab.synthesis.problem.partition import PlantMatrices

__all__ = ["LoopFamily", "Pole", "packed"]


# An I - D22 Theta with a larger condition number is no loop to look at.
ILL_POSED = 1e10
# Poles whose distance is below this share of the largest one get their derivatives from a perturbed A.
DEFECTIVE = 1e-14
# Poles closer to the boundary than this share of the norm of A cannot be told from it.
BLUR = 1e-13


def packed(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray) -> AnyArray:
    """``[A, B; C, D]``."""
    return np.vstack([np.hstack([A, B]), np.hstack([C, D])])


@dataclass(frozen=True)
class Pole:
    """A pole of the loop with ``G``: a change dTheta moves it by the sum of ``G * dTheta`` (complex)."""

    value: complex
    G: AnyArray


class LoopFamily:
    """The closed loops ``F_l(P, K)`` of one plant for all controllers K of ``order`` states.

    Parameters
    ----------
    plant
        Matrices of the plant without D22.
    D22
        Its direct term from u to y.
    order
        States of the controller.
    discrete
        True for a sampled plant.
    """

    def __init__(self, plant: PlantMatrices, D22: AnyArray, order: int, discrete: bool) -> None:
        n, n_w, n_u, n_z, n_y = plant.sizes
        k = order
        zeros = np.zeros
        self.discrete, self.order, self.n_plant = discrete, order, n
        self.A = np.block([[plant.A, zeros((n, k))], [zeros((k, n + k))]])
        self.B1, self.C1, self.D11 = (
            np.vstack([plant.B1, zeros((k, n_w))]),
            np.hstack([plant.C1, zeros((n_z, k))]),
            plant.D11,
        )
        self.B = np.block([[zeros((n, k)), plant.B2], [np.eye(k), zeros((k, n_u))]])
        self.C = np.block([[zeros((k, n)), np.eye(k)], [plant.C2, zeros((n_y, k))]])
        self.D12 = np.hstack([zeros((n_z, k)), plant.D12])
        self.D21 = np.vstack([zeros((k, n_w)), plant.D21])
        self.D22 = None
        if D22.any():
            self.D22 = zeros((k + n_y, k + n_u))
            self.D22[k:, k:] = D22
        self._finder = PeakFinder()

    # --- the loop ----------------------------------------------------------------------------------------------------

    def without_direct_term(self, theta: AnyArray) -> tuple[AnyArray, AnyArray | None, AnyArray | None] | None:
        """``(Theta (I - D22 Theta)^-1, L, R)``, its change ``L dTheta R``; None where the loop is not well posed."""
        if self.D22 is None:
            return theta, None, None
        right = np.eye(self.D22.shape[0]) - self.D22 @ theta
        if not np.isfinite(right).all() or np.linalg.cond(right) > ILL_POSED:
            return None
        right = np.linalg.inv(right)
        left = np.eye(theta.shape[0]) + theta @ right @ self.D22
        return theta @ right, left, right

    def loop(self, theta: AnyArray) -> LoopMatrices | None:
        """The loop's matrices; None where it is not well posed."""
        effective = self.without_direct_term(theta)
        return None if effective is None else self._loop(effective[0])

    def _loop(self, theta: AnyArray) -> LoopMatrices:
        tc, td = theta @ self.C, theta @ self.D21
        return LoopMatrices(
            self.A + self.B @ tc, self.B1 + self.B @ td, self.C1 + self.D12 @ tc, self.D11 + self.D12 @ td
        )

    # --- poles -------------------------------------------------------------------------------------------------------

    def poles(self, theta: AnyArray) -> AnyArray | None:
        """Poles of the loop; None where it is not well posed or not finite."""
        loop = self.loop(theta)
        if loop is None or not np.isfinite(loop.A).all():
            return None
        return np.linalg.eigvals(loop.A) if len(loop.A) else np.zeros(0, complex)

    def pole(self, theta: AnyArray, measure: Any) -> Pole | None:
        """The pole with the largest ``measure(poles)`` and its derivative; None where there is none."""
        from scipy.linalg import eig

        effective = self.without_direct_term(theta)
        if effective is None or not len(self.A):
            return None
        A = self._loop(effective[0]).A
        if not np.isfinite(A).all():
            return None
        values, left, right = (np.asarray(x) for x in eig(A, left=True, check_finite=False))
        k = int(np.argmax(measure(values)))
        u, v = left[:, k], right[:, k]
        product = np.vdot(u, v)
        if abs(product) < DEFECTIVE:
            product = DEFECTIVE
        G = np.outer(u.conj() @ self.B, self.C @ v) / product
        return Pole(complex(values[k]), self._chained(G, effective[1], effective[2]))

    def abscissa(self, theta: AnyArray) -> tuple[float, AnyArray | None]:
        """Spectral abscissa (discrete: largest modulus minus one) and its gradient with respect to Theta."""
        if not len(self.A):
            return -np.inf, np.zeros_like(theta)
        found = self.pole(theta, np.abs if self.discrete else np.real)
        if found is None:
            return np.inf, None
        if not self.discrete:
            return found.value.real, np.real(found.G)
        size = abs(found.value)
        return size - 1.0, np.real(found.G * np.conj(found.value) / max(size, 1e-300))

    # --- norms -------------------------------------------------------------------------------------------------------

    def norm(self, theta: AnyArray, give_up_above: float = np.inf) -> tuple[float, AnyArray | None]:
        """H-infinity norm and its gradient; ``(inf, None)`` for a loop that is not stable.

        Above ``give_up_above`` the value may be a lower bound and the gradient is None.
        """
        effective = self.without_direct_term(theta)
        loop = None if effective is None else self._loop(effective[0])
        continuous = bilinear(loop) if loop is not None and self.discrete else loop
        if effective is None or loop is None or continuous is None:
            return np.inf, None
        value, omega = self._finder.largest(continuous, give_up_above)
        if value >= give_up_above or not np.isfinite(value):
            return value, None
        found = self._gradients(loop, effective, omega, 0.0)
        if found is None or not np.isfinite(found[0][0]):
            return np.inf, None
        return max(value, found[0][0]), found[0][1]

    def active(self, theta: AnyArray, value: float, share: float, band: float) -> list[tuple[float, AnyArray]]:
        """Singular values near the norm ``value``, each with its gradient: all peaks above ``(1 - share) value``."""
        effective = self.without_direct_term(theta)
        loop = None if effective is None else self._loop(effective[0])
        continuous = bilinear(loop) if loop is not None and self.discrete else loop
        if effective is None or loop is None or continuous is None:
            return []
        omegas = np.array(self._finder.peaks(continuous, value, share, band), dtype=float)
        dynamic = np.isfinite(omegas) | self.discrete if len(loop.A) else np.zeros(len(omegas), dtype=bool)
        found = self._stacked_gradients(loop, effective, omegas[dynamic], (1 - share) * value)
        if not dynamic.all():
            found += self._gradients(loop, effective, np.inf, (1 - share) * value) or []
        return found

    def _stacked_gradients(
        self,
        loop: LoopMatrices,
        effective: tuple[AnyArray, AnyArray | None, AnyArray | None],
        omegas: AnyArray,
        least: float,
    ) -> list[tuple[float, AnyArray]]:
        """What `_gradients` gives, for many frequencies at once."""
        if not len(omegas):
            return []
        a, b, c, d = loop
        m = b.shape[1]
        points = np.array([resolvent_point(omega, self.discrete) for omega in omegas])
        try:
            x = np.linalg.solve(points[:, None, None] * np.eye(len(a)) - a, np.hstack([b, self.B])[None] + 0j)
        except np.linalg.LinAlgError:
            return []
        gain = c @ x[:, :, :m] + d
        if not np.isfinite(gain).all():
            return []
        left, s, right = np.linalg.svd(gain, full_matrices=False)
        rows, columns = self.D12 + c @ x[:, :, m:], self.D21 + self.C @ x[:, :, :m]
        found: list[tuple[float, AnyArray]] = []
        for i, k in np.argwhere((s > least) & (s > 0.5 * s[:, :1])):
            row, column = left[i, :, k].conj() @ rows[i], columns[i] @ right[i, k].conj()
            found.append((float(s[i, k]), np.real(self._chained(np.outer(row, column), effective[1], effective[2]))))
        return found

    def _gradients(
        self,
        loop: LoopMatrices,
        effective: tuple[AnyArray, AnyArray | None, AnyArray | None],
        omega: float,
        least: float,
    ) -> list[tuple[float, AnyArray]] | None:
        """Singular values at one frequency above ``least`` (at least the largest one) with their gradients."""
        a, b, c, d = loop
        direct = not np.isfinite(omega) and not self.discrete
        if direct or not len(a):
            left, s, right = np.linalg.svd(d, full_matrices=False)
            lu = piv = None
        else:
            lu, piv, info = lapack().zgetrf(resolvent_point(omega, self.discrete) * np.eye(len(a)) - a)
            gain = c @ lapack().zgetrs(lu, piv, b)[0] + d
            if info or not np.isfinite(gain).all():
                return None
            left, s, right = np.linalg.svd(gain, full_matrices=False)
        found: list[tuple[float, AnyArray]] = []
        for k in range(len(s)):
            if k and s[k] <= max(least, 0.5 * s[0]):
                break
            u, v = left[:, k], right[k].conj()
            row, column = u.conj() @ self.D12, self.D21 @ v
            if lu is not None:
                row = row + lapack().zgetrs(lu, piv, c.T @ u, trans=2)[0].conj() @ self.B
                column = column + self.C @ lapack().zgetrs(lu, piv, b @ v)[0]
            found.append((float(s[k]), np.real(self._chained(np.outer(row, column), effective[1], effective[2]))))
            if least == 0.0:
                break
        return found

    def h2_norm(self, theta: AnyArray) -> tuple[float, AnyArray | None]:
        r"""H2 norm and its gradient; ``(inf, None)`` for a loop that is not stable.

        With the Gramians P and Q, :math:`d\,\|T\|_2^2 = 2\,\mathrm{tr}[Q (dA\,P + dB\,B^T) + dC\,P C^T]`; discrete,
        :math:`2\,\mathrm{tr}[Q (dA\,P A^T + dB\,B^T) + dC\,P C^T + dD\,D^T]`. The direct term of a
        continuous loop is left out: it must be zero.
        """
        from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

        effective = self.without_direct_term(theta)
        if effective is None:
            return np.inf, None
        a, b, c, d = self._loop(effective[0])
        if not np.isfinite(a).all():
            return np.inf, None
        values = np.linalg.eigvals(a) if len(a) else np.zeros(0)
        edge = np.abs(values).max(initial=0.0) - 1 if self.discrete else values.real.max(initial=-np.inf)
        if edge >= -BLUR * (1.0 if self.discrete else np.abs(a).max(initial=0.0)):
            return np.inf, None
        if not self.discrete:
            P, Q = solve_continuous_lyapunov(a, -b @ b.T), solve_continuous_lyapunov(a.T, -c.T @ c)
            square = float(np.trace(c @ P @ c.T))
            G = self.B.T @ Q @ (P @ self.C.T + b @ self.D21.T) + self.D12.T @ c @ P @ self.C.T
        else:
            P, Q = solve_discrete_lyapunov(a, b @ b.T), solve_discrete_lyapunov(a.T, c.T @ c)
            square = float(np.trace(c @ P @ c.T) + (d**2).sum())
            G = self.B.T @ Q @ (a @ P @ self.C.T + b @ self.D21.T)
            G = G + self.D12.T @ (c @ P @ self.C.T + d @ self.D21.T)
        if not np.isfinite(square) or square < 0:
            return np.inf, None
        norm = np.sqrt(square)
        return norm, self._chained(G / max(norm, 1e-300), effective[1], effective[2])

    def entropy(self, theta: AnyArray, gamma: float) -> tuple[float, AnyArray, float] | None:
        """Entropy at this level with its gradients with respect to Theta and to gamma; None at or below the norm."""
        effective = self.without_direct_term(theta)
        loop = None if effective is None else self._loop(effective[0])
        if effective is None or loop is None or not all(np.isfinite(part).all() for part in loop):
            return None
        continuous = bilinear(loop) if self.discrete else loop
        found = None if continuous is None else entropy(continuous, gamma)
        if found is None:
            return None
        by_loop = LoopMatrices(found.A, found.B, found.C, found.D)
        if self.discrete:
            by_loop = bilinear_pullback(loop, by_loop)
        a, b, c, d = by_loop
        G = self.B.T @ (a @ self.C.T + b @ self.D21.T) + self.D12.T @ (c @ self.C.T + d @ self.D21.T)
        return found.value, self._chained(G, effective[1], effective[2]), found.by_gamma

    @staticmethod
    def _chained(G: AnyArray, left: AnyArray | None, right: AnyArray | None) -> AnyArray:
        return G if left is None or right is None else left.T @ G @ right.T
