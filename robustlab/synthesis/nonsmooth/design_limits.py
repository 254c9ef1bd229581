"""Limits of a design: poles of the loop, poles and gain of the controller.

Each is a dimensionless function c that must be negative: ``c = -1`` is far inside, ``c = 0`` the limit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.norms import linf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.laws.controller_laws import unpacked
from robustlab.synthesis.nonsmooth.loop_family import LoopFamily
from robustlab.synthesis.nonsmooth.objectives import extreme_pole
from robustlab.synthesis.problem.partition import Realisation
from robustlab.synthesis.problem.scaling import Scaling

LimitAt = tuple[float, AnyArray]  # the c of a limit for a packed controller, with its gradient


@dataclass(frozen=True)
class Limit:
    """Base of all limits; poles s are in rad/s, of a sampled loop ``log(z)/dt``."""

    of_controller: ClassVar[bool] = False  # True for a limit of the controller alone, with one value for all plants
    words: ClassVar[str]

    def __post_init__(self) -> None:
        for field in fields(self):
            value, most = getattr(self, field.name), 1.0 if field.name == "ratio" else np.inf
            if not 0 < value <= most or not np.isfinite(value):
                expected = f"a positive number{f' up to {most:g}' if most < np.inf else ''}"
                raise InputError(f"fixed structure: {type(self).__name__}: {field.name}", f"{value}", expected)

    @property
    def text(self) -> str:
        """The limit in words."""
        return self.words.format(**vars(self))

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        """Return the c of a finished design; negative or zero where the limit is kept."""
        raise NotImplementedError

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        """Return the c and its gradient by the packed controller of the scaled plant; infinite without a value."""
        raise NotImplementedError


def _continuous_poles(poles: AnyArray, dt: float) -> AnyArray:
    """Return poles in rad/s, ``log(z)/dt`` for a sampled loop."""
    return np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / dt if dt else poles


@dataclass(frozen=True)
class _PoleLimit(Limit):
    """A limit of every pole of the loop."""

    def measure(self, s: AnyArray, size: AnyArray) -> tuple[AnyArray, AnyArray | float]:
        """Return the c of poles s of these moduli, and the w with ``dc = Re(w ds)``."""
        raise NotImplementedError

    def _at(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        c, w = self.measure(s, np.maximum(np.abs(s), 1e-300))
        return c, w * np.ones(len(s), complex)

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        poles = plant_loop.poles()
        return float(self._at(_continuous_poles(poles, plant_loop.dt))[0].max()) if len(poles) else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        unit = 1.0 if dt else scaling.rate
        found = family.pole(theta, lambda poles: self._at(_continuous_poles(unit * poles, dt))[0])
        if found is None:
            return np.inf, np.zeros_like(theta)
        c, w = self._at(_continuous_poles(np.array([unit * found.value]), dt))
        by_pole = w[0] * (1 / (found.value * dt) if dt and found.value else unit)
        return float(c[0]), np.real(by_pole * found.G)


@dataclass(frozen=True)
class Decay(_PoleLimit):
    """Every mode of the loop decays at least as ``exp(-rate t)``; rate in 1/s."""

    rate: float
    words = "decay rate >= {rate:g} 1/s"

    def measure(self, s: AnyArray, size: AnyArray) -> tuple[AnyArray, AnyArray | float]:
        return np.real(s) / self.rate + 1, 1 / self.rate


@dataclass(frozen=True)
class Damping(_PoleLimit):
    """Every mode of the loop has at least this damping ratio (0 to 1)."""

    ratio: float
    words = "damping >= {ratio:g}"

    def measure(self, s: AnyArray, size: AnyArray) -> tuple[AnyArray, AnyArray | float]:
        return self.ratio + np.real(s) / size, 1 / size - np.real(s) * np.conj(s) / size**3


@dataclass(frozen=True)
class Bandwidth(_PoleLimit):
    """No pole of the loop has a modulus above this frequency in rad/s."""

    frequency: float
    words = "poles within {frequency:g} rad/s"

    def measure(self, s: AnyArray, size: AnyArray) -> tuple[AnyArray, AnyArray | float]:
        return np.abs(s) / self.frequency - 1, np.conj(s) / (size * self.frequency)


@dataclass(frozen=True)
class StableController(Limit):
    """The controller itself is stable (integrators are not)."""

    of_controller = True
    words = "controller stable"

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return K.spectral_abscissa() if K.n_states else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        k, G = family.order, np.zeros_like(theta)
        if not k:
            return -1.0, G
        if not np.isfinite(theta).all():
            return np.inf, G
        at, u, v = extreme_pole(theta[:k, :k], np.abs if dt else np.real)
        size, by = max(abs(at), 1e-300), np.outer(u, v)
        G[:k, :k] = np.real(by * np.conj(at) / size) if dt else np.real(by)
        return float(size - 1 if dt else at.real), G


@dataclass(frozen=True)
class RollOff(Limit):
    """The controller's gain is at most ``gain`` at and above ``frequency`` (rad/s), in the plant's units."""

    of_controller = True
    words = "controller gain <= {gain:g} from {frequency:g} rad/s on"
    frequency: float
    gain: float

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return self._peak(Realisation.of(K), self.frequency, K.dt)[0] / self.gain - 1

    def _peak(self, K: Realisation, frequency: float, dt: float) -> tuple[float, float]:
        """Return the proved largest gain from this frequency on, and its frequency."""
        if not all(np.isfinite(m).all() for m in K):
            return np.inf, np.nan
        last = np.pi / dt if dt else np.inf
        found = linf_norm(StateSpaceModel(*K, dt), 1e-9, band=(min(frequency, (1 - 1e-9) * last), last))
        return found.upper, found.frequency

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        # In the units of the plant's signals, but in the scaled plant's time.
        k, ones = family.order, np.ones(family.order)
        back = np.append(ones, scaling.u)[:, None] * np.append(ones, scaling.y)
        K = Realisation(*unpacked(theta * back, k))
        value, omega = self._peak(K, self.frequency if dt else self.frequency / scaling.rate, dt)
        G = np.zeros_like(theta)
        if not np.isfinite(value):
            return np.inf, G
        if not k or not np.isfinite(omega):
            left, _, right = np.linalg.svd(K.D)
            G[k:, k:] = np.outer(left[:, 0], right[0])
            return value / self.gain - 1, G / self.gain * back
        shifted = (np.exp(1j * omega * dt) if dt else 1j * omega) * np.eye(k) - K.A
        left, _, right = np.linalg.svd(K.C @ np.linalg.solve(shifted, K.B + 0j) + K.D)
        u, v = left[:, 0], right[0].conj()
        row = np.append(np.linalg.solve(shifted.T, K.C.T @ u.conj()), u.conj())
        column = np.append(np.linalg.solve(shifted, K.B @ v), v)
        return value / self.gain - 1, np.real(np.outer(row, column)) / self.gain * back
