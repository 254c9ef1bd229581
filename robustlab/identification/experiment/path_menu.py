r"""Paths of a platform's pose to choose an experiment from, each as large as the machine allows.

.. math:: p_j(t) = h_j + s\, e(t)\, a_j \sum_i w_{ij}(t) \sin\bigl(\omega_{ij} \theta_i(t) + \psi_{ij}\bigr)

about a pose h, with sizes a of the six coordinates that move the legs alike, an envelope e that begins and ends at
rest, and one scale s: the largest with which legs stay within their range, nuts within the largest speed and their
torques within the largest acceleration. All frequencies are fixed: the same menu for the same machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.dynamics.stewart.kinematics import direct_kinematics, nut_angles

SIZES = np.array([1.0, 1.0, 0.9, 5.0, 5.0, 7.0])  # of the coordinates: so many rad move the legs as far as one metre
LARGEST = 0.05  # m, with s = 1
EDGE = 0.4  # s in which a path begins and ends
HALVINGS = 14  # of the interval of s
MARGIN = 0.9  # of each limit
SLOW, WANDER = "slow reversals", 0.4  # the path of a pose that wanders, and what share of its size it then has


@dataclass(frozen=True)
class PathLimits:
    """Largest speed of each joint in rad/s, (6,), its largest acceleration in rad/s2, (6,), and of its angle the range
    (6, 2) in rad.
    """

    speed: Array
    acceleration: Array
    reach: Array


@dataclass(frozen=True, eq=False)
class PosePath:
    """One path: what it is in words, poses (n, 6) in m and rad, the joints' angles (n, 6) in rad."""

    name: str
    words: str
    poses: Array
    angles: Array

    def smaller(self, geometry: Geometry, share: float) -> PosePath:
        """The same path with all angles' deviations from its first pose times a share."""
        angles = self.angles[0] + share * (self.angles - self.angles[0])
        poses = direct_kinematics(geometry, geometry.home_lengths + angles / geometry.turns, self.poses[0]).poses
        return replace(self, poses=np.asarray(poses), angles=angles)

    def samples(self, dt: float) -> tuple[Array, Array]:
        """Speeds and accelerations of the joints, (n, 6) each."""
        speed = np.gradient(self.angles, dt, axis=0)
        return speed, np.gradient(speed, dt, axis=0)


Waves = Callable[[Array], Array]  # times (n,) -> six coordinates of size one at most, (n, 6)


def _sines(low: float, high: float, count: int, turn: int = 0) -> Waves:
    """Sums of ``count`` sines a coordinate between two frequencies in Hz, no two of them alike."""
    grid = np.geomspace(low, high, 6 * count)
    order = np.argsort(((np.arange(6 * count) + turn) * 7) % (6 * count + 1), kind="stable")
    frequency = 2.0 * np.pi * grid[order].reshape(6, count)
    phase = np.pi * np.arange(6 * count).reshape(6, count) ** 2 / (3.0 * count)

    def of(t: Array) -> Array:
        waves = np.sin(frequency[:, :, None] * t + phase[:, :, None]) / np.sqrt(frequency / frequency.min())[:, :, None]
        return waves.sum(axis=1).T / count

    return of


def _rests(moving: Waves, period: float) -> Waves:
    """The motion, which stands still for the second half of each period: its own time is held."""

    def of(t: Array) -> Array:
        gate = 0.5 - 0.5 * np.tanh(8.0 * np.sin(2.0 * np.pi * t / period - 0.5 * np.pi))
        own = np.concatenate([[0.0], np.cumsum(0.5 * (gate[1:] + gate[:-1]) * np.diff(t))])
        return moving(own)

    return of


def _sweep(low: float, high: float) -> Waves:
    """A sweep whose direction goes through the six coordinates, each a sixth of a turn behind the one before."""

    def of(t: Array) -> Array:
        rate = np.log(high / low) / max(t[-1], 1e-9)
        angle = 2.0 * np.pi * low * np.expm1(rate * t) / rate
        size = np.exp(-0.5 * rate * t)  # the speed grows by half as much as the frequency
        return size[:, None] * np.sin(angle[:, None] * (1.0 + 0.04 * np.arange(6)) + np.pi * np.arange(6) / 3.0)

    return of


def _turns(period: float) -> Waves:
    """To and fro with accelerations of one size, smoothed: as fast away as the motors can, and back."""

    def of(t: Array) -> Array:
        angle = 2.0 * np.pi * t[:, None] / period * (1.0 + 0.11 * np.arange(6)) + np.pi * np.arange(6) / 3.0
        saw = np.sin(angle) - np.sin(3.0 * angle) / 27.0 + np.sin(5.0 * angle) / 125.0  # of parabolas
        return np.asarray(saw)

    return of


