"""Every number that the thesis prints about its machine, beside ours, computed from nothing but parameters.

The key of a row begins with the number of the item; ``status`` says what to expect:

- R: reproduced; our value must agree within ``tolerance``, or keep to the bound.
- F: fitted; a value that the text does not print was chosen so that this row agrees. It is no reproduction.
- P: reproduced in part, or only under the reading that ``why`` states.
- N: not reproducible from the text, for the reason in ``why``.

A row without a published value states what the thesis left out.

References
----------
Březina 2010; the place is given with each row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.control.platform import TrajectoryFollowing
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plants.motors import dc_motor, linear_actuator
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.kinematics import inverse_kinematics
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform, stewart_platform
from robustlab.linear_analysis.structural import controllability, drop_unconnected, observability
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.thesis.runs import UP_TO, Case, SineRun, cases, lowest_stable_pole, sine_run, track

# Appendix B in mm, without the misprints of b6 (y 114,5) and of m2, m3 (x 163,3).
BASE = ((165.3, -57.4), (32.9, 171.9), (-32.9, 171.9), (-165.3, -57.4), (-132.4, -114.5), (132.4, -114.5))
PLATFORM_Y = (75.8, 113.0, 113.0, 75.8)
BEARING = (16.33, 175.4)  # m2; m3 is its mirror image
MAKER_SPEED = 7530 * 2 * math.pi / 60
Bound = Literal["equal", "at most", "at least"]
RowStatus = Literal["R", "F", "P", "N"]


@dataclass(frozen=True)
class PublishedNumber:
    """A published number and ours."""

    # key, quantity, where: number of the item, what it is, and where it is printed
    key: str
    quantity: str
    where: str
    # published, ours: none where there is none
    published: float | None
    ours: float | None
    unit: str  # of both and of the tolerance
    status: RowStatus  # R, F, P or N, as in the module's description
    # fair difference, as far as the printed digits and the text go; None where no agreement is to be expected
    tolerance: float | None = None
    why: str = ""  # the reading, or why it is not reproducible
    bound: Bound = "equal"  # "at most" and "at least": the thesis prints a limit, and ours has to keep to it

    def __post_init__(self) -> None:
        if self.ours is not None:
            object.__setattr__(self, "ours", float(self.ours))

    @property
    def difference(self) -> float | None:
        """Ours minus published."""
        return None if self.published is None or self.ours is None else self.ours - self.published

    @property
    def agrees(self) -> bool | None:
        """Whether it agrees within the tolerance, or keeps to the bound; None where neither can be said."""
        if self.difference is None or self.tolerance is None:
            return None
        not_above = self.bound == "at least" or self.difference <= self.tolerance
        not_below = self.bound == "at most" or self.difference >= -self.tolerance
        return not_above and not_below

    def to_json(self) -> dict[str, Any]:
        """All fields, the difference, and whether it agrees."""
        return {**vars(self), "difference": self.difference, "agrees": self.agrees}


@dataclass(frozen=True, eq=False)
class PublishedNumbers:
    """All rows, and the runs that they were read from."""

    rows: dict[str, PublishedNumber]  # key -> row, in the order of the items
    sines: dict[str, SineRun]  # sine runs of section 8.2.1 by their reading
    cases: tuple[Case, ...]  # cases of section 10.3.1
    # runs of section 9.1.3: "thesis" and "rotors" with all signs of the sines +, "link-4" with the signs +++-+-
    tracking: dict[str, TrajectoryFollowing]
    status: Status = field(default=Status.CONVERGED)  # CONVERGED: everything was computed

    def with_status(self, status: str) -> list[PublishedNumber]:
        """Rows of the status R, F, P or N."""
        return [row for row in self.rows.values() if row.status == status]

    @property
    def disagreeing(self) -> list[str]:
        """Keys of the rows that are said to be reproduced or fitted, and are not."""
        return [row.key for row in (*self.with_status("R"), *self.with_status("F")) if row.agrees is not True]

    def table(self) -> str:
        """The rows as text, the reason below each row that has one."""
        lines = [f"{'item':<14}{'published':>12}{'ours':>14}{'difference':>13}  {'unit':<10} st  quantity (where)"]
        for r in self.rows.values():
            published, ours, gap = (_cell(v) for v in (r.published, r.ours, r.difference))
            sign = {"equal": "", "at most": "<= ", "at least": ">= "}[r.bound]
            lines.append(
                f"{r.key:<14}{sign + published:>12}{ours:>14}{gap:>13}  {r.unit:<10} {r.status}   "
                f"{r.quantity} ({r.where})"
            )
            if r.why:
                lines.append(f"{'':<14}  {r.why}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Rows, cases and sine runs; of the tracking runs what the rows need."""
        tracking = {name: {"t": run.t, "error": run.error, "torque": run.torque, "voltage": run.voltage}
                    for name, run in self.tracking.items()}  # fmt: skip
        rows = {key: row.to_json() for key, row in self.rows.items()}
        sines = {name: run.to_json() for name, run in self.sines.items()}
        return {"rows": rows, "sines": sines, "cases": {c.name: c.to_json() for c in self.cases}, "tracking": tracking}


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def published_numbers() -> PublishedNumbers:
    """Compute every row; a few seconds.

    Returns
    -------
    PublishedNumbers
        Rows of items 1-29 and the runs behind them.

    Examples
    --------
    >>> found = published_numbers()  # doctest: +SKIP
    >>> found.rows["7"].published, found.disagreeing  # doctest: +SKIP
    (0.0008701, [])
    """
    plant = stewart_platform()
    sines = {
        "0.1 N m at 2 Hz": sine_run(plant, 0.1, 2.0, 0.078, 781),
        "1 mN m at 2 Hz": sine_run(plant, 1e-3, 2.0, 0.5, 1001),
        "0.1 N m at 20 Hz": sine_run(plant, 0.1, 20.0, 0.05, 501),
    }
    varied = cases(plant)
    thesis, physical = (stewart_platform(preset=name, motors=True) for name in ("thesis", "physical"))
    tracking = {"thesis": track(thesis), "link-4": track(thesis, (1, 1, 1, -1, 1, -1)), "rotors": track(physical)}
    rows = [
        *_geometry_rows(plant),
        *_motor_rows(),
        *_state_rows(plant),
        *_sine_rows(plant, sines),
        *_case_rows(varied),
        *_tracking_rows(tracking),
        *_pole_rows(thesis, physical),
        *_jig_rows(),
    ]
    rows.sort(key=lambda row: int(row.key.partition("-")[0]))
    return PublishedNumbers({row.key: row for row in rows}, sines, varied, tracking)


