"""The Stewart platform under two-layer control, and one motion of a machine under several controllers."""
# Březina 2010, eqs 9.1-9.4 and section 9.1.3. Eqs 9.2 and 9.4 lack one derivative; the gains are right for the plants
# written above them. The first 2 s of the path are not printed; a step would need 0.23 N m and 219 V.

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.display import Displayable, Facts, Part
from robustlab.display import number as shown
from robustlab.dynamics.control.controlled_plant import (
    ControlledNonlinearPlant,
    TorqueGains,
    controlled_nonlinear,
    controlled_plant,
    driver_in_loop,
    torque_gains,
)
from robustlab.dynamics.extended.extended_plant import ExtendedPlant, with_effects
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plant_base import Trim
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform, check_pose, inside, nut_angles
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.record import Record
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, as_model, real_array

# Rotor inertia in the design of the lower layer, used even if the machine has none (eq. 9.3).
ROTOR = 7.2e-6
NUMBERS = range(1, 7)


@dataclass(frozen=True, eq=False)
class LayeredController:
    """A linear upper layer above the motors' torque loops, in deviations from the design's trim."""

    upper: StateSpaceModel  # from r, phi, phidot (6 each) to the six motor torque references; continuous
    lower: TorqueGains  # gains of every motor's torque loop
    at: Trim  # its torques and voltages are added to the controller's outputs

    def state_space(self) -> StateSpaceModel:
        """Return the linear controller: inputs r, phi, phidot, torque (6 each), outputs the six voltages."""
        upper, lower = self.upper, self.lower
        n, one, none = upper.n_states, np.eye(6), np.zeros((6, 6))
        below = np.zeros((6, n))
        a = np.block([[upper.A, np.zeros((n, 12))], [upper.C, none, none], [below, lower.ki * one, none]])
        b = np.block([[upper.B, np.zeros((n, 6))], [upper.D, -one], [np.zeros((6, 18)), -lower.kp * one]])
        c, d = np.hstack([below, none, one]), np.hstack([np.zeros((6, 18)), -lower.kd * one])
        inputs = [*_ABOVE, *(Taken(*s) for s in _TORQUES)]
        return StateSpaceModel(a, b, c, d, 0.0, inputs, _signals(("u", "V")), where="two-layer")


def _signals(*kinds: tuple[str, str]) -> list[Signal]:
    return [Signal(f"{name}_{i}", unit) for name, unit in kinds for i in NUMBERS]


_ABOVE = [
    *(Taken(f"r_{i}", "rad", "r", f"phi_{i}") for i in NUMBERS),
    *(Taken(*s) for s in _signals(("phi", "rad"), ("phidot", "rad/s"))),
]
_TORQUES = _signals(("torque", "N m"))


def upper_layer(Kp: Array, Kd: Array, Ki: Array) -> StateSpaceModel:
    """Return the I-PD of the angles, gains (6, 6): inputs r, phi, phidot (6 each), outputs the six motor torques."""
    one, none = np.eye(6), np.zeros((6, 6))
    b, d = np.hstack([one, -one, none]), np.hstack([none, -Kp, -Kd])
    return StateSpaceModel(none, b, Ki, d, 0.0, _ABOVE, _TORQUES, where="two-layer: upper layer")


def two_layer(plant: StewartPlatform, p_up: float = 236.0, p_low: float = 3000.0) -> LayeredController:
    """Design the two-layer controller of a Stewart platform with motors."""
    if not (isinstance(plant, StewartPlatform) and plant.motors):
        raise InputError("two_layer", "a plant without motors", 'plant("stewart-platform", motors=True)')
    for name, value in (("p_up", p_up), ("p_low", p_low)):
        number(f"two_layer: {name}", value, "a positive number", above=0)
    point = trim(plant)
    p, a, one = plant.values, linearise(plant, point).A, np.eye(6)
    gain = a[6:12, 12:] / p["Km"]
    stiffness, damping = a[6:12, :6], a[6:12, 6:12] + gain * p["Kf"] * p["ratio"]  # the motor's own damping is in m
    right = np.hstack([3 * p_up**2 * one + stiffness, 3 * p_up * one + damping, p_up**3 * one])
    upper = np.asarray(np.linalg.solve(gain, right), dtype=np.float64)
    motor = {name: p[name] for name in ("R", "L", "Km", "Kb", "Kf")}
    gains = torque_gains(p_low, J=ROTOR, **motor)
    return LayeredController(upper_layer(upper[:, :6], upper[:, 6:12], upper[:, 12:]), gains, point)