def menu() -> Mapping[str, tuple[str, Waves]]:
    """Name -> words and waves."""
    slow, shake = _sines(0.15, 0.5, 2), _sines(4.0, 8.0, 2)
    return {
        "slow reversals": ("sines of 0.15 to 0.5 Hz in all six coordinates, every leg turns round slowly", slow),
        "slow with rests": ("the slow sines, at rest for every other second", _rests(slow, 2.0)),
        "usual": ("sines of 0.5 to 2 Hz in all six coordinates", _sines(0.5, 2.0, 2, 3)),
        "quick": ("sines of 2 to 5 Hz in all six coordinates", _sines(2.0, 5.0, 2, 5)),
        "shake": ("sines of 4 to 8 Hz in all six coordinates, small and with large accelerations", shake),
        "to and fro": ("to and fro once in 0.5 s, with accelerations of one size", _turns(0.5)),
        "sweep": ("a sweep from 0.5 to 10 Hz through all six coordinates", _sweep(0.5, 10.0)),
    }


def alone() -> Mapping[str, tuple[str, Waves]]:
    """The same of a leg that moves by itself."""
    return {
        "usual": ("sines of 0.5 to 2 Hz", _sines(0.5, 2.0, 2, 3)),
        "quick": ("sines of 2 to 5 Hz", _sines(2.0, 5.0, 2, 5)),
        "shake": ("sines of 4 to 8 Hz", _sines(4.0, 8.0, 2)),
    }


def paths(
    geometry: Geometry, about: Array, limits: PathLimits, n: int, dt: float, legs: Sequence[int] = ()
) -> list[PosePath]:
    """The menu about a pose (6,), ``n`` samples of ``dt`` s each, and of each of the ``legs`` (0..5) its own motion.

    A path that no scale allows is left out.
    """
    t = np.arange(n) * dt
    edge = np.clip(np.minimum(t, t[-1] - t) / EDGE, 0.0, 1.0)[:, None]
    envelope = edge**3 * (10.0 - 15.0 * edge + 6.0 * edge**2)
    found = []
    for name, (words, waves) in menu().items():
        shape = LARGEST * SIZES * envelope * waves(t)
        scale = _largest(lambda s, shape=shape: nut_angles(geometry, about + s * shape), geometry, limits, dt)
        poses = about + scale * shape
        found += [PosePath(name, words, poses, nut_angles(geometry, poses))] if scale > 0.0 else []
    return [*found, *_of_legs(geometry, about, limits, t, envelope, legs)]


def _of_legs(
    geometry: Geometry, about: Array, limits: PathLimits, t: Array, envelope: Array, legs: Sequence[int]
) -> list[PosePath]:
    """Each leg by itself, while the pose wanders: where a joint stood still, its sensor would show noise alone."""
    found, dt = [], float(t[1] - t[0])
    wander = LARGEST * SIZES * envelope * menu()[SLOW][1](t)
    scale = WANDER * _largest(lambda s: nut_angles(geometry, about + s * wander), geometry, limits, dt)
    base = nut_angles(geometry, about + scale * wander)
    for leg in legs if scale > 0.0 else ():
        for name, (words, waves) in alone().items():
            shape = np.zeros_like(base)
            shape[:, leg] = LARGEST * geometry.turns * (envelope * waves(t))[:, leg]
            share = _largest(lambda s, shape=shape: base + s * shape, geometry, limits, dt)
            if share > 0.0:
                angles = base + share * shape
                poses = direct_kinematics(geometry, geometry.home_lengths + angles / geometry.turns, about).poses
                text = f"leg {leg + 1} moves by itself, {words}, while the pose wanders slowly"
                found.append(PosePath(f"leg {leg + 1} {name}", text, np.asarray(poses), angles))
    return found


def _largest(angles: Callable[[float], Array], geometry: Geometry, limits: PathLimits, dt: float) -> float:
    """The largest scale that keeps the limits, by halving."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _fits(angles(middle), geometry, limits, dt) else (low, middle)
    return low


def _fits(angles: Array, geometry: Geometry, limits: PathLimits, dt: float) -> bool:
    lengths = geometry.home_lengths + angles / geometry.turns
    speed = np.gradient(angles, dt, axis=0)
    acceleration = np.gradient(speed, dt, axis=0)
    return bool(
        (lengths >= geometry.limits[0]).all()
        and (lengths <= geometry.limits[1]).all()
        and (angles >= limits.reach[:, 0]).all()
        and (angles <= limits.reach[:, 1]).all()
        and (np.abs(speed) <= MARGIN * limits.speed).all()
        and (np.abs(acceleration) <= MARGIN * limits.acceleration).all()
    )
