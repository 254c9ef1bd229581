"""The simulated experiments of the thesis: a sine of torque on all motors, perturbed machines, the controlled machine.

References
----------
Březina 2010, sections 8.2.1 (linear against nonlinear), 9.1.3 (tracking), 10.3.1 (cases 1, 2a, 2b, 2c).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.dynamics.controllers import closed_loop, two_layer
from robustlab.dynamics.linearisation import linearise
from robustlab.dynamics.plant_contract import Array
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.dynamics.trajectory import SineTrajectory
from robustlab.dynamics.trajectory_following import TrajectoryFollowing, follow
from robustlab.dynamics.trimming import trim
from robustlab.statespace import StateSpaceModel

__all__ = ["Case", "SineRun", "cases", "lowest_stable_pole", "sine_run", "track"]

LOW = (0.0, 0.0, 0.1062, 0.0, 0.0, 0.0)
# Wide limits: where the machine leaves its workspace is read from the run instead of ending it.
WIDE = {"L_min": 0.10, "L_max": 0.25}
LINK = ("link_mass", "link_I", "link_J", "link_K")
BODIES = tuple(f"{b}_{k}" for b in ("link", "nut", "screw", "motor") for k in ("mass", *"IJK"))
ALL = (*BODIES, "platform_mass", "platform_x", "platform_y", "platform_z")


# --- a sine of torque on all motors ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SineRun:
    """The platform from rest at home under the holding torque plus one sine of torque on all six motors.

    Attributes
    ----------
    amplitude, frequency
        Of the sine in N m and Hz.
    t
        Times in s, (n,).
    nonlinear, linear
        Nut angles and rates (n, 12) of the machine, and of its linear model at home.
    height, lengths
        Height z of the platform (n,) and actuator lengths (n, 6) of the nonlinear run, in m.
    """

    amplitude: float
    frequency: float
    t: Array
    nonlinear: Array
    linear: Array
    height: Array
    lengths: Array

    def when_height(self, z: float) -> float:
        """First time in s at which the platform is as high as z, interpolated; infinite where it never is."""
        return _first_time(self.t, self.height, z)

    def when_length(self, length: float) -> float:
        """First time in s at which an actuator is as long as ``length``."""
        return _first_time(self.t, self.lengths.max(axis=1), length)

    def percent(self, until: float = math.inf) -> tuple[Array, Array, Array]:
        """Linear minus nonlinear in percent of the largest nonlinear value up to then: times, angle, rate of nut 1."""
        n = int(np.searchsorted(self.t, until, side="right"))
        true, gap = self.nonlinear[:n], (self.linear - self.nonlinear)[:n]
        share = 100 * gap[:, [0, 6]] / np.abs(true[:, [0, 6]]).max(axis=0)
        return self.t[:n], share[:, 0], share[:, 1]

    def to_json(self) -> dict[str, Any]:
        """All arrays."""
        return dict(vars(self))


def sine_run(plant: StewartPlatform, amplitude: float, frequency: float, duration: float, points: int) -> SineRun:
    """Nonlinear and linear response; the machine's limits of length are not applied."""
    machine = plant.with_parameters(**WIDE)
    t, rest = np.linspace(0.0, duration, points), trim(machine)
    u = np.tile(amplitude * np.sin(2 * math.pi * frequency * t)[:, None], 6)
    true = simulate(machine, t, rest.u + u, rest.x, hold="spline")
    near = simulate(linearise(machine, rest), t, u, hold="foh")
    names = [s.name for s in machine.outputs]
    nonlinear, linear = (np.column_stack([record[name] for name in names]) for record in (true, near))
    lengths = machine.geometry.home_lengths + nonlinear[:, :6] / machine.geometry.turns
    height = machine.poses(nonlinear[:, :6])[:, 2]
    return SineRun(amplitude, frequency, t, nonlinear, linear, height, lengths)


def _first_time(t: Array, values: Array, level: float) -> float:
    beyond = np.flatnonzero(values >= level)
    if not len(beyond):
        return math.inf
    k = int(beyond[0])
    if k == 0:
        return float(t[0])
    share = (level - values[k - 1]) / (values[k] - values[k - 1])
    return float(t[k - 1] + share * (t[k] - t[k - 1]))