def measured(plant: StewartPlatform) -> Array:
    """Return C (18, 18) of the measurements ``(phi, phidot, torque) = C x``; torque = Km i - Kf n phidot."""
    p, c = plant.values, np.eye(18)
    c[12:, 12:] *= p["Km"]
    c[12:, 6:12] = -p["Kf"] * p["ratio"] * np.eye(6)
    return c


def layered_loop(plant: StewartPlatform, controller: LayeredController) -> ControlledNonlinearPlant:
    """Return the machine under control, from references of the nut angles to angles, rates and voltages."""
    read, k = measured(plant), controller.state_space()
    # the measured torques are computed from the currents, which are no outputs
    sees = StateSpaceModel(
        k.A, np.hstack([k.B[:, :6], k.B[:, 6:] @ read]), k.C, np.hstack([k.D[:, :6], k.D[:, 6:] @ read])
    )
    name = f"{plant.name} under control"
    return ControlledNonlinearPlant.of(name, plant, sees, range(6), range(12, 30), controller.at)


def closed_loop(plant: StewartPlatform, controller: LayeredController) -> StateSpaceModel:
    """Return the linear loop from references r (6) to nut angles, torques and voltages (18)."""
    loop = layered_loop(plant, controller)
    a, b, c, d = loop.jacobians(loop.start, loop.offset[:6])
    torque = np.hstack([measured(plant)[12:], np.zeros((6, loop.K.n_states))])
    names = _signals(("phi", "rad"), ("torque", "N m"), ("u", "V"))
    outputs, direct = np.vstack([c[:6], torque, c[12:]]), np.vstack([np.zeros((12, 6)), d[12:]])
    return StateSpaceModel(a, b, outputs, direct, 0.0, controller.state_space().inputs[:6], names, where="closed_loop")


@dataclass(frozen=True, eq=False)
class SineTrajectory:
    """A smooth lift followed by sines about the lifted pose:

    q0 + lift e(t / T) + amplitude e((t - T) / T_r) sin(omega (t - T)), e(s) = 10 s^3 - 15 s^4 + 6 s^5 on [0, 1].
    """

    start: ArrayLike  # pose (tx, ty, tz, ax, ay, az) at t = 0 in m and rad
    lift: ArrayLike = (0.0, 0.0, 5e-3, 0.0, 0.0, 0.0)  # change of the pose during the first stage, (6,)
    amplitude: ArrayLike = (5e-3, 5e-3, 5e-3, 20e-3, 20e-3, 20e-3)  # of the sines, (6,), signs included
    omega: float = math.pi  # of the sines in rad/s
    lift_time: float = 2.0  # length T of the first stage in s
    rise_time: float = 0.0  # rise time T_r of the sines in s; 0: none

    def __post_init__(self) -> None:
        for name in ("start", "lift", "amplitude"):
            vector = real_array(name, getattr(self, name), 1, "trajectory")
            if len(vector) != 6:
                raise InputError("trajectory", f"{name} has {len(vector)} entries", "6")
            object.__setattr__(self, name, vector)
        for name in ("omega", "lift_time"):
            number(f"trajectory: {name}", getattr(self, name), "a number that is positive", above=0)
        number("trajectory: rise_time", self.rise_time, "a number that is not negative", at_least=0)

    def pose(self, t: ArrayLike) -> Array:
        """Return the pose (6,) at a time in s, or (n, 6) at times (n,)."""
        time = np.asarray(t, dtype=np.float64)[..., None]
        since = np.maximum(time - self.lift_time, 0.0)
        share = ease(since / self.rise_time) if self.rise_time else 1.0
        lifted = np.asarray(self.start) + np.asarray(self.lift) * ease(time / self.lift_time)
        return lifted + np.asarray(self.amplitude) * share * np.sin(self.omega * since)


def ease(s: Array) -> Array:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


UNSTABLE = "the loop may be unstable: check the poles of closed_loop"
# Nominal torque in N m and voltage in V of the Maxon RE 35; nothing is clipped.
MOST_TORQUE, MOST_VOLTAGE = 0.0977, 42.0


