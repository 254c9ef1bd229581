"""The simulated experiments of the thesis (Březina 2010), and comparison with all its numbers (``numbers.toml``).

The key of a row begins with the number of the item. Its status: R, reproduced within ``tolerance`` or the bound. F,
fitted: a value that is not printed was chosen for agreement. P, reproduced in part, or under the interpretation in
``why``. N, not reproducible for the reason in ``why``. Rows without a published value: omissions of the thesis.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.control.platform import SineTrajectory, TrajectoryFollowing, closed_loop, follow, two_layer
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plants.linear import dc_motor, linear_actuator
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform, inverse_kinematics, stewart_platform
from robustlab.linear_analysis.structural import controllability, drop_unconnected, observability
from robustlab.result import Status
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
# Appendix B in mm, without the misprints of b6 (y 114,5) and of m2, m3 (x 163,3).
BASE = ((165.3, -57.4), (32.9, 171.9), (-32.9, 171.9), (-165.3, -57.4), (-132.4, -114.5), (132.4, -114.5))
PLATFORM_Y = (75.8, 113.0, 113.0, 75.8)
BEARING = (16.33, 175.4)  # m2; m3 is its mirror image
MAKER_SPEED = 7530 * 2 * math.pi / 60


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


def first_time(t: Array, values: Array, level: float) -> float:
    """Return the first time at which the values reach the level, interpolated, or infinity."""
    beyond = np.flatnonzero(values >= level)
    if not len(beyond):
        return math.inf
    pair = slice(max(int(beyond[0]) - 1, 0), int(beyond[0]) + 1)
    return float(np.interp(level, values[pair], t[pair]))


@dataclass(frozen=True, eq=False)
class Case:
    """A case of section 10.3.1: nominal (Delta = 0) and perturbed (Delta = +I) linear models and holding torques."""

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
        """Return both models with one more input, ``gravity`` (figure 10.5): 1 if the torque is held.

        It acts like the released torque on every motor of the perturbed machine.
        """
        made: list[StateSpaceModel] = []
        for m, torque in ((self.nominal, 0.0), (self.perturbed, self.released)):
            b, d = (np.hstack([part, torque * part.sum(axis=1, keepdims=True)]) for part in (m.B, m.D))
            made.append(StateSpaceModel(m.A, b, m.C, d, m.dt, [*m.inputs, ("gravity", "1")], m.outputs, m.states))
        return made[0], made[1]

    def excitation(self, held: bool | None = None) -> tuple[Array, Array]:
        """Return times (n,) up to 57.7 ms, and inputs (n, 7): 0.1 N m at 2 Hz on all motors, and gravity."""
        t = np.linspace(0.0, UP_TO, 201)
        sine = np.tile(TORQUE * np.sin(2 * math.pi * HERTZ * t)[:, None], 6)
        return t, np.column_stack([sine, np.full(len(t), float(self.held if held is None else held))])

    def changes(self, held: bool | None = None) -> tuple[float, float]:
        """Return the signed largest change of the angle of nut 1 at Delta = +I and -I, in percent."""
        (nominal, perturbed), (t, u) = self.with_gravity(), self.excitation(held)
        a, b, c, d = (2 * getattr(nominal, m) - getattr(perturbed, m) for m in "ABCD")
        mirrored = StateSpaceModel(a, b, c, d, nominal.dt, nominal.inputs, nominal.outputs, nominal.states)
        angle, *others = (simulate(m, t, u, hold="foh")["phi_1"] for m in (nominal, perturbed, mirrored))
        shares = [100 * (other - angle) / np.abs(angle).max() for other in others]
        plus, minus = (float(share[np.abs(share).argmax()]) for share in shares)
        return plus, minus

    @property
    def largest_percent(self) -> float:
        return abs(self.changes()[self.worst < 0])

    @property
    def tie(self) -> bool:
        plus, minus = map(abs, self.changes())
        return abs(plus - minus) <= TIE * max(plus, minus)

    @property
    def worst(self) -> int:
        """Worst Delta: 1 for +I, -1 for -I; of equally bad ends that with the larger nut angle."""
        plus, minus = self.changes()
        return 1 if (plus > minus if self.tie else abs(plus) > abs(minus)) else -1

    @property
    def worst_in_words(self) -> str:
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


@dataclass(frozen=True)
class PublishedNumber:
    """A published number and ours."""

    # number of the item, quantity, and place in the thesis
    key: str
    quantity: str
    where: str
    published: float | None
    ours: float | None
    unit: str  # of both and of the tolerance
    status: Literal["R", "F", "P", "N"]  # R, F, P or N, as in the module's description
    tolerance: float | None = None  # by the printed digits and the text; None if no agreement is expected
    why: str = ""  # interpretation, or reason why it is not reproducible
    bound: Literal["equal", "at most", "at least"] = "equal"  # "at most" and "at least": the thesis prints a limit

    @property
    def difference(self) -> float | None:
        return None if self.published is None or self.ours is None else self.ours - self.published

    @property
    def agrees(self) -> bool | None:
        """Agreement within the tolerance or the bound; None if not comparable."""
        if self.difference is None or self.tolerance is None:
            return None
        not_above = self.bound == "at least" or self.difference <= self.tolerance
        not_below = self.bound == "at most" or self.difference >= -self.tolerance
        return not_above and not_below

    def to_json(self) -> dict[str, Any]:
        return {**vars(self), "difference": self.difference, "agrees": self.agrees}


@dataclass(frozen=True, eq=False)
class PublishedNumbers:
    """All rows, and the runs behind them."""

    rows: dict[str, PublishedNumber]  # key -> row, in the order of the items
    sines: dict[str, SineRun]  # sine runs of section 8.2.1 by their reading
    cases: tuple[Case, ...]  # cases of section 10.3.1
    # runs of section 9.1.3: "thesis" and "rotors" with all signs of the sines +, "link-4" with the signs +++-+-
    tracking: dict[str, TrajectoryFollowing]
    status: Status = field(default=Status.CONVERGED)  # CONVERGED: everything was computed

    def with_status(self, status: str) -> list[PublishedNumber]:
        return [row for row in self.rows.values() if row.status == status]

    @property
    def disagreeing(self) -> list[str]:
        return [row.key for row in (*self.with_status("R"), *self.with_status("F")) if row.agrees is not True]

    def to_json(self) -> dict[str, Any]:
        return {"rows": {key: row.to_json() for key, row in self.rows.items()}}


def published_numbers() -> PublishedNumbers:
    """Compute all rows of items 1-29, and the runs behind them, in a few seconds."""
    plant = stewart_platform()
    sines = {
        "0.1 N m at 2 Hz": sine_run(plant, 0.1, 2.0, 0.078, 781),
        "1 mN m at 2 Hz": sine_run(plant, 1e-3, 2.0, 0.5, 1001),
        "0.1 N m at 20 Hz": sine_run(plant, 0.1, 20.0, 0.05, 501),
    }
    varied = cases(plant)
    thesis, physical = (stewart_platform(preset=name, motors=True) for name in ("thesis", "physical"))
    tracking = {"thesis": track(thesis), "link-4": track(thesis, (1, 1, 1, -1, 1, -1)), "rotors": track(physical)}
    found: dict[str, Any] = {
        **_geometry(plant), **_states(plant), **_motor(), **_jig(), **_sines(plant, sines), **_cases(varied),
        **_tracking(tracking), "25": lowest_stable_pole(thesis), "25-rotor": lowest_stable_pole(physical),
    }  # fmt: skip
    table: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    rows = {}
    for key, row in table.items():
        row["why"] = row.get("why", "").format(**found)
        ours = float(found[key]) if key in found else None
        given: dict[str, Any] = {"key": key, "published": None, "ours": ours, **row}
        rows[key] = PublishedNumber(**given)
    return PublishedNumbers(rows, sines, varied, tracking)


# The following functions return our numbers by the keys of the rows, and the values in their reasons.


def _geometry(plant: StewartPlatform) -> dict[str, Any]:
    g = plant.geometry
    z = np.linspace(0.10, 0.15, 5001)
    heights = np.append(z, [0.1462, 0.1062])[:, None] * np.eye(6)[2]
    lengths = inverse_kinematics(g, heights)[:, 0]
    longest, shortest = 1e3 * lengths[-2:]
    highest, lowest = 1e3 * np.interp([0.188, 0.159], lengths[:-2], z)
    # The printed m2 and m3, and the pair rotated by +-120 degrees.
    turn, pair = np.exp(2j * np.pi / 3), np.array([complex(*BEARING), complex(-BEARING[0], BEARING[1])])
    points = np.roll(np.outer([1, turn, 1 / turn], pair), 1).ravel()
    bearing = np.column_stack([points.real, points.imag])

    def gap(found: Array, table: Any) -> float:
        return float(np.abs(1e3 * found - np.array(table)).max())

    return {
        "1": gap(g.base[:, :2], BASE), "2": gap(g.platform[:4, 1], PLATFORM_Y),
        "3": gap(g.bearing[:, :2], bearing), "4-max": longest, "4-min": shortest, "5-max": highest,
        "5-min": lowest, "lowest": lowest, "6": plant.values["ratio"],
    }  # fmt: skip


def _states(plant: StewartPlatform) -> dict[str, Any]:
    model, motor = linearise(plant), _speed_motor()
    c, o, cm, om = (what(m).rank for m in (model, motor) for what in (controllability, observability))
    return {
        "7": float(trim(plant).u[0]), "12-states": model.n_states, "12-ctrb": c, "12-obsv": o,
        "12-motor": min(cm, om, motor.n_states),
    }  # fmt: skip


def _speed_motor(**parameters: float) -> Any:
    return drop_unconnected(dc_motor(**parameters).state_space().select(outputs=["omega", "i"]))


def _no_load(**parameters: float) -> tuple[float, float]:
    speed, current = 42.0 * _speed_motor(**parameters).dc_gain()[:, 0]
    return float(speed), float(current)


def _motor() -> dict[str, Any]:
    kf, r, k = 4.8e-5, 2.07, 0.052
    speed, current = _no_load()
    slow, fast = _no_load(Kf=1.35 * kf)[0], _no_load(Kf=0.65 * kf)[0]
    needed = (42 * k / 788.5 - k * k) / r  # friction with which the motor runs at 788.5 rad/s
    return {
        "8": speed, "9": MAKER_SPEED, "10": 100 * (MAKER_SPEED / speed - 1), "11": fast, "slow": slow, "fast": fast,
        "11-need": 100 * (needed / kf - 1), "29-friction": 0.0525 * 0.0927 / MAKER_SPEED, "29-current": current,
    }  # fmt: skip


def _jig_motion(motor: LinearPlant, heavier: float = 1.0) -> Array:
    """Return the largest motor angle, and steady and largest speed of the jig's link under 11.8 V at 1 Hz.

    It is driven by the torque of the ``motor`` with its nominal link, without back-EMF; ``heavier``: ratio of mass and
    inertia of the driven link to those of the nominal one.
    """
    model = motor.state_space()
    a, b = np.zeros((5, 5)), np.vstack([model.B, np.zeros((2, 1))])
    a[:3, :3] = model.A
    a[3, 4], a[4, :3] = 1.0, model.A[1] / heavier  # angle and speed of the driven link
    t = np.linspace(0.0, 1.0, 20001)
    names = ["phi", "omega", "i", "angle", "speed"]
    driven = StateSpaceModel(a, b, np.eye(5), np.zeros((5, 1)), outputs=names)
    record = simulate(driven, t, np.where(t < 0.5, 11.8, -11.8))
    return np.array([np.abs(record["angle"]).max(), record["speed"][t < 0.5][-1], np.abs(record["speed"]).max()])


def _jig() -> dict[str, Any]:
    """Return the remaining model errors of chapter 11, initially 11 and 12.5 %."""
    nominal = linear_actuator(J=0.0)
    base = _jig_motion(nominal)

    def left(found: Array) -> Array:
        """Return the first error by the angle, and the second by the steady and by the largest speed."""
        return 100 * (np.array([1.11, 1.125, 1.125]) * found / base - 1)

    sticky, slippery = (nominal.with_parameters(Kf=factor * 4.8e-5) for factor in (1.35, 0.65))
    less = _jig_motion(slippery)
    heavy = {name: 1.1 * nominal.values[name] for name in ("J_nut", "m_screw", "m_cart")}
    shares = {
        "27": _jig_motion(sticky), "27-less": less, "28": _jig_motion(nominal, 1.1),
        "28-volts": _jig_motion(nominal.with_parameters(**heavy)), "28-both": _jig_motion(sticky, 1.1),
    }  # fmt: skip
    found: dict[str, Any] = {}
    for key, motion in shares.items():
        found[f"{key}-first"], found[f"{key}-second"], _ = left(motion)
    found["more_peak"], found["both_peak"] = left(shares["27"])[2], left(shares["28-both"])[2]
    found["first_behind"], found["second_behind"] = (100 * (1 - x * less[0] / base[0]) for x in (0.89, 0.875))
    return found


def _sines(plant: StewartPlatform, runs: dict[str, SineRun]) -> dict[str, Any]:
    strong, weak, quick = runs["0.1 N m at 2 Hz"], runs["1 mN m at 2 Hz"], runs["0.1 N m at 20 Hz"]
    reached = first_time(strong.t, strong.height, 0.1407)
    left = first_time(strong.t, strong.lengths.max(axis=1), plant.values["L_max"])
    found: dict[str, Any] = {
        "13-20Hz": quick.height.max(), "13-1mNm": weak.height.max(), "19": reached, "reached": 1e3 * reached,
        "left": 1e3 * left,
    }  # fmt: skip
    for suffix, run, until in (("", strong, reached), ("-1mNm", weak, math.inf)):
        _, angle, rate = run.percent(until)
        found[f"14-angle{suffix}"], found[f"14-rate{suffix}"] = np.abs(angle).max(), np.abs(rate).max()
    return found


def _cases(varied: tuple[Case, ...]) -> dict[str, Any]:
    """Return rows 15-18, defined as in the cases' figures (`Case.largest_percent`)."""
    found: dict[str, Any] = {"15-gain": abs(varied[0].gain_percent)}
    for number, case in zip((15, 16, 17, 18), varied, strict=True):
        found |= {str(number): case.largest_percent, f"{number}-worst": case.worst}
        found |= {f"worst_{number}": case.worst_in_words, f"other_{number}": max(map(abs, case.changes(not case.held)))}
    return found


def _tracking(runs: dict[str, TrajectoryFollowing]) -> dict[str, Any]:
    plain, turned, rotors = (runs[name] for name in ("thesis", "link-4", "rotors"))
    error = plain.largest_error(after=3.0)

    def worst(values: Array) -> int:
        return int(values.argmax()) + 1

    return {
        "20": 1e3 * error[:3].max(), "21": 1e3 * error[3:].max(), "22": plain.largest_torque().max(),
        "22-signs": turned.largest_torque().max(), "22-rotor": rotors.largest_torque().max(),
        "22-smooth": rotors.largest_torque(after=3.0).max(), "23": plain.largest_voltage().max(),
        "23-signs": turned.largest_voltage().max(), "24-torque": worst(turned.largest_torque()),
        "24-voltage": worst(turned.largest_voltage()), "24-length": worst(turned.lengths.max(axis=0)),
        "longest": 1e3 * turned.lengths.max(), "all_plus": worst(plain.largest_torque()),
    }  # fmt: skip