# --- chapter 6: geometry; 8.2: holding torque and states -------------------------------------------------------------


def _geometry_rows(plant: StewartPlatform) -> list[PublishedNumber]:
    g, row = plant.geometry, PublishedNumber
    poses = np.zeros((2, 6))
    poses[:, 2] = 0.1462, 0.1062
    longest, shortest = 1e3 * inverse_kinematics(g, poses)[:, 0]
    z = np.linspace(0.10, 0.15, 5001)
    heights = np.zeros((len(z), 6))
    heights[:, 2] = z
    highest, lowest = 1e3 * np.interp([0.188, 0.159], inverse_kinematics(g, heights)[:, 0], z)

    def gap(found: Array, table: Any) -> float:
        return float(np.abs(1e3 * found - np.array(table)).max())

    return [
        row("1", "base points: largest distance of a coordinate from the table", "6.1, App. B", 0.0,
            gap(g.base[:, :2], BASE), "mm", "R", 0.06, "b6 y is misprinted: 114,5 must be -114,5"),
        row("2", "platform points p1-p4, y: largest distance from the table", "6.2, App. B", 0.0,
            gap(g.platform[:4, 1], PLATFORM_Y), "mm",
            "R", 0.065, "the table has 113 where the formula gives 112.936; hence 0.065 mm and not 0.06"),
        row("3", "bearing points: largest distance of a coordinate of all six from the table", "App. B", 0.0,
            gap(g.bearing[:, :2], _bearing_table()), "mm", "R", 0.06,
            "m2, m3 are printed as 163,3; 175,4: the x is misprinted, it must be 16,33. m1, m4-m6 are judged against "
            "that pair turned by 120 degrees"),
        row("4-max", "longest actuator, z = 0.1462 m", "6.1.1", 188.0, longest, "mm", "R", 0.1),
        row("4-min", "shortest actuator, z = 0.1062 m", "6.1.1", 159.0, shortest, "mm", "P", 1.8,
            f"159 mm is z = {lowest:.1f} mm; the plain joint is 10 mm longer throughout"),
        row("5-max", "height at which the actuators are 188 mm long", "8.2.1, 10.3.1", 146.2, highest, "mm", "R", 0.1),
        row("5-min", "height at which the actuators are 159 mm long", "8.2.1, 10.3.1", 106.2, lowest, "mm", "P", None,
            "at the printed height they are 160.7 mm long"),
        row("6", "gear ratio, 4.8 x 41/21", "6.1.1", 4.8 * 41 / 21, plant.values["ratio"], "rad/rad", "R", 1e-12),
    ]  # fmt: skip