@dataclass(frozen=True, eq=False)
class TrajectoryFollowing:
    """Simulated motion of a machine along a trajectory."""

    t: Array  # times in s, (n,)
    # reference and simulated poses, (n, 6)
    reference: Array
    pose: Array
    # of the six nuts and motors, (n, 6); torque is the motor's output, Km i - Kf omega. Voltage is (n, 0) for a machine
    # without motors.
    phi: Array
    torque: Array
    voltage: Array
    lengths: Array  # of the actuators in m, (n, 6)

    @property
    def error(self) -> Array:
        """Pose minus reference, (n, 6), in m and rad."""
        return self.pose - self.reference

    def largest_error(self, after: float = 0.0) -> Array:
        """Return the largest absolute error of each axis from the time ``after`` on, (6,)."""
        return np.abs(self.error[self.t >= after]).max(axis=0)

    def largest_torque(self, after: float = 0.0) -> Array:
        """Return the largest absolute torque of each motor in N m from the time ``after`` on, (6,)."""
        return np.abs(self.torque[self.t >= after]).max(axis=0)

    def largest_voltage(self) -> Array:
        """Return the largest absolute voltage of each motor in V, (6,)."""
        return np.abs(self.voltage).max(axis=0)

    @property
    def within_limits(self) -> bool:
        within = self.largest_torque().max() <= MOST_TORQUE
        return bool(within and self.largest_voltage().max(initial=0.0) <= MOST_VOLTAGE)


def _following(
    machine: StewartPlatform, t: Array, reference: Array, phi: Array, torque: Array, voltage: Array
) -> TrajectoryFollowing:
    poses, lengths = machine.poses(phi, reference[0]), machine.geometry.home_lengths + phi / machine.geometry.turns
    return TrajectoryFollowing(t, reference, poses, phi, torque, voltage, lengths)


def follow(
    plant: StewartPlatform, controller: LayeredController, trajectory: SineTrajectory, t: ArrayLike, rtol: float = 1e-6
) -> TrajectoryFollowing:
    """Simulate the nonlinear machine under control, starting in equilibrium at the controller's trim."""
    clock = Record(t, name="follow").t
    reference = _within(plant, trajectory, clock)
    read, loop = measured(plant), layered_loop(plant, controller)
    # The torque loops are stiff (poles of some 1000 /s): implicit integration.
    states = _integrated(loop, plant, trajectory, clock, rtol)
    lengths = plant.geometry.home_lengths + states[:, :6] / plant.geometry.turns
    low, high = plant.geometry.limits
    beyond = ((lengths < low) | (lengths > high)).any(axis=1)
    if beyond.any():
        found = f"an actuator reaches the end of its range at t = {clock[np.argmax(beyond)]:.6g} s"
        raise NoTrustworthyNumber(plant.name, found, None, UNSTABLE)
    voltage = loop.outputs_along(states, nut_angles(plant.geometry, reference))[:, 12:]
    torque = states[:, :18] @ read[12:].T
    return _following(plant, clock, reference, states[:, :6].copy(), torque, voltage)


def follow_with_torques(
    plant: StewartPlatform | ExtendedPlant, K: StateSpaceModel, trajectory: SineTrajectory, t: ArrayLike, *,
    at: Trim,
) -> TrajectoryFollowing:  # fmt: skip
    """Simulate a machine without motors under a controller, with or without effects at its joints, in equal steps."""
    machine: Any = plant.plant if isinstance(plant, ExtendedPlant) else plant
    clock = Record(t, name="follow").t
    reference = _within(machine, trajectory, clock)
    loop = torque_loop(plant, K, at)
    if isinstance(loop, ControlledNonlinearPlant):  # stepped like a plant with effects, because the loop is stiff
        loop = ExtendedPlant(loop.name, loop.parameters, loop.inputs, loop.outputs, loop.states, loop, ())
    angles = nut_angles(machine.geometry, reference)
    start = np.concatenate([at.x[:12], np.zeros(as_model(K).n_states)])
    try:
        made = loop.motion(angles, float(np.diff(clock).mean()), float(clock[0]), start, None, "foh")[1]
    except NoTrustworthyNumber as wrong:
        raise NoTrustworthyNumber(wrong.where, wrong.found, wrong.expected, UNSTABLE) from None
    none = np.zeros((len(clock), 0))
    return _following(machine, clock, reference, made[:, :6].copy(), made[:, 12:18].copy(), none)


def torque_loop(
    plant: StewartPlatform | ExtendedPlant, K: StateSpaceModel, at: Trim
) -> ControlledNonlinearPlant | ExtendedPlant:
    """Return the loop of `follow_with_torques`, with references of the angles as inputs."""
    angles, rates = ([s.name for s in plant.outputs[k : k + 6]] for k in (0, 6))
    seen = angles if as_model(K).n_inputs == 12 else [*angles, *rates]
    return controlled_nonlinear(plant, K, angles, seen, at)


