"""Scaling of a generalised plant by powers of two, undone exactly in the controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation


@dataclass(frozen=True, eq=False)
class Scaling:
    """Powers of two; ``x = states * x_scaled``, ``u = u * u_scaled``, ``y_scaled = y * y``, time unit ``1/rate``."""

    rate: float
    states: AnyArray
    u: AnyArray
    y: AnyArray
    w: float = 1.0
    z: float = 1.0

    @property
    def gain(self) -> float:
        """Factor from a closed-loop gain of the plant to that of the scaled plant."""
        return float(self.w) * float(self.z)

    def in_steps(self) -> Scaling:
        """Return the same for a discrete plant, whose time unit is the step."""
        return replace(self, rate=1.0)

    def apply(self, p: PlantMatrices) -> PlantMatrices:
        """Scale the plant."""
        t, u, y, w, z = self.states, self.u, self.y[:, None], self.w, self.z
        rows = t[:, None] * self.rate
        with np.errstate(over="ignore", under="ignore"):
            return PlantMatrices(
                p.A / rows * t, p.B1 / rows * w, p.B2 / rows * u, p.C1 * t * z, p.C2 * t * y,
                p.D11 * w * z, p.D12 * u * z, p.D21 * w * y,
            )  # fmt: skip

    def controller_to_plant(self, K: Realisation) -> Realisation:
        """Return the controller for the plant from one for the scaled plant."""
        u, y = self.u[:, None], self.y
        with np.errstate(over="ignore", under="ignore"):
            return Realisation(K.A * self.rate, K.B * self.rate * y, K.C * u, K.D * u * y)

    def controller_from_plant(self, K: Realisation) -> Realisation:
        """Invert `controller_to_plant`."""
        u, y = self.u[:, None], self.y
        return Realisation(K.A / self.rate, K.B / self.rate / y, K.C / u, K.D / u / y)


def _power(x: AnyArray | float) -> AnyArray:
    """Round to the nearest powers of two; 1 where x is zero."""
    x = np.asarray(x, dtype=float)
    usable = np.isfinite(x) & (x > 0)
    return 2.0 ** np.round(np.log2(np.where(usable, x, 1.0)))


def _rms(x: AnyArray) -> float:
    return float(np.linalg.norm(x) / np.sqrt(max(1, min(x.shape)))) if x.size else 0.0


def _start(p: PlantMatrices) -> Scaling:
    size = np.abs(np.linalg.eigvals(p.A)) if p.A.size else np.zeros(0)
    size = np.sort(size[size > 1e-9 * max(size.max(initial=0.0), 1e-300)])
    rate = float(_power(0.5 * (size[(len(size) - 1) // 2] + size[len(size) // 2]))) if len(size) else 1.0
    n, _, n_u, _, n_y = p.sizes
    return Scaling(rate, np.ones(n), np.ones(n_u), np.ones(n_y))


def _osborne(p: PlantMatrices, states: AnyArray, sweeps: int) -> AnyArray:
    """Return state factors that balance rows of [A B1 B2] against columns of [A; C1; C2], state by state."""
    n, t = len(states), states.copy()
    # The last column has all inputs of each state, the last row all outputs.
    squares = np.zeros((n + 1, n + 1))
    squares[:n, :n] = p.A**2
    squares[:n, n] = (p.B1**2).sum(1) + (p.B2**2).sum(1)
    squares[n, :n] = (p.C1**2).sum(0) + (p.C2**2).sum(0)
    np.fill_diagonal(squares, 0.0)
    for _ in range(sweeps):
        before = t.copy()
        for i in range(n):
            row, column = float(squares[i].sum()), float(squares[:, i].sum())
            if not (0 < row < np.inf and 0 < column < np.inf):
                continue
            power = round(0.25 * (math.log2(row) - math.log2(column)))
            if power:
                squares[i] *= 4.0**-power
                squares[:, i] *= 4.0**power
                t[i] *= 2.0**power
        if (t == before).all():
            break
    return t


def paths_first(p: PlantMatrices) -> Scaling:
    """Scale in three passes: direct paths D12, D21 (C1, B1 if they vanish) to size one, then states, then u and y."""
    s = _start(p)
    q = s.apply(p)
    for last in (False, False, True):
        if (s.z, s.w) == (1.0, 1.0):
            z = float(_power(1 / (_rms(q.D12) or _rms(q.C1) or 1.0)))
            w = float(_power(1 / (_rms(q.D21) or _rms(q.B1) or 1.0)))
            s = replace(s, w=w, z=z)
        s = replace(s, states=_osborne(s.apply(p), s.states, 20))
        if last:
            break
        q = s.apply(p)
        u = _channel(np.linalg.norm(q.D12, axis=0), np.linalg.norm(q.B2, axis=0))
        y = _channel(np.linalg.norm(q.D21, axis=1), np.linalg.norm(q.C2, axis=1))
        s = replace(s, u=s.u / u, y=s.y / y)
        q = s.apply(p)
    return s


def _channel(direct: AnyArray, dynamic: AnyArray) -> AnyArray:
    return _power(np.where(direct > 1e-8, direct, dynamic))


def equilibrated(p: PlantMatrices) -> Scaling:
    """Scale towards rows and columns of size one, until nothing changes or for 30 passes."""
    s = _start(p)
    for _ in range(30):
        before = s
        s = replace(s, states=_osborne(s.apply(p), s.states, 1))
        q = s.apply(p)
        u = _power(np.hypot(np.linalg.norm(q.B2, axis=0), np.linalg.norm(q.D12, axis=0)))
        y = _power(np.hypot(np.linalg.norm(q.C2, axis=1), np.linalg.norm(q.D21, axis=1)))
        s = replace(s, u=s.u / u, y=s.y / y)
        q = s.apply(p)
        w = float(_power(np.hypot(np.linalg.norm(q.B1), np.linalg.norm(q.D21)) / np.sqrt(max(1, q.B1.shape[1]))))
        z = float(_power(np.hypot(np.linalg.norm(q.C1), np.linalg.norm(q.D12)) / np.sqrt(max(1, q.C1.shape[0]))))
        s = replace(s, w=s.w / w, z=s.z / z)
        if all(np.array_equal(getattr(s, k), getattr(before, k)) for k in ("states", "u", "y", "w", "z")):
            break
    return s


def common_scaling(plants: Sequence[GeneralizedPlant]) -> list[Scaling]:
    """Return a scaling for each plant that differ in the states only: signals and time unit are those of the first."""
    matrices = [plant.matrices() for plant in plants]
    first = equilibrated(matrices[0])
    if plants[0].model.dt:
        first = first.in_steps()
    return [first, *(replace(first, states=equilibrated(other).states) for other in matrices[1:])]
