r"""Simulate a Stewart platform with faulty drives without robustlab, for `platform_cases`.

The rigid bodies are those of the tests' Pinocchio tree (``tests/oracle/stewart_pinocchio.py``), reduced to the nut
angles. Its mass matrix and bias torque are evaluated at every sample and interpolated by parabolas in between, where
they change little; within a sample the drives are integrated in steps of 50 us by the classical Runge-Kutta method:

.. math::
    M \ddot\varphi = k (K_m i - K_f k \dot\varphi) - b - f, \qquad L \frac{di}{dt} = u - R i - K_b k \dot\varphi

Dry friction is an event: the step ends where a rate crosses zero. There the nut either reverses or sticks
(:math:`\dot\varphi_j = 0` as a constraint, its torque solved for) until that torque exceeds the breakaway level.
Backlash acts between the rotor, which the encoder measures, and the nut: spring and damper, in compression only.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 5e-5  # of the drives' integration, in s


def oracle() -> ModuleType:
    name = "stewart_pinocchio"
    if name not in sys.modules:
        path = Path(__file__).parents[1] / "tests" / "oracle" / f"{name}.py"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@dataclass(frozen=True)
class Drives:
    """Constants of the six drives, arrays (6,) or one number for all; torques and speeds at the nut."""

    Km: Any = 0.052  # to Kf: on the motor's data sheet, motor side
    Kb: Any = 0.052
    R: Any = 2.07
    L: Any = 0.62e-3
    Kf: Any = 4.8e-5
    gain: Any = 1.0  # torque per commanded torque, without motors
    viscous: Any = 0.0  # N m s/rad
    coulomb: Any = 0.0  # level when sliding, and what is added at rest, N m
    breakaway: Any = 0.0
    stribeck: Any = 1.0  # how fast that is lost, rad/s
    ripple: Any = 0.0  # amplitude in N m, and waves per turn of the nut
    order: Any = 1.0
    phase: Any = 0.0
    gap: Any = 0.0  # between rotor and nut, rad at the nut
    delay_in: Any = 0.0  # of input and reading, s: whole steps of `STEP`
    delay_out: Any = 0.0
    offset: Any = 0.0  # of the reading, rad at the nut

    def at(self, leg: int, **values: float) -> Drives:
        """The same drives with other values at one leg (0..5)."""
        changed = {}
        for name, value in values.items():
            column = np.array(np.broadcast_to(getattr(self, name), 6), dtype=np.float64)
            column[leg] = value
            changed[name] = column
        return replace(self, **changed)

    def column(self, name: str) -> Array:
        return np.array(np.broadcast_to(getattr(self, name), 6), dtype=np.float64)


@dataclass(frozen=True)
class Cable:
    """A spring from a point of the base frame to a point of the platform, slack below its length: k in N/m."""

    anchor: tuple[float, float, float]
    point: tuple[float, float, float]
    length: float
    k: float


@dataclass(frozen=True)
class Machine:
    """Rigid bodies (the oracle's ``Parameters``), drives, and whether these are motors (else torques are inputs)."""

    bodies: Any
    drives: Drives
    motors: bool
    cable: Cable | None = None


class _Shape:
    """Arrays of the mechanism that the compiled functions take."""

    def __init__(self, model: Any) -> None:
        tree, par = model.model, model.parameters
        self.base, self.platform, self.x = model.base_points, model.platform_points, np.array(model._x)
        self.y0 = np.array(model._home_y)
        self.home_length, self.turns, self.shift = model.home_length, 2 * np.pi / par.lead, par.shift
        joints = [(*model._links[i], model._nuts[i], model._screws[i]) for i in range(6)]
        self.places = np.array([[tree.joints[j].idx_q for j in four] for four in joints])
        self.at = tree.joints[model._platform].idx_q


@njit(cache=True)
def _turned(pose):
    cx, sx = math.cos(pose[3]), math.sin(pose[3])
    cy, sy = math.cos(pose[4]), math.sin(pose[4])
    cz, sz = math.cos(pose[5]), math.sin(pose[5])
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


@njit(cache=True)
def _legs(pose, base, platform, x, shift, y, k, lengths):
    """Shift directions, leg directions and lengths of a pose."""
    turned = _turned(pose)
    for i in range(6):
        w = pose[:3] + turned @ platform[i] - base[i]
        n = w - x[i] * np.dot(x[i], w)
        y[i] = n / np.sqrt(np.dot(n, n))
        w = w - shift * y[i]
        lengths[i] = np.sqrt(np.dot(w, w))
        k[i] = w / lengths[i]


@njit(cache=True)
def _pose_of(target, pose, slopes, base, platform, x, shift, y, k, lengths):
    """Pose with these lengths by Newton's method with the slopes d pose / d length of a pose near by."""
    for _ in range(40):
        _legs(pose, base, platform, x, shift, y, k, lengths)
        step = slopes @ (target - lengths)
        pose += step
        if np.abs(step).max() < 1e-15:
            break
    _legs(pose, base, platform, x, shift, y, k, lengths)
    return np.abs(target - lengths).max()


@njit(cache=True)
def _configuration(pose, x, y0, y, k, phi, lengths, places, at, q):
    """Tree coordinates that close the loops."""
    for i in range(6):
        q[places[i, 0]] = math.atan2(np.dot(y[i], np.cross(x[i], y0[i])), np.dot(y[i], y0[i]))
        q[places[i, 1]] = math.atan2(-np.dot(k[i], x[i]), np.dot(k[i], y[i]))
        q[places[i, 2]], q[places[i, 3]] = phi[i], lengths[i]
    cx, sx = math.cos(pose[3] / 2), math.sin(pose[3] / 2)
    cy, sy = math.cos(pose[4] / 2), math.sin(pose[4] / 2)
    cz, sz = math.cos(pose[5] / 2), math.sin(pose[5] / 2)
    q[at : at + 3] = pose[:3]
    q[at + 3] = sx * cy * cz - cx * sy * sz
    q[at + 4] = cx * sy * cz + sx * cy * sz
    q[at + 5] = cx * cy * sz - sx * sy * cz
    q[at + 6] = cx * cy * cz + sx * sy * sz


@njit(cache=True)
def _slopes(pose, twists):
    """Rates of the pose's coordinates per column of platform twists (in the platform's own axes)."""
    cx, sx, cy, sy = math.cos(pose[3]), math.sin(pose[3]), math.cos(pose[4]), math.sin(pose[4])
    out = np.empty((6, 6))
    out[:3] = _turned(pose) @ np.ascontiguousarray(twists[:3])
    for j in range(6):
        wx, wy, wz = twists[3, j], twists[4, j], twists[5, j]
        yaw = (sx * wy + cx * wz) / cy
        out[3, j], out[4, j], out[5, j] = wx + sy * yaw, cx * wy - sx * wz, yaw
    return out


class _Mechanics:
    """Inverse mass matrix and bias torque at the nuts along a motion; remembers the last pose."""

    def __init__(self, machine: Machine, pose: Array) -> None:
        self.machine = machine
        self.model = oracle().PinocchioStewart(machine.bodies)
        self.shape, self.pose = _Shape(self.model), np.array(pose, dtype=np.float64)
        par = machine.bodies
        rotor = np.full(6, par.rotor_inertia * par.gear**2)
        # behind a gap the rotor is a body of its own
        self.rotor = np.where(machine.drives.column("gap") > 0, 0.0, rotor)
        self.q = pin.neutral(self.model.model)
        self.right = np.vstack([np.zeros((24, 6)), np.eye(6)])
        self.y, self.k, self.lengths = np.empty((6, 3)), np.empty((6, 3)), np.empty(6)
        s = self.shape
        _legs(self.pose, s.base, s.platform, s.x, s.shift, self.y, self.k, self.lengths)
        q = self._closed(s.turns * (self.lengths - s.home_length))
        self.slopes = _slopes(self.pose, np.linalg.solve(self.model._constraints(q), self.right)[-6:]) * s.turns

    def _closed(self, phi: Array) -> Array:
        s = self.shape
        _configuration(self.pose, s.x, s.y0, self.y, self.k, phi, self.lengths, s.places, s.at, self.q)
        return self.q

    def terms(self, phi: Array, rates: Array) -> tuple[Array, Array]:
        """M^-1 (6, 6) and b (6,) at nut angles and rates."""
        s, model, tree, data = self.shape, self.model, self.model.model, self.model.data
        missed = _pose_of(
            s.home_length + phi / s.turns, self.pose, self.slopes,
            s.base, s.platform, s.x, s.shift, self.y, self.k, self.lengths,
        )  # fmt: skip
        if not missed < 1e-12:
            raise ArithmeticError(f"no pose with these nut angles: {phi}")
        q = self._closed(phi)
        closing = model._constraints(q)
        W = np.linalg.solve(closing, self.right)
        v = W @ rates
        h = np.linalg.solve(closing, -model._drift(q, v))
        bias = W.T @ pin.rnea(tree, data, q, v, h)
        upper = pin.crba(tree, data, q)
        mass = W.T @ (np.triu(upper) + np.triu(upper, 1).T) @ W + np.diag(self.rotor)
        self.slopes = _slopes(self.pose, W[-6:]) * s.turns
        if self.machine.cable is not None:
            bias -= W[-6:].T @ _pull(self.machine.cable, self.pose)
        return np.linalg.inv(mass), bias


def _pull(cable: Cable, pose: Array) -> Array:
    """Wrench of the cable on the platform, in the platform's axes about its origin."""
    turned, point = _turned(pose), np.array(cable.point)
    way = np.array(cable.anchor) - pose[:3] - turned @ point
    length = float(np.linalg.norm(way))
    force = turned.T @ way / length * cable.k * max(length - cable.length, 0.0)
    return np.concatenate([force, np.cross(point, force)])


@njit(cache=True)
def _lengths(poses, base, platform, x, shift):
    out, y, k = np.empty((len(poses), 6)), np.empty((6, 3)), np.empty((6, 3))
    for n in range(len(poses)):
        _legs(poses[n], base, platform, x, shift, y, k, out[n])
    return out


@lru_cache
def _nominal_shape() -> _Shape:
    return _Shape(oracle().PinocchioStewart(oracle().PHYSICAL))


def nut_angles(poses: Array) -> Array:
    """Nut angles (n, 6) of poses (n, 6) by the nominal geometry."""
    s = _nominal_shape()
    return s.turns * (_lengths(np.ascontiguousarray(poses), s.base, s.platform, s.x, s.shift) - s.home_length)


def mechanism(machine: Machine, pose: Array) -> _Mechanics:
    return _Mechanics(machine, pose)


KM, KB, R, L, KV, GAIN, FC, DF, VS, RIPPLE, ORDER, PHASE, GAP, FLANK, DAMP, ROTOR = range(16)
HELD = 2  # mode of a nut that sticks; else the sign of its rate


def _numbers(machine: Machine) -> Array:
    """Rows of leg constants at the nut (6, 16)."""
    d, par = machine.drives, machine.bodies
    k = par.gear
    rotor = par.rotor_inertia * k**2
    flank = (2 * np.pi * 250.0) ** 2 * 0.04 * rotor  # a stiff tooth on what hangs at the nut, about rotor / 25
    kv = d.column("viscous") + (d.column("Kf") * k**2 if machine.motors else 0.0)
    columns = [
        k * d.column("Km"), k * d.column("Kb"), d.column("R"), d.column("L"), kv, k * d.column("gain"),
        d.column("coulomb"), d.column("breakaway"), d.column("stribeck"),
        d.column("ripple"), d.column("order"), d.column("phase"), d.column("gap"),
        np.full(6, flank), np.full(6, 0.3 * math.sqrt(flank * 0.04 * rotor)), np.full(6, max(rotor, 1e-12)),
    ]  # fmt: skip
    return np.ascontiguousarray(np.column_stack(columns))


@njit(cache=True)
def _rates(x, u, inverse, bias, p, motors, mode, dx, hold):
    """Rates of (phi, w, i, phi_rotor, w_rotor) (30,); hold: torques that the stuck nuts need (6,)."""
    torque, stuck, count = np.empty(6), np.empty(6, np.int64), 0
    for j in range(6):
        geared = p[j, GAP] > 0.0
        angle, speed = (x[18 + j], x[24 + j]) if geared else (x[j], x[6 + j])
        drive = p[j, KM] * x[12 + j] if motors else p[j, GAIN] * u[j]
        drive -= p[j, KV] * speed + p[j, RIPPLE] * math.cos(p[j, ORDER] * angle + p[j, PHASE])
        dx[12 + j] = (u[j] - p[j, R] * x[12 + j] - p[j, KB] * speed) / p[j, L] if motors else 0.0
        if geared:
            d, push = angle - x[j], 0.0
            if abs(d) > 0.5 * p[j, GAP]:
                side = 1.0 if d > 0.0 else -1.0
                push = p[j, FLANK] * (abs(d) - 0.5 * p[j, GAP]) + p[j, DAMP] * side * (speed - x[6 + j])
                push = side * max(push, 0.0)
            dx[18 + j], dx[24 + j] = speed, (drive - push) / p[j, ROTOR]
            drive = push
        torque[j] = drive - bias[j]
        if mode[j] == HELD:
            stuck[count] = j
            count += 1
        elif p[j, FC] > 0.0:
            torque[j] -= mode[j] * (p[j, FC] + p[j, DF] * math.exp(-((x[6 + j] / p[j, VS]) ** 2)))
        hold[j] = 0.0
    acceleration = inverse @ torque
    if count > 0:
        a, b = np.empty((count, count)), np.empty(count)
        for m in range(count):
            b[m] = -acceleration[stuck[m]]
            for n in range(count):
                a[m, n] = inverse[stuck[m], stuck[n]]
        needed = np.linalg.solve(a, b)
        for m in range(count):
            hold[stuck[m]] = needed[m]
            for j in range(6):
                acceleration[j] += inverse[j, stuck[m]] * needed[m]
    for j in range(6):
        dx[j], dx[6 + j] = x[6 + j], acceleration[j]
        if mode[j] == HELD:
            dx[j] = dx[6 + j] = 0.0
        if not p[j, GAP] > 0.0:
            dx[18 + j], dx[24 + j] = dx[j], dx[6 + j]


@njit(cache=True)
def _between(s, inverses, biases, inverse, bias):
    """Parabola through the values one sample ago, at the sample's start and at its end, at the share s of it."""
    a, b, c = 0.5 * s * (s - 1.0), 1.0 - s * s, 0.5 * s * (s + 1.0)
    inverse[:] = a * inverses[0] + b * inverses[1] + c * inverses[2]
    bias[:] = a * biases[0] + b * biases[1] + c * biases[2]


@njit(cache=True)
def _runge_kutta(x, s, ds, dt, u, inverses, biases, p, motors, mode, new, work):
    """One step from the share s of the sample over ds of it."""
    inverse, bias, h = np.empty((6, 6)), np.empty(6), ds * dt
    hold = np.empty(6)
    _between(s, inverses, biases, inverse, bias)
    _rates(x, u, inverse, bias, p, motors, mode, work[0], hold)
    _between(s + 0.5 * ds, inverses, biases, inverse, bias)
    _rates(x + 0.5 * h * work[0], u, inverse, bias, p, motors, mode, work[1], hold)
    _rates(x + 0.5 * h * work[1], u, inverse, bias, p, motors, mode, work[2], hold)
    _between(s + ds, inverses, biases, inverse, bias)
    _rates(x + h * work[2], u, inverse, bias, p, motors, mode, work[3], hold)
    new[:] = x + h / 6.0 * (work[0] + 2.0 * work[1] + 2.0 * work[2] + work[3])


@njit(cache=True)
def _first_reversal(x, new, p, mode):
    """Nut whose rate passes zero first, and where in the step by the straight line; -1: none."""
    first, share = -1, 1.0
    for j in range(6):
        if p[j, FC] > 0.0 and mode[j] != HELD and mode[j] * new[6 + j] < 0.0:
            before = mode[j] * x[6 + j]
            there = max(before, 0.0) / (max(before, 0.0) - mode[j] * new[6 + j])
            if there <= share:
                first, share = j, there
    return first, share


@njit(cache=True)
def _release(x, u, s, inverses, biases, p, motors, mode, work):
    """Stuck nuts that need more than their breakaway torque slide, the one that needs most first."""
    inverse, bias, hold = np.empty((6, 6)), np.empty(6), np.empty(6)
    _between(s, inverses, biases, inverse, bias)
    for _ in range(6):
        _rates(x, u, inverse, bias, p, motors, mode, work[0], hold)
        worst, excess = -1, 0.0
        for j in range(6):
            if mode[j] == HELD and abs(hold[j]) - p[j, FC] - p[j, DF] > excess:
                worst, excess = j, abs(hold[j]) - p[j, FC] - p[j, DF]
        if worst < 0:
            return
        mode[worst] = -1 if hold[worst] > 0.0 else 1


@njit(cache=True)
def _sample(x, mode, inputs, inverses, biases, p, motors, dt, trail):
    """Drive the state over one sample; inputs (n, 6) of its n steps; trail (n, 6): encoder angles at their ends."""
    n = inputs.shape[0]
    new, work = np.empty(30), np.empty((4, 30))
    for k in range(n):
        s, end = k / n, (k + 1) / n
        if k == 0 or (inputs[k] != inputs[k - 1]).any():
            _release(x, inputs[k], s, inverses, biases, p, motors, mode, work)
        for _ in range(30):
            ds = end - s
            _runge_kutta(x, s, ds, dt, inputs[k], inverses, biases, p, motors, mode, new, work)
            j, share = _first_reversal(x, new, p, mode)
            if j < 0:
                break
            low, high = 0.0, 1.0
            for _ in range(60):  # regula falsi with halving, to the rounding of the rate
                _runge_kutta(x, s, share * ds, dt, inputs[k], inverses, biases, p, motors, mode, new, work)
                rate = mode[j] * new[6 + j]
                if abs(rate) < 1e-9 or high - low < 1e-9:
                    break
                if rate > 0.0:
                    low = share
                else:
                    high = share
                share = 0.5 * (low + high)
            x[:] = new
            x[6 + j] = 0.0
            if not p[j, GAP] > 0.0:
                x[24 + j] = 0.0
            mode[j] = HELD
            s += share * ds
            _release(x, inputs[k], s, inverses, biases, p, motors, mode, work)
            if end - s < 1e-12:
                new[:] = x
                break
        x[:] = new
        _release(x, inputs[k], end, inverses, biases, p, motors, mode, work)
        for j in range(6):
            trail[k, j] = x[18 + j]


@dataclass(frozen=True)
class Run:
    """Samples of a run, (n, 6) each: what the controller put out, what was read (and without noise), the true motion.

    ``stuck`` counts the samples at which a nut is held by friction, ``flights`` those at which a gap is open.
    """

    t: Array
    u: Array
    readings: Array
    clean: Array
    currents: Array
    phi: Array
    rates: Array
    stuck: Array
    flights: Array
    poses: Array = field(repr=False)


Controller = Callable[[int, Array], Array]


def simulate(
    machine: Machine,
    pose: Array,
    n: int,
    dt: float,
    controller: Controller,
    *,
    rates: Array | None = None,
    currents: Array | None = None,
    push: Array | None = None,
    seen: Callable[[int, Array], Array] = lambda k, y: y,
    step: float = STEP,
) -> Run:
    """Run n samples from a pose: ``u_k = controller(k, seen(k, readings))`` acts from the k-th sample to the next.

    ``seen``: what the encoders make of the delayed angles (6,): noise, rounding. ``push``: torques from outside at the
    nuts, (n, 6), held from sample to sample.
    """
    body, p, drives = mechanism(machine, pose), _numbers(machine), machine.drives
    steps = round(dt / step)
    lag_in = np.round(drives.column("delay_in") / step).astype(int)
    lag_out = np.round(drives.column("delay_out") / step).astype(int)
    offset, legs = drives.column("offset"), np.arange(6)
    x, mode = np.zeros(30), np.zeros(6, np.int64)
    x[:6] = x[18:24] = body.shape.turns * (body.lengths - body.shape.home_length)
    x[6:12] = x[24:30] = 0.0 if rates is None else rates
    x[12:18] = 0.0 if currents is None else currents
    for j in range(6):
        if p[j, FC] > 0:
            mode[j] = HELD if x[6 + j] == 0 else int(np.sign(x[6 + j]))
    angles = np.empty((n * steps + 1, 6))  # at every step
    angles[0] = x[18:24]
    held = np.zeros((n * steps, 6))
    kept: dict[str, list[Array]] = {f.name: [] for f in fields(Run) if f.name != "t"}
    past = now = body.terms(x[:6], x[6:12])
    for k in range(n):
        at = k * steps
        delayed = angles[np.maximum(at - lag_out, 0), legs]
        reading = np.asarray(seen(k, delayed + offset), dtype=np.float64)
        u = np.asarray(controller(k, reading), dtype=np.float64)
        held[at : at + steps] = u
        flights = np.abs(x[18:24] - x[:6]) < 0.5 * p[:, GAP]
        values = u, reading, delayed + offset, x[12:18], x[:6], x[6:12], mode == HELD, flights, body.pose
        for column, value in zip(kept.values(), values, strict=True):
            column.append(np.array(value, dtype=np.float64))
        rows = np.arange(at, at + steps)[:, None] - lag_in
        inputs = np.where(rows >= 0, held[np.maximum(rows, 0), legs], held[0])
        ahead = 2 * now[0] - past[0], 2 * now[1] - past[1]
        # once with terms that go on as before, once with those of where that leads; without a past twice more
        for left in (1, 0) if k else (2, 1, 0):
            trial, trial_mode = x.copy(), mode.copy()
            inverses, biases = (np.ascontiguousarray(np.stack(three)) for three in zip(past, now, ahead, strict=True))
            if push is not None:
                biases -= push[k]
            trail = angles[at + 1 : at + steps + 1]
            _sample(trial, trial_mode, inputs, inverses, biases, p, machine.motors, dt, trail)
            if left:
                ahead = body.terms(trial[:6], trial[6:12])
            if not k:
                past = 2 * now[0] - ahead[0], 2 * now[1] - ahead[1]
        x, mode, past, now = trial, trial_mode, now, ahead
    return Run(np.arange(n) * dt, *(np.array(column) for column in kept.values()))


def bodies(nominal: Mapping[str, float]) -> Any:
    """The oracle's parameters from values in the plant's names, those that a machine's draws change."""
    o, v = oracle(), dict(nominal)
    thesis = o.PHYSICAL
    parts = {}
    for ours, prefix in {"lower_link": "link", "nut": "nut", "ball_screw": "screw", "motor": "motor"}.items():
        body = getattr(thesis, ours)
        inertia = tuple(v.get(f"{prefix}_{a}", i) for a, i in zip("IJK", body.inertia, strict=True))
        parts[ours] = o.Body(v.get(f"{prefix}_mass", body.mass), inertia)
    platform = o.Body(
        v.get("platform_mass", thesis.platform.mass),
        tuple(v.get(f"platform_{a}", i) for a, i in zip("xyz", thesis.platform.inertia, strict=True)),
    )
    return replace(
        thesis, **parts, platform=platform, rotor_inertia=v.get("rotor_J", thesis.rotor_inertia),
        platform_cg=tuple(v.get(f"platform_c{a}", 0.0) for a in "xyz"),
        tilt=(v.get("tilt_x", 0.0), v.get("tilt_y", 0.0)),
    )  # fmt: skip