def _within(plant: StewartPlatform, trajectory: SineTrajectory, clock: Array) -> Array:
    reference = trajectory.pose(clock)
    within = inside(plant.geometry, reference)
    if not within.all():
        k = int(np.argmin(within))
        check_pose(plant.geometry, reference[k], f"{plant.name}: trajectory at t = {clock[k]:.6g} s")
    return reference


def _integrated(
    loop: ControlledNonlinearPlant, plant: StewartPlatform, trajectory: SineTrajectory, t: Array, rtol: float
) -> Array:
    """Integrate from the loop's equilibrium, between discontinuities; return states (n, n_x) at the times t."""
    from scipy.integrate import solve_ivp

    number("follow: rtol", rtol, "a number between 0 and 1", above=0, below=1)

    def angles(time: float) -> Array:
        return nut_angles(plant.geometry, trajectory.pose(time))

    def rates(time: float, state: Array) -> Array:
        try:
            return loop.rates_along(state[None], angles(time)[None])[0]
        except NoTrustworthyNumber:  # not a pose: NaN makes the integrator shorten the step
            return np.full(len(state), np.nan)

    def jacobian(time: float, state: Array) -> Array:
        return loop.local_models(state[None], angles(time)[None]).A[0]

    # Absolute tolerances of angles, rates, currents, and the controller's integrals, relative to rtol.
    small = np.abs(loop.K.C).max(axis=0)
    scale = np.concatenate([np.full(12, 1.0), np.full(6, 0.1), 0.1 / np.maximum(small, 1.0)])
    breaks = {0.0, trajectory.lift_time, trajectory.lift_time + trajectory.rise_time}
    edges = [t[0], *sorted(b for b in breaks if t[0] < b < t[-1]), t[-1]]
    states, state = np.empty((len(t), len(loop.states))), loop.start
    for first, last in itertools.pairwise(edges):
        found = solve_ivp(
            rates, (first, last), state, "Radau", jac=jacobian, dense_output=True, rtol=rtol,
            atol=rtol * scale, first_step=1e-6,
        )  # fmt: skip
        if not found.success or found.sol is None:
            raise NoTrustworthyNumber(loop.plant.name, f"no solution beyond t = {found.t[-1]:.6g} s", None, UNSTABLE)
        within = (t >= first) & (t <= last)
        states[within] = found.sol(t[within]).T
        state = found.y[:, -1]
    return states


# --- runs of several controllers --------------------------------------------------------------------------------------


class TimePanel(NamedTuple):
    """One signal of several runs over time: label with unit, run -> samples (n,), and a limit to draw."""

    label: str
    curves: Mapping[str, Array]
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class ControlledRuns(Displayable):
    """Simulated runs of one machine under several controllers."""

    controllers: Mapping[str, Mapping[str, Any]]
    columns: tuple[tuple[str, tuple[str, ...], float], ...]
    t: Array
    panels: tuple[TimePanel, ...]
    words: Facts
    notes: tuple[str, ...]
    status: Status = Status.CONVERGED

    quantities: ClassVar[Mapping[str, Any]] = {
        "controllers": {
            "*": {
                **dict.fromkeys(("largest_error", "worst_error", "largest_torque", "largest_voltage"), float),
                "order": "1", "largest": {"*": float}, "within_limits": bool, "spectral_abscissa": "1/s",
                "position_error": "m", "orientation_error": "rad", "nut_errors": {"phi_*": "rad"},
            }
        }
    }  # fmt: skip

    def headline(self) -> str:
        return f"simulated under {len(self.controllers)} controllers"

    def facts(self) -> Facts:
        return self.words

    def details(self) -> list[Part]:
        header = ("controller", "order", *(title for title, _, _ in self.columns))
        rows = [
            (name, str(row["order"]), *(_cell(row, where, factor) for _, where, factor in self.columns))
            for name, row in self.controllers.items()
        ]
        return [Part("", header, rows)]

    def numbers(self) -> dict[str, Any]:
        return {"controllers": self.controllers}

    def to_json(self) -> dict[str, Any]:
        texts = {"facts": dict(self.facts()), "notes": self.notes}
        return {"status": self.status, "controllers": self.controllers, **texts}


def _cell(row: Mapping[str, Any], where: tuple[str, ...], factor: float) -> str:
    value: Any = row
    for key in where:
        value = value[key]
    return ("yes" if value else "no") if isinstance(value, bool) else f"{factor * value:.4g}"


