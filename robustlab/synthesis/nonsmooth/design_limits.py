r"""Limits that a design must keep: poles of the loop, poles and gain of the controller.

Each is a function c that must be negative, without unit: ``c = -1`` is far inside, ``c = 0`` the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.laws.controller_laws import unpacked
from robustlab.synthesis.nonsmooth.loop_family import LoopFamily
from robustlab.synthesis.nonsmooth.objectives import bilinear, crossings, resolvent_point
from robustlab.synthesis.problem.partition import Realisation
from robustlab.synthesis.problem.scaling import Scaling

# The c of a limit for a packed controller, with its gradient.
LimitAt = tuple[float, AnyArray]


def _positive(what: str, value: float, most: float = np.inf) -> None:
    if not 0 < value <= most or not np.isfinite(value):
        raise InputError(
            f"fixed structure: {what}", f"{value}", f"a positive number{f' up to {most:g}' if most < np.inf else ''}"
        )


def _continuous_poles(poles: AnyArray, dt: float) -> AnyArray:
    """Poles in rad/s: ``log(z)/dt`` of those of a sampled loop."""
    if not dt:
        return poles
    with np.errstate(divide="ignore"):
        return np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / dt


@dataclass(frozen=True)
class Limit:
    """What all limits have; poles s below are in rad/s, of a sampled loop ``log(z)/dt``."""

    # Whether it is about the controller alone, so that it has one value whatever the number of plants.
    of_controller = False

    @property
    def text(self) -> str:
        """The limit in words."""
        raise NotImplementedError

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        """The c of a finished design; negative or zero where the limit is kept."""
        raise NotImplementedError

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        """The c and its gradient by the packed controller of the scaled plant; an infinite c without a value."""
        raise NotImplementedError


@dataclass(frozen=True)
class _PoleLimit(Limit):
    """A limit of every pole of the loop."""

    def measure(self, s: AnyArray) -> AnyArray:
        """The c of poles s in rad/s."""
        raise NotImplementedError

    def slope(self, s: complex) -> complex:
        """The w with ``dc = Re(w ds)``."""
        raise NotImplementedError

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        poles = plant_loop.poles()
        return float(self.measure(_continuous_poles(poles, plant_loop.dt)).max()) if len(poles) else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        unit = 1.0 if dt else scaling.rate
        found = family.pole(theta, lambda poles: self.measure(_continuous_poles(unit * poles, dt)))
        if found is None:
            return np.inf, np.zeros_like(theta)
        s = complex(_continuous_poles(np.array([unit * found.value]), dt)[0])
        by_pole = self.slope(s) * (1 / (found.value * dt) if dt and found.value else unit)
        return float(self.measure(np.array([s]))[0]), np.real(by_pole * found.G)


@dataclass(frozen=True)
class Decay(_PoleLimit):
    """Every mode of the loop decays at least as ``exp(-rate t)``; rate in 1/s."""

    rate: float

    def __post_init__(self) -> None:
        _positive("decay rate", self.rate)

    @property
    def text(self) -> str:
        return f"decay rate >= {self.rate:g} 1/s"

    def measure(self, s: AnyArray) -> AnyArray:
        return np.real(s) / self.rate + 1

    def slope(self, s: complex) -> complex:
        return 1 / self.rate + 0j


@dataclass(frozen=True)
class Damping(_PoleLimit):
    """Every mode of the loop has at least this damping ratio (0 to 1)."""

    ratio: float

    def __post_init__(self) -> None:
        _positive("damping", self.ratio, 1.0)

    @property
    def text(self) -> str:
        return f"damping >= {self.ratio:g}"

    def measure(self, s: AnyArray) -> AnyArray:
        return self.ratio + np.real(s) / np.maximum(np.abs(s), 1e-300)

    def slope(self, s: complex) -> complex:
        size = max(abs(s), 1e-300)
        return 1 / size - s.real * np.conj(s) / size**3


@dataclass(frozen=True)
class Bandwidth(_PoleLimit):
    """No pole of the loop has a modulus above this frequency in rad/s."""

    frequency: float

    def __post_init__(self) -> None:
        _positive("bandwidth", self.frequency)

    @property
    def text(self) -> str:
        return f"poles within {self.frequency:g} rad/s"

    def measure(self, s: AnyArray) -> AnyArray:
        return np.abs(s) / self.frequency - 1

    def slope(self, s: complex) -> complex:
        return np.conj(s) / (max(abs(s), 1e-300) * self.frequency)


@dataclass(frozen=True)
class StableController(Limit):
    """The controller itself is stable (integrators are not)."""

    of_controller = True

    @property
    def text(self) -> str:
        return "controller stable"

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return K.spectral_abscissa() if K.n_states else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        from scipy.linalg import eig

        k = family.order
        G = np.zeros_like(theta)
        if not k:
            return -1.0, G
        if not np.isfinite(theta).all():
            return np.inf, G
        values, left, right = (np.asarray(x) for x in eig(theta[:k, :k], left=True, check_finite=False))
        worst = int(np.argmax(np.abs(values) if dt else np.real(values)))
        u, v = left[:, worst], right[:, worst]
        product = np.vdot(u, v)
        by = np.outer(u.conj(), v) / (product if abs(product) > 1e-14 else 1e-14)
        at = values[worst]
        size = max(abs(at), 1e-300)
        G[:k, :k] = np.real(by * np.conj(at) / size) if dt else np.real(by)
        return float(size - 1 if dt else at.real), G


@dataclass(frozen=True)
class RollOff(Limit):
    """The controller's gain is at most ``gain`` at and above ``frequency`` (rad/s), in the plant's units."""

    of_controller = True
    frequency: float
    gain: float

    def __post_init__(self) -> None:
        _positive("roll-off frequency", self.frequency)
        _positive("roll-off gain", self.gain)

    @property
    def text(self) -> str:
        return f"controller gain <= {self.gain:g} from {self.frequency:g} rad/s on"

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return self._peak(Realisation.of(K), self.frequency, bool(K.dt), K.dt)[0] / self.gain - 1

    def _peak(self, K: Realisation, frequency: float, discrete: bool, dt: float) -> tuple[float, float]:
        """Largest gain from this frequency on, and where (frequencies of the continuous or `bilinear` controller)."""
        if not len(K.A):
            return float(np.linalg.norm(K.D, 2)), np.inf
        mapped = bilinear(K) if discrete else K
        if mapped is None or not all(np.isfinite(m).all() for m in mapped):
            return np.inf, np.nan
        low = np.tan(min(frequency * dt / 2, np.pi / 2 - 1e-9)) if discrete else frequency
        eye = np.eye(len(K.A))

        def sigma(omega: AnyArray) -> AnyArray:
            gain = mapped.C @ np.linalg.solve(1j * omega[:, None, None] * eye - mapped.A, mapped.B + 0j) + mapped.D
            return np.linalg.svd(gain, compute_uv=False)[:, 0]

        own = np.abs(np.linalg.eigvals(mapped.A))
        omega = np.unique(np.concatenate([[low], own[own > low], np.geomspace(low, 1e3 * max(low, own.max()), 40)]))
        best, at = float(np.linalg.norm(mapped.D, 2)), np.inf
        for _ in range(20):
            values = sigma(omega)
            k = int(values.argmax())
            if not values[k] > best * (1 + 1e-9):
                break
            best, at = float(values[k]), float(omega[k])
            cross = crossings(mapped, best * (1 + 1e-9))
            cross = np.unique(np.append(cross[cross > low], low))
            omega = np.concatenate([cross, 0.5 * (cross[:-1] + cross[1:])])
        return best, at

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        # In the plant's own signals, but in the scaled plant's time.
        k, rate = family.order, scaling.rate
        back = np.concatenate([np.ones(k), scaling.u])[:, None] * np.concatenate([np.ones(k), scaling.y])[None, :]
        K = Realisation(*unpacked(theta * back, k))
        value, omega = self._peak(K, self.frequency if dt else self.frequency / rate, bool(dt), dt)
        G = np.zeros_like(theta)
        if not np.isfinite(value):
            return np.inf, G
        if not k or (not np.isfinite(omega) and not dt):
            left, _, right = np.linalg.svd(K.D)
            G[k:, k:] = np.outer(left[:, 0], right[0])
            return value / self.gain - 1, G / self.gain * back
        shifted = resolvent_point(omega, bool(dt)) * np.eye(k) - K.A
        left, _, right = np.linalg.svd(K.C @ np.linalg.solve(shifted, K.B + 0j) + K.D)
        u, v = left[:, 0], right[0].conj()
        row = np.append(np.linalg.solve(shifted.T, K.C.T @ u.conj()), u.conj())
        column = np.append(np.linalg.solve(shifted, K.B @ v), v)
        return value / self.gain - 1, np.real(np.outer(row, column)) / self.gain * back
