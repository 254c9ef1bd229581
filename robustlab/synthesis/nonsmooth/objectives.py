"""Objectives of a search: the H-infinity norm of a loop, and its entropy as a smooth barrier of that norm.

The norm is fast and unproved. The entropy at a level is finite exactly where the norm is below it.
Frequencies are those of a continuous loop; a discrete loop is first mapped by the bilinear rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrices import hamiltonian_riccati, lapack
from robustlab.linear_analysis.slicot import lyapunov_solution, peak_gain
from robustlab.synthesis.problem.partition import Realisation

PEAK_TOLERANCE = 1e-11  # of AB13DD: line searches compare values of close points
PEAK_GRID = 28  # frequencies of the first grid, without those of the poles
PEAK_REFINEMENTS = 8  # steps of the secant method at a peak
ENTROPY_RESIDUAL = 1e-7  # largest residual of the entropy's Riccati equation, relative to its terms
BLUR = 1e-13  # share of the norm of A below which real parts of poles are indistinguishable from zero
DEFECTIVE = 1e-14  # least product of left and right eigenvectors in a derivative


def bilinear(loop: Realisation) -> Realisation | None:
    """Return the continuous loop of a discrete one under ``s = (z - 1)/(z + 1)``; None for a pole at z = -1."""
    a, b, c, d = loop
    n = a.shape[0]
    if not n:
        return loop
    try:
        e = np.linalg.inv(np.eye(n) + a)
    except np.linalg.LinAlgError:
        return None
    root = np.sqrt(2.0)
    return Realisation(e @ (a - np.eye(n)), root * e @ b, root * c @ e, d - c @ e @ b)


def bilinear_pullback(loop: Realisation, by: Realisation) -> Realisation:
    """Return the gradients by a discrete loop from those by its `bilinear` image."""
    a, b, c, _ = loop
    e = np.linalg.inv(np.eye(len(a)) + a)
    eb, ce, root = e @ b, c @ e, np.sqrt(2.0)
    by_a = 2 * e.T @ by.A @ e.T - root * (e.T @ by.B @ eb.T + ce.T @ by.C @ e.T) + ce.T @ by.D @ eb.T
    return Realisation(by_a, root * e.T @ by.B - ce.T @ by.D, root * by.C @ e.T - by.D @ eb.T, by.D)


def resolvent_point(omega: float, discrete: bool) -> complex:
    """Return the s (or z, of a loop mapped by `bilinear`) of a continuous frequency; inf allowed."""
    if not discrete:
        return 1j * omega
    return -1.0 + 0j if np.isinf(omega) else (1 + 1j * omega) / (1 - 1j * omega)


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
    modal = ModalLoop(loop)
    direct = [np.inf] if loop.D.any() and np.linalg.norm(loop.D, 2) > (1 - share) * value else []
    if not modal.stable:
        return direct
    top = largest_gain(loop)[1]
    omega = modal.frequencies(2 * PEAK_GRID, [top] if np.isfinite(top) else [])
    sigma = modal.sigma(omega, (1 - share) * value)
    sigma = np.where(sigma > (1 - share) * value, sigma, 0.0)
    left, right = np.append(-1.0, sigma[:-1]), np.append(sigma[1:], -1.0)
    found = list(omega[sigma > (1 - band) * value])
    for k in np.flatnonzero((sigma >= left) & (sigma >= right) & (sigma > 0)):
        low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
        found.append(modal.refined(float(omega[k]), float(low), float(high)))
    return [*dict.fromkeys(found), *direct]


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

    def sigma(self, omega: AnyArray, above: float) -> AnyArray:
        """Return the largest singular values; the Frobenius norm where that is at most ``above``."""
        gain = self.response(omega)
        size = np.linalg.norm(gain, axis=(1, 2))
        large = size > above
        if min(gain.shape[1:]) > 1 and large.any():
            size[large] = np.linalg.svd(gain[large], compute_uv=False)[:, 0]
        return size

    def slope(self, omega: float) -> tuple[float, float]:
        """Return ``sigma_max`` and its derivative with respect to the frequency."""
        shift = 1j * omega - self.poles
        left, s, right = np.linalg.svd((self.c / shift) @ self.b + self.d, full_matrices=False)
        u, v = left[:, 0].conj(), right[0].conj()
        return float(s[0]), float(np.real(((u @ self.c) / shift**2) @ (self.b @ v) * -1j))

    def refined(self, omega: float, low: float, high: float) -> float:
        """Return the maximiser of sigma near omega inside [low, high] by a safeguarded secant method on the slope."""
        _, g = self.slope(omega)
        if g == 0 or omega == 0.0:
            return omega
        low, high = (omega, high) if g > 0 else (low, omega)
        at, g_at = (high, self.slope(high)[1]) if g > 0 else (low, self.slope(low)[1])
        if g_at * g > 0:
            return omega
        for _ in range(PEAK_REFINEMENTS):
            step = omega - g * (omega - at) / (g - g_at)
            inside = low + 0.02 * (high - low) <= step <= high - 0.02 * (high - low)
            new = step if inside else 0.5 * (low + high)
            g_new = self.slope(new)[1]
            low, high = (new, high) if g_new > 0 else (low, new)
            at, g_at, omega, g = omega, g, new, g_new
            if high - low < 1e-9 * high or g == g_at or abs(omega - at) < 1e-6 * omega:
                break
        return omega


# --- entropy ----------------------------------------------------------------------------------------------------------


def entropy(loop: Realisation, gamma: float) -> tuple[float, float, Realisation] | None:
    """Return the entropy and its derivatives by gamma and by the loop; None where the norm is not below gamma."""
    a, b, c, d = loop
    n, m = b.shape
    r = gamma**2 * np.eye(m) - d.T @ d
    try:
        np.linalg.cholesky(r)
        r_inv = np.linalg.inv(r)
    except np.linalg.LinAlgError:
        return None
    if not n:
        nothing = np.zeros
        value = -float(np.linalg.slogdet(r)[1]) + 2 * m * np.log(gamma)
        by_gamma = -2 * gamma * float(np.trace(r_inv)) + 2 * m / gamma
        by_loop = Realisation(nothing((0, 0)), nothing((0, m)), nothing((len(c), 0)), 2 * d @ r_inv)
        return value, by_gamma, by_loop
    # Mustafa, Glover, *Minimum entropy H-infinity control* (1990): with A^T X + X A + C^T C + F^T R F = 0 the factor
    # R^(1/2) (I - F (sI - A)^-1 B) is outer, and Poisson's integral gives the entropy from its value at s = 1.
    real, _, _, _, info = lapack().dgeev(a, compute_vl=0, compute_vr=0)
    by_d = r_inv @ (d.T @ c)
    if info or real.max() >= 0:
        return None
    x = hamiltonian_riccati(a + b @ by_d, -b @ r_inv @ b.T, c.T @ (c + d @ by_d), tolerance=ENTROPY_RESIDUAL)
    if x is None:
        return None
    f = r_inv @ (b.T @ x + d.T @ c)
    a_f, eye = a + b @ f, np.eye(n)
    w, w_f = np.linalg.inv(eye - a), np.linalg.inv(eye - a_f)
    logs = [float(np.linalg.slogdet(m)[1]) for m in (r, eye - a, eye - a_f)]
    value = -logs[0] + 2 * m * np.log(gamma) + 2 * (logs[1] - logs[2])
    v = w_f @ b @ r_inv
    s = v @ b.T
    try:
        y = lyapunov_solution(a_f, s + s.T, False)
    except NoTrustworthyNumber:
        return None
    if not (np.isfinite(value) and np.isfinite(y).all()):
        return None
    q = v + y @ f.T
    fv = f @ v
    by_r = r_inv + fv + fv.T + f @ y @ f.T
    by_gamma = -2 * gamma * float(np.trace(by_r)) + 2 * m / gamma
    by_a, by_b = 2 * (w_f - w + y @ x).T, 2 * (f @ w_f).T + 2 * x @ q
    by_c, by_d = 2 * d @ q.T + 2 * c @ y, 2 * c @ q + 2 * d @ by_r
    return value, by_gamma, Realisation(by_a, by_b, by_c, by_d)
