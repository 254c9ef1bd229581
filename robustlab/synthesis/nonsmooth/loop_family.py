"""Closed loops of a plant with a packed controller Theta = [A_K, B_K; C_K, D_K], and their derivatives by Theta.

For the plant extended by integrators the loop is affine in Theta, or in Theta (I - D22 Theta)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.synthesis.nonsmooth.objectives import (
    BLUR,
    active_frequencies,
    bilinear,
    bilinear_pullback,
    entropy,
    extreme_pole,
    largest_gain,
    resolvent_point,
)
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation

ILL_POSED = 1e10  # condition number of I - D22 Theta above which a loop counts as ill-posed


@dataclass(frozen=True)
class Pole:
    """A pole of the loop with its complex gradient ``G`` with respect to Theta."""

    value: complex
    G: AnyArray


@dataclass(frozen=True, eq=False)
class _Member:
    """The loop with one controller, in which a change of Theta acts as ``left dTheta right``."""

    loop: Realisation
    left: AnyArray | None
    right: AnyArray | None

    def by_theta(self, G: AnyArray) -> AnyArray:
        """Return the gradient with respect to Theta from that with respect to ``left Theta right``."""
        return G if self.left is None or self.right is None else self.left.T @ G @ self.right.T


class LoopFamily:
    """The closed loops ``F_l(P, K)`` of one plant for all controllers K of ``order`` states."""

    def __init__(self, plant: PlantMatrices, D22: AnyArray, order: int, discrete: bool) -> None:
        n, n_w, n_u, n_z, n_y = plant.sizes
        k, zeros = order, np.zeros
        self.discrete, self.order = discrete, order
        self.A = np.block([[plant.A, zeros((n, k))], [zeros((k, n + k))]])
        self.B1, self.C1 = np.vstack([plant.B1, zeros((k, n_w))]), np.hstack([plant.C1, zeros((n_z, k))])
        self.D11 = plant.D11
        self.B = np.block([[zeros((n, k)), plant.B2], [np.eye(k), zeros((k, n_u))]])
        self.C = np.block([[zeros((k, n)), np.eye(k)], [plant.C2, zeros((n_y, k))]])
        self.D12 = np.hstack([zeros((n_z, k)), plant.D12])
        self.D21 = np.vstack([zeros((k, n_w)), plant.D21])
        self.D22 = None
        if D22.any():
            self.D22 = zeros((k + n_y, k + n_u))
            self.D22[k:, k:] = D22

    # --- the loop ----------------------------------------------------------------------------------------------------

    def _member(self, theta: AnyArray) -> _Member | None:
        """Return the loop with ``Theta (I - D22 Theta)^-1``; None where it is ill-posed or not finite."""
        left = right = None
        inner = theta
        if self.D22 is not None:
            right = np.eye(self.D22.shape[0]) - self.D22 @ theta
            if not np.isfinite(right).all() or np.linalg.cond(right) > ILL_POSED:
                return None
            right = np.linalg.inv(right)
            left, inner = np.eye(theta.shape[0]) + theta @ right @ self.D22, theta @ right
        tc, td = inner @ self.C, inner @ self.D21
        loop = Realisation(
            self.A + self.B @ tc, self.B1 + self.B @ td, self.C1 + self.D12 @ tc, self.D11 + self.D12 @ td
        )
        return _Member(loop, left, right) if all(np.isfinite(part).all() for part in loop) else None

    def loop(self, theta: AnyArray) -> Realisation | None:
        """Return the loop's matrices; None where it is ill-posed."""
        member = self._member(theta)
        return None if member is None else member.loop

    def _image(self, theta: AnyArray) -> tuple[_Member | None, Realisation | None]:
        """Return the loop, and the same or its continuous image."""
        member = self._member(theta)
        return member, None if member is None else bilinear(member.loop) if self.discrete else member.loop

    def _by_loop(self, member: _Member, by: Realisation) -> AnyArray:
        """Return the gradient by Theta from that by the loop's matrices."""
        G = self.B.T @ (by.A @ self.C.T + by.B @ self.D21.T) + self.D12.T @ (by.C @ self.C.T + by.D @ self.D21.T)
        return member.by_theta(G)

    # --- poles -------------------------------------------------------------------------------------------------------

    def pole(self, theta: AnyArray, measure: Any) -> Pole | None:
        """Return the pole with the largest ``measure(poles)`` and its derivative; None where there is none."""
        member = self._member(theta) if len(self.A) else None
        if member is None:
            return None
        value, u, v = extreme_pole(member.loop.A, measure)
        return Pole(value, member.by_theta(np.outer(u @ self.B, self.C @ v)))

    def abscissa(self, theta: AnyArray) -> tuple[float, AnyArray | None]:
        """Return the spectral abscissa (discrete: largest modulus minus one) and its gradient by Theta."""
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
        """Return the H-infinity norm and its gradient; ``(inf, None)`` for an unstable loop."""
        member, continuous = self._image(theta)
        if member is None or continuous is None:
            return np.inf, None
        value, omega = largest_gain(continuous)
        if value >= give_up_above or not np.isfinite(value):
            return value, None
        found = self._gradients(member, np.array([omega]), 0.0)
        return (max(value, found[0][0]), found[0][1]) if found else (np.inf, None)

    def active(self, theta: AnyArray, value: float, share: float, band: float) -> list[tuple[float, AnyArray]]:
        """Return the singular values at all peaks above ``(1 - share) value``, each with its gradient."""
        member, continuous = self._image(theta)
        if member is None or continuous is None:
            return []
        omegas = np.array(active_frequencies(continuous, value, share, band))
        return self._gradients(member, omegas, (1 - share) * value)

    def _gradients(self, member: _Member, omegas: AnyArray, least: float) -> list[tuple[float, AnyArray]]:
        """Return singular values above ``least`` near the largest of each frequency, with their gradients."""
        a, b, c, d = member.loop
        m, found = b.shape[1], list[tuple[float, AnyArray]]()
        dynamic = (np.isfinite(omegas) | self.discrete) & bool(len(a))
        parts = list[tuple[Any, Any, Any]]()
        if dynamic.any():
            points = np.array([resolvent_point(omega, self.discrete) for omega in omegas[dynamic]])
            try:
                x = np.linalg.solve(points[:, None, None] * np.eye(len(a)) - a, np.hstack([b, self.B])[None] + 0j)
            except np.linalg.LinAlgError:
                return []
            by_w = x[:, :, :m]
            parts.append((c @ by_w + d, self.D12 + c @ x[:, :, m:], self.D21 + self.C @ by_w))
        if not dynamic.all():
            parts.append((d[None], self.D12[None], self.D21[None]))
        for gain, rows, columns in parts:
            if not np.isfinite(gain).all():
                return []
            left, s, right = np.linalg.svd(gain, full_matrices=False)
            for i, k in np.argwhere((s > least) & (s > 0.5 * s[:, :1])):
                row, column = left[i, :, k].conj() @ rows[i], columns[i] @ right[i, k].conj()
                found.append((float(s[i, k]), np.real(member.by_theta(np.outer(row, column)))))
        return found

    def h2_norm(self, theta: AnyArray) -> tuple[float, AnyArray | None]:
        """Return the H2 norm and its gradient; ``(inf, None)`` for an unstable loop."""
        from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

        member = self._member(theta)
        if member is None:
            return np.inf, None
        a, b, c, d = member.loop
        values = np.linalg.eigvals(a) if len(a) else np.zeros(0)
        edge = np.abs(values).max(initial=0.0) - 1 if self.discrete else values.real.max(initial=-np.inf)
        if edge >= -BLUR * (1.0 if self.discrete else np.abs(a).max(initial=0.0)):
            return np.inf, None
        if self.discrete:
            P, Q = solve_discrete_lyapunov(a, b @ b.T), solve_discrete_lyapunov(a.T, c.T @ c)
        else:
            P, Q = solve_continuous_lyapunov(a, -b @ b.T), solve_continuous_lyapunov(a.T, -c.T @ c)
        direct = d * self.discrete
        square = float(np.trace(c @ P @ c.T) + (direct**2).sum())
        if not np.isfinite(square) or square < 0:
            return np.inf, None
        norm = np.sqrt(square)
        by_loop = Realisation(Q @ a @ P if self.discrete else Q @ P, Q @ b, c @ P, direct)
        return norm, self._by_loop(member, by_loop) / max(norm, 1e-300)

    def entropy(self, theta: AnyArray, gamma: float) -> tuple[float, AnyArray, float] | None:
        """Return the entropy at this level with its gradients by Theta and by gamma; None at or below the norm."""
        member, continuous = self._image(theta)
        found = None if continuous is None else entropy(continuous, gamma)
        if member is None or found is None:
            return None
        value, by_gamma, by_loop = found
        by_loop = bilinear_pullback(member.loop, by_loop) if self.discrete else by_loop
        return value, self._by_loop(member, by_loop), by_gamma
