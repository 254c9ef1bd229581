"""The simulated experiments of the thesis (Březina 2010, 8.2.1, 9.1.3, 10.3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.control.platform import SineTrajectory, TrajectoryFollowing, closed_loop, follow, two_layer
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.statespace import StateSpaceModel

LOW = (0.0, 0.0, 0.1062, 0.0, 0.0, 0.0)
TORQUE, HERTZ = 0.1, 2.0  # N m, Hz; the sine of sections 8.2.1 and 10.3.1
UP_TO = 0.0577  # s; chosen: the only duration that fits items 13 and 16-18 with that sine
TIE = 1e-4  # relative difference of the largest changes up to which two ends are equally bad
SIGNED = {1: "+I", -1: "-I"}
# Wide limits: the run must continue beyond the workspace.
WIDE = {"L_min": 0.10, "L_max": 0.25}
LINK = ("link_mass", "link_I", "link_J", "link_K")
BODIES = tuple(f"{b}_{k}" for b in ("link", "nut", "screw", "motor") for k in ("mass", *"IJK"))
ALL = (*BODIES, "platform_mass", "platform_x", "platform_y", "platform_z")


# --- a sine of torque on all motors ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SineRun:
    """The platform from rest at home under the holding torque plus one sine of torque on all six motors."""

    # of the sine in N m and Hz
    amplitude: float
    frequency: float
    t: Array  # times in s, (n,)
    # nut angles and rates (n, 12) of the machine, and of its linear model at home
    nonlinear: Array
    linear: Array
    # height z of the platform (n,) and actuator lengths (n, 6) of the nonlinear run, in m
    height: Array
    lengths: Array

    def when_height(self, z: float) -> float:
        """Return the first time in s at which the platform reaches the height z, interpolated, or infinity."""
        return _first_time(self.t, self.height, z)

    def when_length(self, length: float) -> float:
        """Return the first time in s at which an actuator reaches ``length``."""
        return _first_time(self.t, self.lengths.max(axis=1), length)

    def percent(self, until: float = math.inf) -> tuple[Array, Array, Array]:
        """Return times, and linear minus nonlinear angle and rate of nut 1 in percent of the largest one."""
        n = int(np.searchsorted(self.t, until, side="right"))
        true, gap = self.nonlinear[:n], (self.linear - self.nonlinear)[:n]
        share = 100 * gap[:, [0, 6]] / np.abs(true[:, [0, 6]]).max(axis=0)
        return self.t[:n], share[:, 0], share[:, 1]


def sine_run(plant: StewartPlatform, amplitude: float, frequency: float, duration: float, points: int) -> SineRun:
    """Simulate the nonlinear and linear response without the machine's limits of length."""
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
    pair = slice(max(int(beyond[0]) - 1, 0), int(beyond[0]) + 1)
    return float(np.interp(level, values[pair], t[pair]))


