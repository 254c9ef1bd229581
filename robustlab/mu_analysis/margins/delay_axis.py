"""How far the response of a model with exact delays can be from what it is at a point of the axis."""

# With the states and what leaves the delays as unknowns G(s) = D + C F(s)^-1 B, and |F(j w) - F(j c)| <= h N entry by
# entry for |w - c| <= h, N = diag(I, tau): only the diagonal moves. With m = |T F(jc)^-1 N T^-1| for any diagonal T,
# l = |C F(jc)^-1 N T^-1|, r = |T F(jc)^-1 B| and h m < 1, Neumann's series gives |G(jw) - G(jc)| <= h l r / (1 - h m)
# and |G''| <= l r / (1 - h m)^2 (2 m / (1 - h m) + tau_max). Beyond the bandwidth |(jwI - A)^-1| <= 1 / (w - |A|)
# bounds every entry of what is left, and a nonnegative matrix of spectral radius below one the echoes. Horn, Johnson,
# *Matrix Analysis* (2013), section 5.8; Michiels, Niculescu (2014), chapter 1.

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.delays.model import DelayedModel
from robustlab.errors import NoTrustworthyNumber

__all__ = ["DelayAxis", "Seen"]

SWEEPS = 6  # of the balancing by T
FASTEST = 60  # doublings of the frequency in which the far end is sought
CHUNK = 2_000_000  # complex numbers solved for at once


class Seen(NamedTuple):
    """At the middles of intervals, (k,): the response (k, n_y, n_u), its derivative, and m, l, r; see the module."""

    value: ComplexArray
    slope: ComplexArray
    m: Array
    left: Array
    right: Array

    def spread(self, half: Array) -> Array:
        """How far the response is at most from ``value`` within ``half`` of the middle; inf where nothing is known."""
        near = half * self.m
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(near < 1.0, half * self.left * self.right / (1.0 - near), np.inf)


class DelayAxis:
    """The response of a model with exact delays on the axis, of some of its outputs and inputs."""

    def __init__(self, model: DelayedModel, outputs: Sequence[int], inputs: Sequence[int]) -> None:
        self.model, self.delays, self.n = model, model.delays, model.H.n_states
        self.inner, B, C, D = model.at_once()
        self.B, self.C, self.D = B[:, list(inputs)], C[list(outputs)], D[np.ix_(outputs, inputs)]
        self.weight = np.concatenate([np.ones(self.n), self.delays])

    def response(self, omega: Array) -> ComplexArray:
        """The response alone, (k, n_y, n_u)."""
        held = np.broadcast_to(self.B, (len(omega), *self.B.shape))
        return self.D + self.C @ np.linalg.solve(self.characteristic(omega), held)

    def seen(self, middle: Array) -> Seen:
        """What the bounds about these frequencies need."""
        size = max(1, CHUNK // max(len(self.weight) ** 2, 1))
        parts = [self._seen(middle[k : k + size]) for k in range(0, len(middle), size)]
        return Seen(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _seen(self, omega: Array) -> Seen:
        try:
            inverse = np.linalg.inv(self.characteristic(omega))
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("delayed loop", "a root of its characteristic equation on the axis") from None
        weighted = inverse * self.weight
        T = _balancing(np.abs(weighted))
        right, left = inverse @ self.B, self.C @ weighted
        turn = np.ones((len(omega), len(self.weight)), dtype=complex)
        turn[:, self.n :] = np.exp(1j * omega[:, None] * self.delays)
        value = self.D + self.C @ right
        slope = -1j * (left * turn[:, None, :]) @ right

        def norm(stack: ComplexArray) -> Array:
            return np.linalg.norm(stack, axis=(1, 2)) if 0 in stack.shape[1:] else np.linalg.norm(stack, 2, axis=(1, 2))

        m = norm(weighted * T[:, :, None] / T[:, None, :])
        return Seen(value, slope, m, norm(left / T[:, None, :]), norm(right * T[:, :, None]))

    def curvature(self, seen: Seen, half: Array) -> Array:
        """Bound of the second derivative within ``half`` of the middles; inf where nothing is known."""
        near = half * seen.m
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = seen.left * seen.right / (1.0 - near) ** 2
            bound = bound * (2.0 * seen.m / (1.0 - near) + self.delays.max(initial=0.0))
        return np.where(near < 1.0, bound, np.inf)

    def far(self, omega: float, about: Array) -> float:
        """Bound of ``||G - about||`` at all frequencies from ``omega`` on; inf where nothing is known."""
        n = self.n
        size = float(np.linalg.norm(self.inner[:n, :n], 2)) if n else 0.0
        if n and omega <= size:
            return np.inf
        small = 1.0 / (omega - size) if n else 0.0

        def size_of(direct: Array, out: Array, into: Array) -> Array:
            """Entry by entry, for the dynamics between ``into`` and ``out`` have at most the gain ``small``."""
            return np.abs(direct) + small * np.outer(np.linalg.norm(out, axis=1), np.linalg.norm(into, axis=0))

        c1, b1, c2, b2 = self.inner[n:, :n], self.inner[:n, n:], self.C[:, :n], self.B[:n]
        around = size_of(self.inner[n:, n:], c1, b1)
        if len(around) and np.abs(np.linalg.eigvals(around)).max() >= 1.0:
            return np.inf
        echo = np.linalg.solve(np.eye(len(around)) - around, size_of(self.B[n:], c1, b2))
        whole = size_of(self.D - about, c2, b2) + size_of(self.C[:, n:], c2, b1) @ echo
        return float(np.linalg.norm(whole, 2)) if whole.size else 0.0  # numpy 2.0 has no norm of nothing

    def end(self, about: Array, level: float) -> float | None:
        """A frequency from which on ``||G - about|| <= level``; None where none is found."""
        omega = max(2.0 * float(np.linalg.norm(self.inner[: self.n, : self.n], 2)) if self.n else 0.0, 1e-6)
        for _ in range(FASTEST):
            if self.far(omega, about) <= level:
                return omega
            omega *= 2.0
        return None

    def characteristic(self, omega: Array) -> ComplexArray:
        """F on the axis, (k, n, n), in balanced unknowns."""
        return self.model.turned(-self.inner, 1j * omega)


def _balancing(size: Array) -> Array:
    """Diagonal T, (k, n), that brings rows and columns of ``T X T^-1`` to one size (Osborne)."""
    k, n = size.shape[:2]
    T = np.ones((k, n))
    off = size * (1.0 - np.eye(n))
    for _ in range(SWEEPS):
        for i in range(n):
            row = np.einsum("kj,kj->k", off[:, i], 1.0 / T) * T[:, i]
            column = np.einsum("kj,kj->k", off[:, :, i], T) / T[:, i]
            known = (row > 0) & (column > 0)
            T[:, i] *= np.sqrt(np.where(known, column / np.where(known, row, 1.0), 1.0))
    return T
