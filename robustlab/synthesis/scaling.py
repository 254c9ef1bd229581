"""Scaling of a generalised plant by powers of two: time unit, states, controls, measurements, w and z.

None of it changes the problem; it decides whether the tolerances of Riccati solvers mean something. All of it is
undone exactly in the controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.synthesis.partition import PlantMatrices, Realisation

__all__ = ["Scaling", "equilibrated", "paths_first"]

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Scaling:
    """Factors of a scaling; ``x = states * x_scaled``, ``u = u * u_scaled``, ``y_scaled = y * y``, time unit
    ``1/rate``.

    A closed-loop gain gamma of the plant is ``gamma * w * z`` after scaling.
    """

    rate: float
    states: Array
    u: Array
    y: Array
    w: float = 1.0
    z: float = 1.0

    @property
    def gain(self) -> float:
        """Factor from a closed-loop gain of the plant to that of the scaled plant."""
        return self.w * self.z

    def apply(self, p: PlantMatrices) -> PlantMatrices:
        """The scaled plant."""
        t, rows = self.states, self.states[:, None] * self.rate
        return PlantMatrices(
            p.A / rows * t,
            p.B1 / rows * self.w,
            p.B2 / rows * self.u,
            p.C1 * t * self.z,
            p.C2 * t * self.y[:, None],
            p.D11 * (self.w * self.z),
            p.D12 * self.u * self.z,
            p.D21 * self.w * self.y[:, None],
        )

    def controller_to_plant(self, K: Realisation) -> Realisation:
        """The controller for the plant that belongs to one for the scaled plant."""
        u = self.u[:, None]
        return Realisation(self.rate * K.A, self.rate * K.B * self.y, u * K.C, u * K.D * self.y)

    def controller_from_plant(self, K: Realisation) -> Realisation:
        """Inverse of `controller_to_plant`."""
        u = self.u[:, None]
        return Realisation(K.A / self.rate, K.B / self.rate / self.y, K.C / u, K.D / u / self.y)


def _power(x: Array | float) -> Array:
    """Nearest powers of two; 1 where x is zero."""
    x = np.asarray(x, dtype=float)
    usable = np.isfinite(x) & (x > 0)
    return 2.0 ** np.round(np.log2(np.where(usable, x, 1.0)))


def _rms(x: Array) -> float:
    return float(np.linalg.norm(x) / np.sqrt(max(1, min(x.shape)))) if x.size else 0.0


def _start(p: PlantMatrices) -> Scaling:
    size = np.abs(np.linalg.eigvals(p.A)) if p.A.size else np.zeros(0)
    size = size[size > 1e-9 * max(size.max(initial=0.0), 1e-300)]
    rate = float(_power(float(np.median(size)))) if len(size) else 1.0
    n, _, n_u, _, n_y = p.sizes
    return Scaling(rate, np.ones(n), np.ones(n_u), np.ones(n_y))


def _osborne(p: PlantMatrices, states: Array, sweeps: int) -> Array:
    """State factors that balance rows of [A B1 B2] against columns of [A; C1; C2], one state after the other."""
    A, B, C = p.A.copy(), np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2])
    t = states.copy()
    for _ in range(sweeps):
        settled = True
        for i in range(len(t)):
            own = A[i, i] ** 2
            row = (A[i] @ A[i]) - own + B[i] @ B[i]
            column = (A[:, i] @ A[:, i]) - own + C[:, i] @ C[:, i]
            if row <= 0 or column <= 0:
                continue
            f = float(_power(np.sqrt(np.sqrt(row / column))))
            if f != 1.0:
                A[i] /= f
                B[i] /= f
                A[:, i] *= f
                C[:, i] *= f
                t[i] *= f
                settled = False
        if settled:
            break
    return t


def paths_first(p: PlantMatrices) -> Scaling:
    """Three fixed passes: direct paths D12, D21 (C1, B1 where they vanish) to size one, then states, then u and y."""
    s = _start(p)
    for last in (False, False, True):
        q = s.apply(p)
        if (s.z, s.w) == (1.0, 1.0):
            z = float(_power(1 / (_rms(q.D12) or _rms(q.C1) or 1.0)))
            w = float(_power(1 / (_rms(q.D21) or _rms(q.B1) or 1.0)))
            s = Scaling(s.rate, s.states, s.u, s.y, s.w * w, s.z * z)
        s = Scaling(s.rate, _osborne(s.apply(p), s.states, 20), s.u, s.y, s.w, s.z)
        if last:
            return s
        q = s.apply(p)
        u = _channel(np.linalg.norm(q.D12, axis=0), np.linalg.norm(q.B2, axis=0))
        y = _channel(np.linalg.norm(q.D21, axis=1), np.linalg.norm(q.C2, axis=1))
        s = Scaling(s.rate, s.states, s.u / u, s.y / y, s.w, s.z)
    return s


def _channel(direct: Array, dynamic: Array) -> Array:
    return _power(np.where(direct > 1e-8, direct, dynamic))


def equilibrated(p: PlantMatrices) -> Scaling:
    """Everything towards rows and columns of size one, until nothing changes or after 30 passes."""
    s = _start(p)
    for _ in range(30):
        before = s
        s = Scaling(s.rate, _osborne(s.apply(p), s.states, 1), s.u, s.y, s.w, s.z)
        q = s.apply(p)
        u = _power(np.hypot(np.linalg.norm(q.B2, axis=0), np.linalg.norm(q.D12, axis=0)))
        y = _power(np.hypot(np.linalg.norm(q.C2, axis=1), np.linalg.norm(q.D21, axis=1)))
        s = Scaling(s.rate, s.states, s.u / u, s.y / y, s.w, s.z)
        q = s.apply(p)
        w = float(_power(np.hypot(np.linalg.norm(q.B1), np.linalg.norm(q.D21)) / np.sqrt(max(1, q.B1.shape[1]))))
        z = float(_power(np.hypot(np.linalg.norm(q.C1), np.linalg.norm(q.D12)) / np.sqrt(max(1, q.C1.shape[0]))))
        s = Scaling(s.rate, s.states, s.u, s.y, s.w / w, s.z / z)
        if all(np.array_equal(getattr(s, k), getattr(before, k)) for k in ("states", "u", "y", "w", "z")):
            break
    return s