def follow_sine(
    plant: Any,
    controllers: Mapping[str, Any],
    controlled: Sequence[str],
    measured: Sequence[str],
    *,
    amplitude: float,
    omega: float,
    rise_time: float,
    t_end: float,
    limits: Mapping[str, float] | None = None,
    points: int = 2001,
    step: float = 1e-4,
    after: float = 0.0,
    scale: float = 1.0,
    unit: str = "",
    effects: Mapping[str, Mapping[str, float]] | None = None,
    members: Sequence[Mapping[str, float]] = (),
) -> ControlledRuns:
    """Simulate a linear plant that follows a growing sine, nominal and sampled models, with unmodelled effects."""
    if not isinstance(plant, LinearPlant):
        raise InputError("follow_sine: plant", type(plant).__name__, "a linear plant")
    units, limits = {s.name: s.unit for s in (*plant.outputs, *plant.inputs)}, limits or {}
    for name in limits:
        if name not in units:
            raise unknown_name(f"limits.{name}", "no such signal", name, list(units))
    fine = max(1, math.ceil(t_end / (points - 1) / step))  # steps between two stored points
    t = np.linspace(0.0, t_end, fine * (points - 1) + 1)
    wave = amplitude * ease(t / rise_time) * np.sin(omega * t)
    late, known = t >= after, dict(effects or {})
    rows: dict[str, dict[str, Any]] = {}
    errors: dict[str, Array] = {}
    sizes: dict[str, dict[str, Array]] = {name: {} for name in limits}
    for name, K in controllers.items():
        loop = controlled_plant(plant, K, controlled, measured)
        made = [_with_effects(loop, plant, known, member) for member in ({}, *members)]
        runs = [simulate(one, t, np.tile(wave[:, None], len(controlled))) for one in made]
        error = [np.column_stack([wave - run[c] for c in controlled]) * scale for run in runs]
        largest = {n: float(max(np.abs(run[n]).max() for run in runs)) for n in limits}
        rows[name] = {
            "order": len(loop.states) - len(plant.states),
            "largest_error": float(np.abs(error[0][late]).max()),
            "worst_error": float(max(np.abs(e[late]).max() for e in error)),
            "largest": largest,
            "within_limits": all(largest[n] <= limit for n, limit in limits.items()),
        }
        errors[name] = error[0][::fine, 0]
        for signal in limits:
            sizes[signal][name] = runs[0][signal][::fine]
    unit = unit or units[controlled[0]]
    columns = [(f"error [{unit}]", ("largest_error",), 1.0), (f"of the worst member [{unit}]", ("worst_error",), 1.0)]
    columns += [(f"largest {n} [{units[n]}]", ("largest", n), 1.0) for n in limits]
    panels = [TimePanel(f"error of {controlled[0]} [{unit}]", errors)]
    panels += [TimePanel(f"{n} [{units[n]}]", sizes[n], limit) for n, limit in limits.items()]
    words = " and ".join(e.replace("-", " ").replace("@", " at ") for e in known) or "no further effect"
    facts = [
        ("reference", f"{shown(float(amplitude), units[controlled[0]], 5)} at {shown(float(omega), 'rad/s', 5)}"),
        ("effects that no design knew", words),
        ("further members simulated", str(len(members))),
        ("errors count from", shown(after, "s", 5)),
    ]
    note = "Limits are compared with, not applied: nothing is clipped."
    return ControlledRuns(rows, tuple(columns), t[::fine], tuple(panels), facts, (note,))


def _with_effects(
    loop: Any, plant: Any, effects: Mapping[str, Mapping[str, float]], member: Mapping[str, float]
) -> Any:
    made, own = (p.with_parameters(**member) if member else p for p in (loop, plant))
    at_controls = [f"input-dead-zone@{s.name}" for s in plant.inputs]
    rest = {key: values for key, values in effects.items() if key not in at_controls}
    moved = with_effects(made, rest) if rest else made
    for key in at_controls:
        if key in effects:
            moved = with_effects(moved, driver_in_loop(made, own, key.partition("@")[2], effects[key]))
    return moved