# --- perturbed machines ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """A case of section 10.3.1: the nominal linear model, the perturbed one, and what holds them.

    Attributes
    ----------
    name, words
        For example ``"2a"`` and what was changed.
    published
        The thesis' largest deviation in percent.
    nominal, perturbed
        Linear models.
    released
        Holding torque of the nominal machine minus that of the perturbed one in N m: the constant input that the
        perturbed machine feels where the torque stays as it was.
    """

    name: str
    words: str
    published: float
    nominal: StateSpaceModel
    perturbed: StateSpaceModel
    released: float

    @property
    def gain_percent(self) -> float:
        """Change of B in percent: of the acceleration of the nuts by equal torques."""
        return 100 * float(self.perturbed.B.sum() / self.nominal.B.sum() - 1)

    def final_percent(self, t_end: float, amplitude: float, frequency: float, held: bool) -> float:
        """Change of the angle of nut 1 at ``t_end`` in percent after a sine of torque.

        Parameters
        ----------
        held
            True: the torque stays what holds the nominal machine, while gravity pulls at the perturbed one.
        """
        t = np.linspace(0.0, t_end, 401)
        sine = np.tile(amplitude * np.sin(2 * math.pi * frequency * t)[:, None], 6)
        angles = [
            simulate(model, t, sine + extra, hold="foh")["phi_1"][-1]
            for model, extra in ((self.nominal, 0.0), (self.perturbed, self.released if held else 0.0))
        ]
        return 100 * float(angles[1] / angles[0] - 1)

    def to_json(self) -> dict[str, Any]:
        """Names, numbers, and the matrices that differ."""
        matrices = {f"{name}_{m}": getattr(getattr(self, name), m) for name in ("nominal", "perturbed") for m in "AB"}
        told = {key: vars(self)[key] for key in ("name", "words", "published", "released")}
        return {**told, "gain_percent": self.gain_percent, **matrices}


def cases(plant: StewartPlatform) -> tuple[Case, ...]:
    """Cases 1 (20 mm lower), 2a and 2b (lower link heavier), 2c (everything heavier)."""
    home, low = trim(plant), trim(plant, pose=LOW)
    nominal = linearise(plant, home)
    made = [Case("1", "z = 0.1062 m", 1.13, nominal, linearise(plant, low), float(home.u[0] - low.u[0]))]
    changes = (
        ("2a", "lower link +2.5 %", 0.014, 1.025, LINK),
        ("2b", "lower link +10 %", 0.060, 1.10, LINK),
        ("2c", "all bodies +2.5 %", 2.54, 1.025, ALL),
    )
    for name, words, published, factor, parameters in changes:
        heavy = plant.with_parameters(**_scaled(plant, factor, parameters))
        rest = trim(heavy)
        made.append(Case(name, words, published, nominal, linearise(heavy, rest), float(home.u[0] - rest.u[0])))
    return tuple(made)


def _scaled(plant: StewartPlatform, factor: float, names: tuple[str, ...]) -> Mapping[str, float]:
    return {name: factor * plant.values[name] for name in names}


# --- the controlled machine ------------------------------------------------------------------------------------------


def track(plant: StewartPlatform, signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1)) -> TrajectoryFollowing:
    """Five seconds of section 9.1.3 with the poles 236 and 3000 /s: a lift of 2 s, then sines with the given signs."""
    amplitude = np.array([5e-3] * 3 + [20e-3] * 3) * signs
    path = SineTrajectory(plant.geometry.home, amplitude=amplitude)
    return follow(plant, two_layer(plant), path, np.linspace(0.0, 5.0, 2501))


def lowest_stable_pole(plant: StewartPlatform, low: float = 1000.0, high: float = 3000.0) -> float:
    """Where the linear loop becomes stable as the lower layer's pole in 1/s grows from ``low`` to ``high``; to 1 /s."""
    while high - low > 1.0:
        middle = (low + high) / 2
        stable = closed_loop(plant, two_layer(plant, p_low=middle)).poles().real.max() < 0
        low, high = (low, middle) if stable else (middle, high)
    return high
