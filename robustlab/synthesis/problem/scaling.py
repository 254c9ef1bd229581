"""Scaling of a generalised plant by powers of two, undone exactly in the controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import LARGEST, SMALLEST, TINY, balancing_exponents, times_power
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation

# Powers of two by which a loop is faster than A where it gives the unit of time, and the largest factor of a scaling.
FASTER, LIMIT = 40, 1000


@dataclass(frozen=True, eq=False)
class Scaling:
    """Factors of a scaling; ``x = states * x_scaled``, ``u = u * u_scaled``, ``y_scaled = y * y``, time unit
    ``1/rate``.
    """

    rate: float
    states: AnyArray
    u: AnyArray
    y: AnyArray
    w: float = 1.0
    z: float = 1.0

    @property
    def gain(self) -> float:
        """Factor from a closed-loop gain of the plant to that of the scaled plant."""
        gain = float(self.w) * float(self.z)
        if not TINY <= gain <= 1 / TINY:
            found = f"gains of the loop are about 1e{-np.log10(self.w) - np.log10(self.z):.0f}"
            raise NoTrustworthyNumber(
                "scaling", found, "gains between 1e-307 and 1e307", "choose other units of w and z"
            )
        return gain

    def in_steps(self) -> Scaling:
        """The same for a discrete plant, whose step has no other unit of time."""
        return replace(self, rate=1.0)

    def apply(self, p: PlantMatrices) -> PlantMatrices:
        """The scaled plant."""
        k, w, z = _exponent(self.rate), _exponent(self.w), _exponent(self.z)
        t, u, y = _exponent(self.states), _exponent(self.u), _exponent(self.y)[:, None]
        rows = -t[:, None] - k
        with np.errstate(over="ignore", under="ignore"):
            A = times_power(p.A, rows + t)
            A = np.where((A == 0) & (p.A != 0), np.copysign(TINY, p.A), A)  # a pole keeps its side of the axis
            others = (p.B1, rows + w), (p.B2, rows + u), (p.C1, t + z), (p.C2, t + y)
            direct = (p.D11, w + z), (p.D12, u + z), (p.D21, w + y)
            return PlantMatrices(A, *(np.ldexp(matrix, exponents) for matrix, exponents in (*others, *direct)))

    def controller_to_plant(self, K: Realisation, sign: int = 1) -> Realisation:
        """The controller for the plant that belongs to one for the scaled plant; the inverse with ``sign=-1``."""
        k, u, y = sign * _exponent(self.rate), sign * _exponent(self.u)[:, None], sign * _exponent(self.y)
        return Realisation(times_power(K.A, k), times_power(K.B, k + y), times_power(K.C, u), times_power(K.D, u + y))

    def controller_from_plant(self, K: Realisation) -> Realisation:
        """Inverse of `controller_to_plant`."""
        return self.controller_to_plant(K, -1)


def _exponent(factor: AnyArray | float) -> AnyArray:
    """Exponents of factors, which are powers of two."""
    return np.frexp(factor)[1] - 1


def _power(x: AnyArray | float) -> AnyArray:
    """Nearest powers of two; 1 where x is zero."""
    x = np.asarray(x, dtype=float)
    usable = np.isfinite(x) & (x > 0)
    return 2.0 ** np.round(np.log2(np.where(usable, x, 1.0)))


def _rms(x: AnyArray) -> float:
    return float(np.linalg.norm(x) / np.sqrt(max(1, min(x.shape)))) if x.size else 0.0


def _is_ordinary(p: PlantMatrices) -> bool:
    """Whether products of the plant's entries neither overflow nor vanish."""
    # The largest entries count, of each control and each measurement by itself: small ones may be rounding.
    sizes = [np.abs(m).max(axis=0, initial=0.0) for m in (p.B2, p.D12, p.C2.T, p.D21.T)]
    sizes.append(np.array([np.abs(m).max(initial=0.0) for m in (p.A, p.B1, p.C1, p.D11)]))
    found = np.concatenate(sizes)
    return bool(((found == 0) | ((found >= SMALLEST) & (found <= LARGEST))).all())