def _bearing_table() -> Array:
    """Points m1-m6 in mm, (6, 2): the printed m2 and m3, and the pair turned by 120 degrees either way."""
    x, y = BEARING
    pair = np.array([[x, y], [-x, y]])
    c, s = -0.5, math.sqrt(0.75)
    left, right = pair @ np.array([[c, s], [-s, c]]), pair @ np.array([[c, -s], [s, c]])
    return np.array([right[1], *pair, left[0], left[1], right[0]])


def _state_rows(plant: StewartPlatform) -> list[PublishedNumber]:
    row, model, motor = PublishedNumber, linearise(plant), _speed_motor()
    ranks = [(what(m).rank, m.n_states) for m in (model, motor) for what in (controllability, observability)]
    (c, states), (o, _), (cm, motor_states), (om, _) = ranks
    return [
        row("7", "holding torque of each motor at home", "8.2", 0.8701e-3, float(trim(plant).u[0]), "N m", "F",
            0.8701e-7, "the platform's mass is not printed; 3.167 kg were chosen so that this row agrees"),
        row("12-states", "states of the linear model", "8.2", 12, states, "", "R", 0.0),
        row("12-ctrb", "controllable states of the linear model", "8.2.2", 12, c, "", "R", 0.0),
        row("12-obsv", "observable states of the linear model", "8.2.2", 12, o, "", "R", 0.0,
            "8.2.2 prints ob = ctrb(A, C), which must be obsv(A, C); both give 12"),
        row("12-motor", "controllable and observable states of the motor", "7.2.1", 2, min(cm, om, motor_states), "",
            "R", 0.0),
    ]  # fmt: skip


# --- section 7.2, 10.1.1 and chapter 11: motor and jig ---------------------------------------------------------------


def _speed_motor(**parameters: float) -> Any:
    """Voltage to speed and current of the motor."""
    return drop_unconnected(dc_motor(**parameters).state_space().select(outputs=["omega", "i"]))


def _no_load(**parameters: float) -> tuple[float, float]:
    """Speed in rad/s and current in A of the motor without load at 42 V."""
    speed, current = 42.0 * _speed_motor(**parameters).dc_gain()[:, 0]
    return float(speed), float(current)


def _motor_rows() -> list[PublishedNumber]:
    row, kf, r, k = PublishedNumber, 4.8e-5, 2.07, 0.052
    speed, current = _no_load()
    slow, fast = _no_load(Kf=1.35 * kf)[0], _no_load(Kf=0.65 * kf)[0]
    needed = (42 * k / 788.5 - k * k) / r  # friction with which the motor runs at 788.5 rad/s
    maker = 0.0525 * 0.0927 / MAKER_SPEED
    return [
        row("8", "no-load speed at 42 V", "7.2", 779.1, speed, "rad/s", "R", 0.05),
        row("9", "the maker's no-load speed, 7530 rpm", "7.2", 788.5, MAKER_SPEED, "rad/s", "R", 0.05),
        row("10", "the maker's speed over the model's", "7.2", 1.2, 100 * (MAKER_SPEED / speed - 1), "%", "R", 0.02),
        row("11", "highest speed with Kf uncertain by 35 % covers the maker's", "10.1.1", 788.5, fast, "rad/s", "R",
            0.0, f"the band is {slow:.2f} .. {fast:.2f} rad/s", "at least"),
        row("11-need", "change of Kf that is needed", "10.1.1", -35.0, 100 * (needed / kf - 1), "%", "R", 0.0,
            "35 % is the next round number", "at least"),
        row("29-friction", "viscous friction by the data sheet's no-load current", "7.2", 4.8e-5, maker, "N m s/rad",
            "N", None, "the printed friction is eight times what the maker's 92.7 mA say"),
        row("29-current", "current of the model without load", "data sheet", 0.0927, current, "A", "N", None,
            "the same disagreement"),
    ]  # fmt: skip