# --- perturbed machines ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """A case of section 10.3.1: nominal and perturbed linear models and holding torques.

    They are connected by one real parameter, Delta = delta I: nominal at 0, perturbed at +I, mirrored at -I.
    """

    # for example ``"2a"``, and the change
    name: str
    words: str
    published: float  # the thesis' largest deviation in percent
    published_worst: int  # the thesis' worst Delta: 1 for +I, -1 for -I
    # interpretation, chosen for each case. True: the perturbed machine has the holding torque of the nominal one;
    # False: each machine is trimmed
    held: bool
    nominal: StateSpaceModel
    perturbed: StateSpaceModel
    released: float  # holding torque of the nominal machine minus that of the perturbed one in N m

    @property
    def gain_percent(self) -> float:
        """Change of B in percent: change of the nuts' acceleration by equal torques."""
        return 100 * float(self.perturbed.B.sum() / self.nominal.B.sum() - 1)

    def with_gravity(self) -> tuple[StateSpaceModel, StateSpaceModel]:
        """Return both models with one more input, ``gravity`` (figure 10.5): 1 if the torque is held."""
        return _with_gravity(self.nominal, 0.0), _with_gravity(self.perturbed, self.released)

    def excitation(self, held: bool | None = None) -> tuple[Array, Array]:
        """Return times (n,) up to 57.7 ms, and inputs (n, 7): 0.1 N m at 2 Hz on all motors, and gravity."""
        t = np.linspace(0.0, UP_TO, 201)
        sine = np.tile(TORQUE * np.sin(2 * math.pi * HERTZ * t)[:, None], 6)
        return t, np.column_stack([sine, np.full(len(t), float(self.held if held is None else held))])

    def changes(self, held: bool | None = None) -> tuple[float, float]:
        """Return the signed largest change of the angle of nut 1 at Delta = +I and -I, in percent of the nominal one.

        ``held``: default: the case's own interpretation.
        """
        (nominal, perturbed), (t, u) = self.with_gravity(), self.excitation(held)
        a, b, c, d = (2 * getattr(nominal, m) - getattr(perturbed, m) for m in "ABCD")
        mirrored = StateSpaceModel(a, b, c, d, nominal.dt, nominal.inputs, nominal.outputs, nominal.states)
        angle, *others = (simulate(m, t, u, hold="foh")["phi_1"] for m in (nominal, perturbed, mirrored))
        shares = [100 * (other - angle) / np.abs(angle).max() for other in others]
        plus, minus = (float(share[np.abs(share).argmax()]) for share in shares)
        return plus, minus

    @property
    def largest_percent(self) -> float:
        """Largest change of the angle of nut 1 at the worst Delta in percent."""
        plus, minus = self.changes()
        return abs(plus if self.worst > 0 else minus)

    @property
    def tie(self) -> bool:
        """Whether both ends are equally bad."""
        plus, minus = map(abs, self.changes())
        return abs(plus - minus) <= TIE * max(plus, minus)

    @property
    def worst(self) -> int:
        """Worst Delta: 1 for +I, -1 for -I; of equally bad ends that with the larger nut angle."""
        plus, minus = self.changes()
        return 1 if (plus > minus if self.tie else abs(plus) > abs(minus)) else -1

    @property
    def worst_in_words(self) -> str:
        """The worst Delta, the changes at both ends, and the thesis' worst Delta."""
        plus, minus = self.changes()
        why = "; equally bad to four digits, there the nut moves further" if self.tie else ""
        text = f"worst Δ = {SIGNED[self.worst]} (+I {plus:+.4g} %, -I {minus:+.4g} %{why})"
        return f"{text}; the thesis has {SIGNED[self.published_worst]}"


def cases(plant: StewartPlatform) -> tuple[Case, ...]:
    """Return cases 1 (20 mm lower), 2a and 2b (lower link heavier), 2c (everything heavier)."""
    home, low = trim(plant), trim(plant, pose=LOW)
    nominal = linearise(plant, home)
    lowered = linearise(plant, low)
    made = [Case("1", "z = 0.1062 m", 1.13, 1, False, nominal, lowered, float(home.u[0] - low.u[0]))]
    changes = (
        ("2a", "lower link +2.5 %", 0.014, 1.025, LINK),
        ("2b", "lower link +10 %", 0.060, 1.10, LINK),
        ("2c", "all bodies +2.5 %", 2.54, 1.025, ALL),
    )
    for name, words, published, factor, parameters in changes:
        heavy = plant.with_parameters(**{name: factor * plant.values[name] for name in parameters})
        rest = trim(heavy)
        released = float(home.u[0] - rest.u[0])
        made.append(Case(name, words, published, -1, True, nominal, linearise(heavy, rest), released))
    return tuple(made)


def _with_gravity(model: StateSpaceModel, torque: float) -> StateSpaceModel:
    """Return the model with one more input, ``gravity``, that acts like ``torque`` on every motor."""
    b = np.hstack([model.B, torque * model.B.sum(axis=1, keepdims=True)])
    d = np.hstack([model.D, torque * model.D.sum(axis=1, keepdims=True)])
    inputs = [*model.inputs, ("gravity", "1")]
    return StateSpaceModel(model.A, b, model.C, d, model.dt, inputs, model.outputs, model.states)


# --- the controlled machine ------------------------------------------------------------------------------------------


def track(plant: StewartPlatform, signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1)) -> TrajectoryFollowing:
    """Simulate 5 s of section 9.1.3 with the poles 236 and 3000 /s: a lift of 2 s, then sines with the given signs."""
    amplitude = np.array([5e-3] * 3 + [20e-3] * 3) * signs
    path = SineTrajectory(plant.geometry.home, amplitude=amplitude)
    return follow(plant, two_layer(plant), path, np.linspace(0.0, 5.0, 2501))


def lowest_stable_pole(plant: StewartPlatform) -> float:
    """Return the lower layer's pole in 1/s, from 1000 to 3000, at which the linear loop becomes stable."""
    low, high = 1000.0, 3000.0
    while high - low > 1.0:
        middle = (low + high) / 2
        stable = closed_loop(plant, two_layer(plant, p_low=middle)).poles().real.max() < 0
        low, high = (low, middle) if stable else (middle, high)
    return high