def _start(p: PlantMatrices, discrete: bool) -> Scaling:
    if not _is_ordinary(p):
        return by_magnitude(p, discrete)
    size = np.abs(np.linalg.eigvals(p.A)) if p.A.size else np.zeros(0)
    size = size[size > 1e-9 * max(size.max(initial=0.0), 1e-300)]
    size.sort()
    rate = float(_power(0.5 * (size[(len(size) - 1) // 2] + size[len(size) // 2]))) if len(size) else 1.0
    n, _, n_u, _, n_y = p.sizes
    return Scaling(rate, np.ones(n), np.ones(n_u), np.ones(n_y))


def by_magnitude(p: PlantMatrices, discrete: bool = False) -> Scaling:
    """B2 and C2 to order one, then what z and w weigh; by exponents, for plants whose squares overflow or vanish."""
    t = balancing_exponents(p.A, np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2]))
    rows, k = -t[:, None], -_to_one((p.A, -t[:, None] + t))
    if discrete:
        if k > FASTER:
            found = f"A grows by 2^{k} in one step: digits of everything else are lost beside it"
            raise NoTrustworthyNumber("scaling", found, None, "a shorter sample time")
        k = 0
    elif all(m.any() for m in (p.B1, p.B2, p.C1, p.C2, p.D12, p.D21)):
        control = _to_one((p.D12, 0)) - _to_one((p.B2, rows)) - _to_one((p.C1, t))
        filtering = _to_one((p.D21, 0)) - _to_one((p.C2, t)) - _to_one((p.B1, rows))
        pace = min(control, filtering)
        k = pace if pace > k + FASTER or not p.A.any() else k
    rows = rows - k
    _, _, n_u, _, n_y = p.sizes
    acts, shows = [column.any() for column in p.B2.T], [row.any() for row in p.C2]
    u = [_to_one((p.B2[:, [i]], rows) if acts[i] else (p.D12[:, [i]], 0)) for i in range(n_u)]
    y = [_to_one((p.C2[[i]], t) if shows[i] else (p.D21[[i]], 0)) for i in range(n_y)]
    w = _to_one((p.B1, rows), (p.D21, np.reshape(y, (-1, 1))))
    z = _to_one((p.C1, t), (p.D12, np.array(u)))
    exponents = [np.asarray(e) for e in (k, t, u, y, w, z)]
    if max(np.abs(e).max(initial=0) for e in exponents) > LIMIT:
        raise NoTrustworthyNumber("scaling", "gains of the controller overflow", None, "choose other units of u and y")
    rate, states, into, out, w, z = (np.ldexp(1.0, e) for e in exponents)
    return Scaling(float(rate), states, into, out, float(w), float(z))


def _to_one(*scaled: tuple[AnyArray, AnyArray | int]) -> int:
    """Exponent that takes the largest entry of several ``matrix * 2^exponents`` to order one; 0 where all vanish."""
    found = [int((np.frexp(m)[1] + e)[m != 0].max()) for m, e in scaled if m.any()]
    return -max(found, default=0)


def _osborne(p: PlantMatrices, states: AnyArray, sweeps: int) -> AnyArray:
    """State factors that balance rows of [A B1 B2] against columns of [A; C1; C2], one state after the other."""
    n, t = len(states), states.copy()
    # All that enters a state, and all that it enters, as one row and one column more.
    squares = np.zeros((n + 1, n + 1))
    squares[:n, :n] = p.A**2
    squares[:n, n] = (p.B1**2).sum(1) + (p.B2**2).sum(1)
    squares[n, :n] = (p.C1**2).sum(0) + (p.C2**2).sum(0)
    np.fill_diagonal(squares, 0.0)
    for _ in range(sweeps):
        sizes = squares.sum(1)[:n], squares.sum(0)[:n]
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.subtract(*np.log2(sizes))
        if not np.round(0.25 * off[np.isfinite(off)]).any():  # what the sweep would find
            break
        for i in range(n):
            row, column = float(squares[i].sum()), float(squares[:, i].sum())
            if not (0 < row < np.inf and 0 < column < np.inf):
                continue
            power = round(0.25 * (math.log2(row) - math.log2(column)))
            if power:
                squares[i] *= 4.0**-power
                squares[:, i] *= 4.0**power
                t[i] *= 2.0**power
    return t


def paths_first(p: PlantMatrices, discrete: bool = False, slower: float = 1.0) -> Scaling:
    """Three fixed passes: direct paths D12, D21 (C1, B1 where they vanish) to size one, then states, then u and y."""
    s = _start(p, discrete)
    s = replace(s, rate=s.rate / slower)
    q = s.apply(p)
    for last in (False, False, True):
        if (s.z, s.w) == (1.0, 1.0):
            z = float(_power(1 / (_rms(q.D12) or _rms(q.C1) or 1.0)))
            w = float(_power(1 / (_rms(q.D21) or _rms(q.B1) or 1.0)))
            s, q = _changed(s, q, p, w=w, z=z)
        s, q = _changed(s, q, p, states=_osborne(q, s.states, 20))
        if last:
            return s
        u = _channel(np.linalg.norm(q.D12, axis=0), np.linalg.norm(q.B2, axis=0))
        y = _channel(np.linalg.norm(q.D21, axis=1), np.linalg.norm(q.C2, axis=1))
        s, q = _changed(s, q, p, u=s.u / u, y=s.y / y)
    return s


def _changed(s: Scaling, q: PlantMatrices, p: PlantMatrices, **factors: Any) -> tuple[Scaling, PlantMatrices]:
    """A scaling with other factors, and the plant that it makes of p: q where these are the same as before."""
    if all(np.array_equal(factor, getattr(s, name)) for name, factor in factors.items()):
        return s, q
    s = replace(s, **factors)
    return s, s.apply(p)


def _channel(direct: AnyArray, dynamic: AnyArray) -> AnyArray:
    return _power(np.where(direct > 1e-8, direct, dynamic))


def equilibrated(p: PlantMatrices, discrete: bool = False) -> Scaling:
    """Everything towards rows and columns of size one, until nothing changes or after 30 passes."""
    s = _start(p, discrete)
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
    """A scaling for every plant that differs only in the states: signals and time unit are those of the first."""
    matrices = [plant.matrices() for plant in plants]
    first = equilibrated(matrices[0])
    if plants[0].model.dt:
        first = first.in_steps()
    return [first, *(replace(first, states=equilibrated(other).states) for other in matrices[1:])]