@dataclass(frozen=True)
class _JigMotion:
    """How far and how fast the jig moves under a square wave: largest motor angle, steady and largest speed."""

    angle: float
    speed: float
    peak_speed: float


def _jig_motion(motor: LinearPlant, heavier: float = 1.0) -> _JigMotion:
    """The jig's link under 11.8 V at 1 Hz, driven by the torque that the motor gives where its own link is nominal.

    ``motor``: jig from which the torque comes, back-EMF and all. ``heavier``: mass and inertia of the link that this
    torque drives, over those of the motor's own; it has no back-EMF.
    """
    model = motor.state_space()
    a, b = np.zeros((5, 5)), np.vstack([model.B, np.zeros((2, 1))])
    a[:3, :3] = model.A
    a[3, 4], a[4, :3] = 1.0, model.A[1] / heavier  # angle and speed of the driven link
    t = np.linspace(0.0, 1.0, 20001)
    names = ["phi", "omega", "i", "angle", "speed"]
    driven = StateSpaceModel(a, b, np.eye(5), np.zeros((5, 1)), outputs=names)
    record = simulate(driven, t, np.where(t < 0.5, 11.8, -11.8))
    steady = float(record["speed"][t < 0.5][-1])
    return _JigMotion(float(np.abs(record["angle"]).max()), steady, float(np.abs(record["speed"]).max()))


def _jig_rows() -> list[PublishedNumber]:
    """Chapter 11: what is left of the gaps of 11 and 12.5 % by which the model is beyond the measurement."""
    row = PublishedNumber
    nominal = linear_actuator(J=0.0)
    base = _jig_motion(nominal)

    def left(found: _JigMotion) -> tuple[float, float, float]:
        """Of the first gap by the angle; of the second by the steady and by the largest speed."""
        pairs = ((1.11, "angle"), (1.125, "speed"), (1.125, "peak_speed"))
        first, second, peak = (100 * (gap * getattr(found, k) / getattr(base, k) - 1) for gap, k in pairs)
        return first, second, peak

    sticky, slippery = (nominal.with_parameters(Kf=factor * 4.8e-5) for factor in (1.35, 0.65))
    more, less = left(_jig_motion(sticky)), left(_jig_motion(slippery))
    link, both = left(_jig_motion(nominal, 1.1)), left(_jig_motion(sticky, 1.1))
    heavy = {name: 1.1 * nominal.values[name] for name in ("J_nut", "m_screw", "m_cart")}
    driven = left(_jig_motion(nominal.with_parameters(**heavy)))
    data = "the measured record, its waveform, the cart's mass and friction are not in the text"
    beyond = "reading: the model moves 11 % further and 12.5 % faster than the measurement, square wave, 11.8 V, 1 Hz"
    digits = "the tolerance is what the printed digits of the gap leave open"
    torque = f"{beyond}; the nominal motor's torque drives the heavier link, with no back-EMF in between"
    inertia = (
        f"{beyond}; its voltage drives the heavier link, as 7.3 and 7.4 have it: the back-EMF fixes the speed, inertia "
        "only how soon it is reached. Only the reading by torque gives the printed figures"
    )
    first, second = (100 * (1 - behind * _jig_motion(slippery).angle / base.angle) for behind in (0.89, 0.875))
    other = (
        f"{beyond}; less friction makes the gap larger. Were the model as far behind the measurement instead, "
        f"{first:.3g} and {second:.3g} % would be left, but then a heavier link could not make up for anything"
    )
    covered = f"{torque}; printed is that both together cover the measurement: nothing is left"
    what = "left of the {} gap after {}"
    plus, minus, ten = "Kf +35 %", "Kf -35 %", "10 % more mass and inertia of the link"
    return [
        row("26-first", "nominal model against the measured jig, first figure", "11", 11.0, None, "%", "N", None, data),
        row("26-second", "the same, second figure", "11", 12.5, None, "%", "N", None, data),
        row("27-first", what.format("first", plus), "11.1", 9.3, more[0], "%", "P", 0.5, f"{beyond}; {digits}"),
        row("27-second", what.format("second", plus), "11.1", 11.2, more[1], "%", "P", 0.1,
            f"{beyond}, steady speed; {digits}; by the largest speed {more[2]:.3g} %"),
        row("27-less-first", what.format("first", minus), "11.1", 9.3, less[0], "%", "N", None, other),
        row("27-less-second", what.format("second", minus), "11.1", 11.2, less[1], "%", "N", None, other),
        row("28-first", what.format("first", ten), "11.2", 1.0, link[0], "%", "P", 0.5, f"{torque}; {digits}"),
        row("28-second", what.format("second", ten), "11.2", 2.2, link[1], "%", "P", 0.1, f"{torque}; {digits}"),
        row("28-volts-first", what.format("first", ten), "11.2", 1.0, driven[0], "%", "N", None, inertia),
        row("28-volts-second", what.format("second", ten), "11.2", 2.2, driven[1], "%", "N", None, inertia),
        row("28-both-first", what.format("first", f"{plus} and {ten}"), "11.3", 0.0, both[0], "%", "P", 0.0, covered,
            "at most"),
        row("28-both-second", what.format("second", f"{plus} and {ten}"), "11.3", 0.0, both[1], "%", "P", None,
            f"{covered}; by the largest speed {both[2]:.2g} %", "at most"),
    ]  # fmt: skip