def follow_path(
    plant: Any,
    controllers: Mapping[str, Any],
    *,
    at: Sequence[float] | None = None,
    scale: float = 1.0,
    rise_time: float = 0.0,
    t_end: float = 5.0,
    points: int = 2501,
    after: float = 3.0,
    p_low: float = 3000.0,
) -> ControlledRuns:
    """Simulate the nonlinear Stewart platform along the path of section 9.1.3; ``at``: its start, None: home."""
    machine = plant.plant if isinstance(plant, ExtendedPlant) else plant
    if not isinstance(machine, StewartPlatform) or (machine.motors and machine is not plant):
        expected = "one, with motors, or without them and perhaps with effects"
        raise InputError("follow_path: plant", "no Stewart platform that can be followed here", expected)
    point = trim(plant) if at is None else trim(plant, pose=at)
    sines = SineTrajectory(machine.geometry.home if at is None else at, rise_time=rise_time)
    sines = replace(sines, lift=scale * np.asarray(sines.lift), amplitude=scale * np.asarray(sines.amplitude))
    t = np.linspace(0.0, t_end, points)
    late, angles = t >= after, nut_angles(machine.geometry, sines.pose(t))
    runs, abscissas, below = _followed(plant, machine, controllers, sines, t, point, p_low)
    rows: dict[str, dict[str, Any]] = {}
    curves: dict[str, dict[str, Array]] = {key: {} for key in ("position", "torque", "voltage")}
    for name, run in runs.items():
        error = run.largest_error(after)
        curves["position"][name] = distance = 1e3 * np.linalg.norm(run.error[:, :3], axis=1)
        largest = np.abs((run.phi - angles)[late]).max(axis=0)
        rows[name] = {
            "order": as_model(controllers[name], name).n_states,
            "worst_error": float(distance[late].max()),
            "position_error": float(error[:3].max()),
            "orientation_error": float(error[3:].max()),
            "nut_errors": {f"phi_{i + 1}": float(off) for i, off in enumerate(largest)},
            "largest_torque": float(run.largest_torque().max()),
            "within_limits": run.within_limits,
            "spectral_abscissa": abscissas[name],
        }
        curves["torque"][name] = 1e3 * np.abs(run.torque).max(axis=1)
        if run.voltage.size:
            rows[name]["largest_voltage"] = float(run.largest_voltage().max())
            curves["voltage"][name] = np.abs(run.voltage).max(axis=1)
    panels = (
        TimePanel("distance to path [mm]", curves["position"]),
        TimePanel("largest |torque| [mN m]", curves["torque"], 1e3 * MOST_TORQUE),
        TimePanel("largest |voltage| [V]", curves["voltage"], MOST_VOLTAGE),
    )
    columns = (
        ("position [mm]", ("position_error",), 1e3),
        ("angle [mrad]", ("orientation_error",), 1e3),
        ("torque [mN m]", ("largest_torque",), 1e3),
        *([("voltage [V]", ("largest_voltage",), 1.0)] if curves["voltage"] else []),
        ("in limits", ("within_limits",), 1.0),
    )
    pose = "home" if at is None else ", ".join(f"{v:g}" for v in at)
    size = f"{5 * scale:g} mm"
    words = f"a lift of {size}, then sines of {size} and {20 * scale:g} mrad"
    facts = [("path begins at", pose), ("path", words), below, ("errors count from", shown(after, "s", 5))]
    limits = "torque and voltage" if curves["voltage"] else "torque"
    note = f"Nothing is clipped: 'in limits' says whether the motors' {limits} would have been enough."
    kept = tuple(panel for panel in panels if panel.curves)
    return ControlledRuns(rows, columns, t, kept, facts, (note,))


def _followed(
    plant: Any, machine: StewartPlatform, controllers: Mapping[str, Any], path: SineTrajectory, t: Array, at: Trim,
    p_low: float,
) -> tuple[dict[str, TrajectoryFollowing], dict[str, float], tuple[str, str]]:  # fmt: skip
    """Return the run and the spectral abscissa of each loop, and the inner loops in words."""
    models = {name: as_model(K, name) for name, K in controllers.items()}
    if not machine.motors:
        named = f", with {', '.join(e.in_words for e in plant.effects)}" if machine is not plant else ""
        runs = {name: follow_with_torques(plant, K, path, t, at=at) for name, K in models.items()}
        poles = {name: linearise(torque_loop(machine, K, at)).spectral_abscissa() for name, K in models.items()}
        return runs, poles, ("the machine", f"takes torques{named}")
    lower = two_layer(machine, p_low=p_low).lower
    layered = {name: LayeredController(K, lower, at) for name, K in models.items()}
    runs = {name: follow(machine, controller, path, t) for name, controller in layered.items()}
    poles = {name: closed_loop(machine, controller).spectral_abscissa() for name, controller in layered.items()}
    return runs, poles, ("torque loops below", f"triple pole at {p_low:g} 1/s")
