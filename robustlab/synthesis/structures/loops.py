"""Closed loops of a plant with a packed controller Theta, with their poles, norms and derivatives by Theta.

For the plant extended by integrators the loop is affine in Theta, or in Theta (I - D22 Theta)^-1.
Norms are fast and unproved. Frequencies are those of a continuous loop; a discrete one is mapped by the bilinear rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import lapack
from robustlab.linear_analysis.slicot import lyapunov_solution, peak_gain
from robustlab.synthesis.problem.generalized_plant import PlantMatrices, Realisation

PEAK_TOLERANCE = 1e-11  # of AB13DD: line searches compare values of close points
PEAK_GRID = 28  # frequencies of the grid, without those of the poles
ZOOMS, ZOOM_POINTS = 5, 9  # refinements of the grid at its local maxima
BLUR = 1e-13  # share of the norm of A below which real parts of poles are indistinguishable from zero
DEFECTIVE = 1e-14  # least product of left and right eigenvectors in a derivative
ILL_POSED = 1e10  # condition number of I - D22 Theta above which a loop counts as ill-posed

Valued = tuple[float, AnyArray | None]  # a value with its gradient by Theta, which is None where there is no value


def bilinear(loop: Realisation) -> Realisation | None:
    """Return the continuous loop of a discrete one under ``s = (z - 1)/(z + 1)``; None for a pole at z = -1."""
    a, b, c, d = loop
    n = a.shape[0]
    try:
        e = np.linalg.inv(np.eye(n) + a)
    except np.linalg.LinAlgError:
        return None
    root = np.sqrt(2.0)
    return Realisation(e @ (a - np.eye(n)), root * e @ b, root * c @ e, d - c @ e @ b)


def extreme_pole(A: AnyArray, measure: Callable[[AnyArray], AnyArray]) -> tuple[complex, AnyArray, AnyArray]:
    """Return the pole with the largest ``measure(poles)``, and u, v with ``d pole = u^T dA v``."""
    from scipy.linalg import eig

    values, left, right = (np.asarray(x) for x in eig(A, left=True, check_finite=False))
    k = int(np.argmax(measure(values)))
    u, v = left[:, k].conj(), right[:, k]
    product = u @ v
    return complex(values[k]), u / (product if abs(product) >= DEFECTIVE else DEFECTIVE), v


def largest_gain(loop: Realisation) -> tuple[float, float]:
    """Return ``(norm, frequency)`` by AB13DD, unproved; infinite for an unstable loop."""
    direct = float(np.linalg.norm(loop.D, 2)) if loop.D.any() else 0.0
    if not loop.A.size or not loop.B.size or not loop.C.size:
        return direct, 0.0
    if not all(np.isfinite(m).all() for m in loop) or not stable_poles(lapack().dgeev(loop.A, 0, 0), loop.A):
        return np.inf, np.nan
    try:
        gain, omega = peak_gain(*loop, PEAK_TOLERANCE)
    except NoTrustworthyNumber:
        return np.inf, np.nan
    return (float(gain), float(omega)) if gain > direct else (direct, np.inf)


def stable_poles(found: tuple[Any, ...], A: AnyArray) -> bool:
    """Return whether the eigenvalues of A that LAPACK found lie clearly to the left of the axis."""
    return found[-1] == 0 and bool(found[0].max() < -BLUR * np.abs(A).max())


def active_frequencies(loop: Realisation, value: float, share: float, band: float) -> list[float]:
    """Return frequencies of local maxima above ``(1 - share) * value`` and of grid points above ``(1 - band)``."""
    if not loop.A.shape[0]:
        return [0.0]
    modal, least = ModalLoop(loop), (1 - share) * value
    direct = [np.inf] if loop.D.any() and np.linalg.norm(loop.D, 2) > least else []
    if not modal.stable:
        return direct
    top = largest_gain(loop)[1]
    omega = modal.frequencies(2 * PEAK_GRID, [top] if np.isfinite(top) else [])
    sigma = modal.sigma(omega)
    left, right = np.append(-1.0, sigma[:-1]), np.append(sigma[1:], -1.0)
    peaks = np.flatnonzero((sigma >= left) & (sigma >= right) & (sigma > least))
    low, high = omega[np.maximum(peaks - 1, 0)], omega[np.minimum(peaks + 1, len(omega) - 1)]
    each = np.arange(len(peaks))
    for _ in range(ZOOMS):
        points = np.linspace(low, high, ZOOM_POINTS)
        best = modal.sigma(points.ravel()).reshape(points.shape).argmax(axis=0)
        low, high = points[np.maximum(best - 1, 0), each], points[np.minimum(best + 1, ZOOM_POINTS - 1), each]
    return [*dict.fromkeys([*omega[sigma > (1 - band) * value], *(0.5 * (low + high))]), *direct]


class ModalLoop:
    """A loop in modal coordinates, for a fast gain at many frequencies with the accuracy of a search."""

    def __init__(self, loop: Realisation) -> None:
        a, b, c, self.d = loop
        n = a.shape[0]
        found = lapack().dgeev(a, compute_vl=0)
        real, imag, _, right, _ = found
        self.poles, self.stable = real + 1j * imag, stable_poles(found, a)
        if not self.stable:
            return
        vectors = right.astype(complex)
        for j in np.flatnonzero(imag > 0):
            vectors[:, j] = right[:, j] + 1j * right[:, j + 1]
            vectors[:, j + 1] = vectors[:, j].conj()
        # Almost equal modes have almost dependent vectors; this loses accuracy in the search only.
        try:
            self.b = np.linalg.solve(vectors, b.astype(complex))
        except np.linalg.LinAlgError:
            self.b = np.linalg.solve(vectors + 1e-12 * np.eye(n), b.astype(complex))
        self.c = c @ vectors

    def frequencies(self, grid: int = PEAK_GRID, more: Sequence[float] = ()) -> AnyArray:
        """Return zero, the poles' frequencies and resonances, and a coarse grid around them."""
        poles = self.poles[self.poles.imag >= 0]
        size = np.abs(poles)
        resonance = np.sqrt(np.maximum(poles.imag**2 - poles.real**2, 0.0))
        wide = np.geomspace(size.min() / 10, size.max() * 10, grid)
        return np.unique(np.concatenate([[0.0], size, poles.imag, resonance, wide, more]))

    def response(self, omega: AnyArray) -> AnyArray:
        """Return the gain matrices at finite frequencies, shape (n_omega, n_z, n_w)."""
        return (self.c[None] / (1j * omega[:, None, None] - self.poles)) @ self.b + self.d

    def sigma(self, omega: AnyArray) -> AnyArray:
        """Return the largest singular values at finite frequencies."""
        gain = self.response(omega)
        return np.linalg.norm(gain, 2 if min(gain.shape[1:]) > 1 else None, axis=(1, 2))