# --- 8.2.1: sines; 10.3.1: cases -------------------------------------------------------------------------------------


def _sine_rows(plant: StewartPlatform, runs: dict[str, SineRun]) -> list[PublishedNumber]:
    row = PublishedNumber
    strong, weak, quick = runs["0.1 N m at 2 Hz"], runs["1 mN m at 2 Hz"], runs["0.1 N m at 20 Hz"]
    reached, left = strong.when_height(0.1407), strong.when_length(plant.values["L_max"])
    peak, duration = "height at the peak of the sine", "duration and phase are not printed"
    literal = f"0.1 N m at 2 Hz is at 0.1407 m after {1e3 * reached:.1f} ms, out of reach after {1e3 * left:.0f} ms"
    rows = [
        row("13", f"{peak}, 0.1 N m at 2 Hz", "8.2.1", 0.1407, None, "m", "N", None, f"{literal}; {duration}"),
        row("13-20Hz", f"{peak}, one period at 20 Hz", "8.2.1", 0.1407, quick.height.max(), "m", "P", 5e-4,
            "a frequency ten times the printed one"),
        row("13-1mNm", f"{peak}, one period of 1 mN m", "8.2.1", 0.1407, weak.height.max(), "m", "P", None,
            "a torque a hundredth of the printed one"),
        row("19", "time in which 0.1 N m at 2 Hz reaches 0.1407 m", "8.2.1", None, reached, "s", "N", None,
            "not printed; chosen as the length of rows 15-18, since only a run of 0.05-0.06 s fits them"),
    ]  # fmt: skip
    readings = (("", strong, reached, "up to 0.1407 m"), ("-1mNm", weak, math.inf, "one period of 1 mN m"))
    for suffix, run, until, words in readings:
        _, angle, rate = run.percent(until)
        for name, published, curve in (("angle", 1.5, angle), ("rate", 2.1, rate)):
            rows.append(
                row(f"14-{name}{suffix}", f"linear against nonlinear, {name}, {words}", "8.2.1", published,
                    float(np.abs(curve).max()), "%", "N", None, f"no reading gives both figures; {duration}")
            )  # fmt: skip
    return rows


