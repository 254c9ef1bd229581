"""Comparison with every number printed in the thesis (``numbers.toml``; Březina 2010), from parameters alone.

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
from robustlab.dynamics.control.platform import TrajectoryFollowing
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plants.linear import dc_motor, linear_actuator
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform, inverse_kinematics, stewart_platform
from robustlab.linear_analysis.structural import controllability, drop_unconnected, observability
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.thesis.runs import Case, SineRun, cases, lowest_stable_pole, sine_run, track

# Appendix B in mm, without the misprints of b6 (y 114,5) and of m2, m3 (x 163,3).
BASE = ((165.3, -57.4), (32.9, 171.9), (-32.9, 171.9), (-165.3, -57.4), (-132.4, -114.5), (132.4, -114.5))
PLATFORM_Y = (75.8, 113.0, 113.0, 75.8)
BEARING = (16.33, 175.4)  # m2; m3 is its mirror image
MAKER_SPEED = 7530 * 2 * math.pi / 60


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
        """Ours minus published."""
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
        """Return all fields, the difference, and the agreement."""
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
        """Return the rows of the status R, F, P or N."""
        return [row for row in self.rows.values() if row.status == status]

    @property
    def disagreeing(self) -> list[str]:
        """Keys of the rows with status R or F that do not agree."""
        return [row.key for row in (*self.with_status("R"), *self.with_status("F")) if row.agrees is not True]

    def to_json(self) -> dict[str, Any]:
        """Return the rows."""
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
    """Return the model from voltage to speed and current of the motor."""
    return drop_unconnected(dc_motor(**parameters).state_space().select(outputs=["omega", "i"]))


def _no_load(**parameters: float) -> tuple[float, float]:
    """Return speed in rad/s and current in A of the motor without load at 42 V."""
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
    reached, left = strong.when_height(0.1407), strong.when_length(plant.values["L_max"])
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