class _Member(NamedTuple):
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

    def member(self, theta: AnyArray) -> _Member | None:
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
        C, D = self.C1 + self.D12 @ tc, self.D11 + self.D12 @ td
        loop = Realisation(self.A + self.B @ tc, self.B1 + self.B @ td, C, D)
        return _Member(loop, left, right) if all(np.isfinite(part).all() for part in loop) else None

    def pole(self, theta: AnyArray, measure: Any) -> tuple[complex, AnyArray] | None:
        """Return the pole with the largest ``measure(poles)`` and its complex derivative; None where there is none."""
        member = self.member(theta) if len(self.A) else None
        if member is None:
            return None
        value, u, v = extreme_pole(member.loop.A, measure)
        return value, member.by_theta(np.outer(u @ self.B, self.C @ v))

    def abscissa(self, theta: AnyArray) -> Valued:
        """Return the spectral abscissa (discrete: largest modulus minus one)."""
        if not len(self.A):
            return -np.inf, np.zeros_like(theta)
        found = self.pole(theta, np.abs if self.discrete else np.real)
        if found is None:
            return np.inf, None
        value, G = found
        if not self.discrete:
            return value.real, np.real(G)
        return abs(value) - 1.0, np.real(G * np.conj(value) / max(abs(value), 1e-300))

    def _image(self, theta: AnyArray) -> tuple[_Member | None, Realisation | None]:
        """Return the loop, and the same or its continuous image."""
        member = self.member(theta)
        return member, None if member is None else bilinear(member.loop) if self.discrete else member.loop

    def norm(self, theta: AnyArray, give_up_above: float = np.inf) -> Valued:
        """Return the H-infinity norm; infinite for an unstable loop."""
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
            points = 1j * np.minimum(omegas[dynamic], 1e15)
            if self.discrete:
                points = (1 + points) / (1 - points)
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

    def h2_norm(self, theta: AnyArray) -> Valued:
        """Return the H2 norm; infinite for an unstable loop."""
        member = self.member(theta)
        if member is None:
            return np.inf, None
        a, b, c, d = member.loop
        poles = np.linalg.eigvals(a) if len(a) else np.zeros(0)
        edge = (np.abs(poles) - 1 if self.discrete else poles.real).max(initial=-np.inf)
        if edge >= -BLUR * (1.0 if self.discrete else np.abs(a).max(initial=0.0)):
            return np.inf, None
        try:
            P, Q = (lyapunov_solution(*x, self.discrete) for x in ((a, b @ b.T), (a.T, c.T @ c)))
        except NoTrustworthyNumber:
            return np.inf, None
        direct = d * self.discrete
        square = float(np.trace(c @ P @ c.T) + (direct**2).sum())
        if not np.isfinite(square) or square < 0:
            return np.inf, None
        norm, by_a, by_b, by_c = np.sqrt(square), Q @ a @ P if self.discrete else Q @ P, Q @ b, c @ P
        G = self.B.T @ (by_a @ self.C.T + by_b @ self.D21.T) + self.D12.T @ (by_c @ self.C.T + direct @ self.D21.T)
        return norm, member.by_theta(G) / max(norm, 1e-300)