def _case_rows(varied: tuple[Case, ...]) -> list[PublishedNumber]:
    """Rows 15-18; the number is that of the case's figure, by the same definition (`Case.largest_percent`)."""
    row, where = PublishedNumber, "10.3.1"
    rows: list[PublishedNumber] = []
    tolerances = {"1": 0.15, "2a": 0.014 * (1 - 1 / 1.3), "2b": 0.060 * (1 - 1 / 1.3), "2c": 0.02}
    definition = f"angle of nut 1, 0.1 N m at 2 Hz for {1e3 * UP_TO:.1f} ms, in percent of its largest nominal value"
    held = "reading: the holding torque stays nominal while gravity grows"
    trimmed = "reading: trimmed anew"
    for number, case in zip((15, 16, 17, 18), varied, strict=True):
        said = f"case {case.name}, {case.words}"
        other = max(map(abs, case.changes(not case.held)))
        reading, not_taken = (held, "trimmed anew") if case.held else (trimmed, "torque held")
        why = f"{reading} ({not_taken} {other:.4g} %); {definition}"
        rows += [
            row(str(number), f"{said}: largest change", where, case.published, case.largest_percent, "%", "P",
                tolerances[case.name], why),
            row(f"{number}-worst", f"{said}: worst Delta, 1 for +I, -1 for -I", where, case.published_worst, case.worst,
                "", "P", 0.0, case.worst_in_words),
        ]  # fmt: skip
    gain = abs(varied[0].gain_percent)
    why = "the change of B alone: with A over 0.5 s gravity wins"
    rows.insert(1, row("15-gain", "case 1, z = 0.1062 m: change of B", where, 1.13, gain, "%", "P", 0.15, why))
    return rows


# --- 9.1.3: tracking -------------------------------------------------------------------------------------------------


def _tracking_rows(runs: dict[str, TrajectoryFollowing]) -> list[PublishedNumber]:
    row, where = PublishedNumber, "9.1.3"
    plain, turned, rotors = (runs[name] for name in ("thesis", "link-4", "rotors"))
    error = plain.largest_error(after=3.0)
    torque, volts = (float(found.max()) for found in (plain.largest_torque(), plain.largest_voltage()))
    other_torque, other_volts = (float(f.max()) for f in (turned.largest_torque(), turned.largest_voltage()))
    rotor = rotors.largest_torque()

    def worst(values: Array) -> int:
        return int(values.argmax()) + 1

    signs = (
        "the signs are not printed; +++-+- were chosen because they give link 4, one of three choices (with all + link "
        f"{worst(plain.largest_torque())})"
    )
    fitted = "p_up is not printed; 236 /s were chosen so that this row agrees"
    pole = "with the p_up of row 20: a check of it, as both errors follow from one law"
    abrupt = "the sines start abruptly; with a rise of 1 s the torque keeps to the limit"
    return [
        row("20", "largest position error of an axis", where, 0.2, 1e3 * float(error[:3].max()), "mm", "F", 0.005,
            fitted),
        row("21", "largest orientation error", where, 0.8, 1e3 * float(error[3:].max()), "mrad", "R", 0.02, pole),
        row("22", "largest torque", where, 0.0977, torque, "N m", "R", 0.0, "the lift must be smooth", "at most"),
        row("22-signs", "largest torque, signs +++-+-", where, 0.0977, other_torque, "N m", "R", 0.0, "", "at most"),
        row("22-rotor", "largest torque with the rotors' inertia", where, 0.0977, float(rotor.max()), "N m", "P", None,
            abrupt, "at most"),
        row("22-smooth", "largest torque with the rotors after t = 3 s", where, 0.0977,
            float(rotors.largest_torque(after=3.0).max()), "N m",
            "R", 0.0, "", "at most"),
        row("23", "largest voltage", where, 42.0, volts, "V", "R", 0.0, "", "at most"),
        row("23-signs", "largest voltage, signs +++-+-", where, 42.0, other_volts, "V", "R", 0.0, "", "at most"),
        row("24-torque", "link with the largest torque", where, 4, worst(turned.largest_torque()), "", "P", 0.0,
            signs),
        row("24-voltage", "link with the largest voltage", where, 4, worst(turned.largest_voltage()), "", "P", 0.0,
            signs),
        row("24-length", "link with the largest extension", where, 4, worst(turned.lengths.max(axis=0)), "", "P", 0.0,
            f"{1e3 * turned.lengths.max():.2f} mm; {signs}"),
    ]  # fmt: skip


def _pole_rows(thesis: StewartPlatform, physical: StewartPlatform) -> list[PublishedNumber]:
    row = PublishedNumber
    return [
        row("25", "slowest stable pole of the lower layer, p_up = 236 /s", "9.3", None,
            lowest_stable_pole(thesis), "1/s", "N", None,
            "not printed; the layer designs with a rotor that the machine lacks"),
        row("25-rotor", "the same with the rotors", "9.3", None, lowest_stable_pole(physical), "1/s", "N", None,
            "not printed"),
    ]  # fmt: skip
