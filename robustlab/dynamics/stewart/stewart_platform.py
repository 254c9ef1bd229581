r"""The Stewart platform as a plant: six motors turn six nuts, the nuts move the platform.

.. math::
    M(\varphi)\,\ddot\varphi + b(\varphi, \dot\varphi) = k\,\tau, \qquad
    \text{with motors:}\quad \tau = K_m i - K_f k \dot\varphi, \quad L \frac{di}{dt} = u - R i - K_b k \dot\varphi
"""
# Březina 2010, sections 6.1, 7.1, 7.2, 8.1; the interpretation is in ``docs/stewart.md``.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.descriptor_family import TrimmedDescriptor
from robustlab.dynamics.parameters import overridden
from robustlab.dynamics.plant_contract import InputSignal, LocalModels, PlantAlong, PortPlace, Trim
from robustlab.dynamics.rest import descriptor
from robustlab.dynamics.stewart.geometry import (
    CONSTANTS,
    Geometry,
    check_bodies,
    constants,
    geometry,
    machine_parameters,
)
from robustlab.dynamics.stewart.kinematics import (
    SINGULAR,
    SLACK,
    check_pose,
    direct_kinematics,
    kernels,
    motion_kernels,
    nut_angles,
    poses_array,
    real_array_of_one,
    singularity,
    velocity_jacobian,
)
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import Signal, real_array

NAME = "stewart-platform"
IMAGINARY = 1e-40  # complex step of derivatives, without cancellation


def motion(geometry: Geometry, x: Array) -> tuple[Array, Array]:
    """Return poses and twists (n, 6) of the states (n, 12 or 18)."""
    return _cached_motion(geometry, np.ascontiguousarray(x[:, :12]).tobytes())


@lru_cache(maxsize=64)
def _cached_motion(geometry: Geometry, states: bytes) -> tuple[Array, Array]:
    """Return the cached `motion`, which is independent of masses and motors."""
    x = np.frombuffer(states).reshape(-1, 12)
    poses = _proved_poses(geometry, x[:, :6])
    matrix = np.empty((len(x), 6, 6))
    kernels().jacobians(poses, geometry.legs, geometry.c, np.empty_like(poses), matrix)
    twists = np.linalg.solve(geometry.turns * matrix, x[:, 6:, None])[..., 0]
    return poses, np.ascontiguousarray(twists)


def _proved_poses(geometry: Geometry, phi: Array, start: ArrayLike | None = None, hint: str | None = None) -> Array:
    """Return poses (n, 6) at the nut angles (n, 6), proved by `direct_kinematics`."""
    lengths = geometry.home_lengths + phi / geometry.turns
    if not (lengths > 0).all():
        row = int(np.argmin((lengths > 0).all(axis=1)))
        raise NoTrustworthyNumber(NAME, f"the nut angles of point {row} make an actuator shorter than nothing")
    found = direct_kinematics(geometry, lengths, start)
    if not found.proved.all():
        row = int(np.argmin(found.proved))
        raise NoTrustworthyNumber(NAME, f"no pose with the nut angles of point {row} was found", None, hint)
    return found.poses


def torques(values: Mapping[str, float], x: Array, u: Array) -> Array:
    """Return the motor torques (n, 6): the inputs, or with motors (18 states) those of currents and speeds."""
    if x.shape[1] == 12:
        return np.array(u, order="C")
    return values["Km"] * x[:, 12:] - values["Kf"] * values["ratio"] * x[:, 6:12]


_NUMBERS = range(1, 7)
# Largest residual of a trim relative to free fall.
ROUNDING = 1e-9
# Parameters of the legs' geometry; the others only enter `constants`.
_SHAPE = (
    *("r_b", "alpha_b", "r_p", "alpha_p", "r_m", "alpha_m", "z_m", "c", "z_home", "L_min", "L_max", "lead"),
    *(f"offset_{i}" for i in _NUMBERS),
)


def stewart_platform(*, preset: str = "thesis", motors: bool = False, **given: Any) -> StewartPlatform:
    """Return the plant with six motor torques [N m] as inputs, or with motors six voltages [V]."""
    parameters = overridden(machine_parameters(preset, motors), given, "stewart-platform")
    angles = tuple(Signal(f"phi_{i}", "rad") for i in _NUMBERS)
    rates = tuple(Signal(f"phidot_{i}", "rad/s") for i in _NUMBERS)
    currents = tuple(Signal(f"i_{i}", "A") for i in _NUMBERS) if motors else ()
    inputs = tuple(Signal(f"u_{i}", "V") if motors else Signal(f"torque_{i}", "N m") for i in _NUMBERS)
    return StewartPlatform(
        "stewart-platform", parameters, inputs, (*angles, *rates), (*angles, *rates, *currents), preset, motors
    )


@dataclass(frozen=True, eq=False, repr=False)
class StewartPlatform(PlantAlong):
    """A Stewart platform; made by `stewart_platform`."""

    preset: str
    motors: bool
    geometry: Geometry = field(init=False)
    constants: Array = field(init=False)  # of the equations of motion, (34,)

    def __post_init__(self) -> None:
        super().__post_init__()
        values = self.values
        check_bodies(values)
        object.__setattr__(self, "geometry", geometry(values))
        object.__setattr__(self, "constants", constants(values))
        self.constants.setflags(write=False)

    def poses(self, phi: ArrayLike, start: ArrayLike | None = None) -> Array:
        """Return poses (n, 6) at the nut angles (n, 6), or (6,) at (6,); proved by `direct_kinematics`."""
        angles, one = poses_array(phi, "phi")
        poses = _proved_poses(self.geometry, angles, start, "give a start near to it")
        return poses[0] if one else poses

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        return x[:, :12]

    def check_reach(self, t: Array, x: Array) -> None:
        lengths = self.geometry.home_lengths + x[:, :6] / self.geometry.turns
        low, high = self.geometry.limits
        beyond = ((lengths < low - SLACK) | (lengths > high + SLACK)).any(axis=1)
        if beyond.any():
            time, reach = float(t[int(np.argmax(beyond))]), f"{1e3 * low:g} .. {1e3 * high:g} mm"
            found = f"an actuator reaches the end of its range ({reach}) at t = {time:.6g} s"
            hint = "the platform falls with its torques held: simulate less, close a loop, or widen L_min, L_max"
            raise NoTrustworthyNumber(self.name, found, None, hint)

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        nuts = tuple(PortPlace(f"phidot_{i}", "joint", "N m", f"phi_{i}") for i in _NUMBERS)
        return nuts + tuple(PortPlace(f"i_{i}", "current", "V") for i in _NUMBERS if self.motors)

    def local_models(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> LocalModels:
        shape, numbers, p = self._at(values)
        return self._local(motion(shape, x), shape, numbers, p, x, u)

    def jacobians_at(self, trim: Trim) -> tuple[Array, Array, Array, Array]:
        if trim.pose is None:
            return self.jacobians(trim.x, trim.u)
        x, u = self.point(trim.x, trim.u)
        at = np.array(trim.pose[None]), np.zeros((1, 6))
        local = self._local(at, *self._at(None), x[None], u[None])
        return local.A[0], local.B[0], local.C[0], local.D[0]

    def rates_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        shape, numbers, p = self._at(values)
        return self._rates(motion(shape, x), shape, numbers, p, x, u)

    def _local(
        self, at: tuple[Array, Array], shape: Geometry, numbers: Array, p: Mapping[str, float], x: Array, u: Array
    ) -> LocalModels:
        """Return the local models at known poses and twists."""
        n, size, one = len(x), len(self.states), np.eye(6)
        try:
            stiffness, damping, gain = _slopes(shape, numbers, at, torques(p, x, u))
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber(self.name, "singular pose: no linear model in nut coordinates") from None
        a, b, push = np.zeros((n, size, size)), np.zeros((n, size, 6)), np.zeros((n, size, size - 6))
        a[:, :6, 6:12], a[:, 6:12, :6], a[:, 6:12, 6:12] = one, stiffness, damping
        push[:, 6:12, :6] = gain / p["ratio"]
        if self.motors:
            a[:, 6:12, 6:12] -= gain * p["Kf"] * p["ratio"]
            a[:, 6:12, 12:] = gain * p["Km"]
            a[:, 12:, 6:12], a[:, 12:, 12:] = -p["Kb"] * p["ratio"] / p["L"] * one, -p["R"] / p["L"] * one
            b[:, 12:] = push[:, 12:, 6:] = one / p["L"]
        else:
            b[:, 6:12] = gain
        c = np.broadcast_to(np.eye(12, size), (n, 12, size))
        rates = self._rates(at, shape, numbers, p, x, u)
        return LocalModels(rates, self.outputs_along(x, u), a, b, c, np.zeros((n, 12, 6)), push)

    def _rates(
        self, at: tuple[Array, Array], shape: Geometry, numbers: Array, p: Mapping[str, float], x: Array, u: Array
    ) -> Array:
        """Return the rates at known poses and twists."""
        of = _equations(shape, numbers, *at)
        push = _force(of, p["ratio"] * torques(p, x, u))
        found = of.bias + (of.jacobian @ np.linalg.solve(of.mass, push[..., None]))[..., 0]
        if not self.motors:
            return np.hstack([x[:, 6:12], found])
        current = (u - p["R"] * x[:, 12:] - p["Kb"] * p["ratio"] * x[:, 6:12]) / p["L"]
        return np.hstack([x[:, 6:12], found, current])

    def _at(self, values: Mapping[str, float] | None) -> tuple[Geometry, Array, Mapping[str, float]]:
        """Return geometry, constants and values at parameter values; recompute the geometry only if it changes."""
        if values is None:
            return self.geometry, self.constants, self.values
        own = self.values
        same = all(values[name] == own[name] for name in _SHAPE)
        return self.geometry if same else geometry(values), constants(values), values

    def equilibrium(self, pose: ArrayLike | None = None, phi: ArrayLike | None = None, **unknown: Any) -> Trim:
        if unknown:
            raise InputError(f"{self.name}: trim", f"{next(iter(unknown))!r}", "pose or phi")
        if pose is not None and phi is not None:
            raise InputError(f"{self.name}: trim", "pose and phi", "one of them")
        if phi is not None:
            pose = self.poses(real_array("phi", phi, 1, self.name))
        at = check_pose(self.geometry, self.geometry.home if pose is None else pose, self.name)
        rest = at[None], np.zeros((1, 6))
        x, u = self._held(*self._at(None), at)
        residual = float(np.abs(self._rates(rest, *self._at(None), x[None], u[None])).max())
        # free fall accelerates a nut by about turns * gravity
        still = residual <= ROUNDING * max(self.geometry.turns * abs(self.values["gravity"]), 1.0)
        status = Status.CONVERGED if still else Status.INACCURATE
        return Trim(self.name, x, u, x[:12].copy(), residual, at.copy(), status)

    def _held(self, shape: Geometry, numbers: Array, p: Mapping[str, float], pose: Array) -> tuple[Array, Array]:
        """Return states and inputs at rest at a pose."""
        of = _equations(shape, numbers, np.array(pose[None]), np.zeros((1, 6)))
        try:
            torque = np.linalg.solve(of.jacobian[0].T, of.force[0]) / p["ratio"]
        except np.linalg.LinAlgError:
            found = "singular pose: the actuators cannot hold the platform there"
            raise NoTrustworthyNumber(self.name, found) from None
        x = np.concatenate([of.phi[0], np.zeros(6)])
        return (np.concatenate([x, torque / p["Km"]]), p["R"] * torque / p["Km"]) if self.motors else (x, torque)

    def trimmed_descriptor(
        self, trim: Trim, hold: Sequence[str] | None, tried: Mapping[str, Mapping[str, float]]
    ) -> TrimmedDescriptor:
        if hold is not None:
            raise InputError(f"{self.name}: hold", f"{', '.join(hold)}", "None: the pose is held")
        pose = self.poses(trim.x[:6]) if trim.pose is None else trim.pose
        # limits of the travel do not matter at the point
        limits = {name: self.values[name] for name in ("L_min", "L_max")}

        def matrices(values: Mapping[str, float]) -> Array:
            p = {**values, **limits}
            known = geometry(p), constants(p), p
            x, u = self._held(*known, pose)
            local = self._local((np.array(pose[None]), np.zeros((1, 6))), *known, x[None], u[None])
            return descriptor(local, range(6, len(x)))

        follow = "torques, currents and voltages" if self.motors else "torques"
        return TrimmedDescriptor(matrices, f"the pose is held, the {follow} follow")

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        pose, twist = motion(self.geometry, x0[None])
        start = np.concatenate([pose[0], twist[0], x0[12:]])
        z, code = np.empty((len(signal.t), len(x0))), motion_kernels()
        inputs = code.Inputs(np.array(signal.t), np.ascontiguousarray(signal.coefficients), signal.broken)
        machine = code.machine(self.geometry.legs, np.array(self.constants), self.motors)
        outcome, time, count, _ = code.integrate(start, inputs, machine, rtol, z)
        made, twist = np.array(z[:count, :6]), z[:count, 6:12]
        turned = self.geometry.turns * (velocity_jacobian(self.geometry, made) @ twist[..., None])[..., 0]
        states = np.hstack([nut_angles(self.geometry, made), turned, z[:count, 12:]])
        self.check_reach(signal.t[:count], states)
        if outcome != code.DONE:
            words = "the step became too small" if outcome == code.NOT_FINITE else "too many steps"
            raise NoTrustworthyNumber(self.name, f"no solution beyond t = {time:.9g} s: {words}")
        return states


class _Bodies(NamedTuple):
    """Masses (n, 6, 6), forces (n, 6), nut Jacobians (n, 6, 6) and biases in the twist; nut angles (n, 6)."""

    mass: Any
    force: Any
    jacobian: Any
    bias: Any
    phi: Any


def _equations(shape: Geometry, numbers: Array, poses: Any, twists: Any) -> _Bodies:
    """Evaluate the equations of motion at poses and twists (n, 6), real or complex."""
    n, kind = len(poses), poses.dtype
    (mass, jacobian), (force, bias, phi) = np.empty((2, n, 6, 6), kind), np.empty((3, n, 6), kind)
    every = np.array(np.broadcast_to(numbers, (n, len(numbers))), order="C")
    kernels().equations(poses, twists, shape.legs, every, mass, force, jacobian, bias, phi)
    return _Bodies(mass, force, jacobian, bias, phi)


def _force(of: _Bodies, push: Array) -> Array:
    """Return the accelerating force of the platform under torques at the nuts (n, 6)."""
    return (np.swapaxes(of.jacobian, 1, 2) @ push[..., None])[..., 0] - of.force


def _slopes(shape: Geometry, numbers: Array, at: tuple[Array, Array], torque: Array) -> tuple[Array, Array, Array]:
    """Return d(phidd)/d(phi, dphi, torque), each (n, 6, 6), at fixed torques."""
    (poses, twists), n, push = at, len(torque), numbers[CONSTANTS.index("ratio")] * torque
    of, count = _equations(shape, numbers, poses, twists), 12 if twists.any() else 6
    # complex steps of each coordinate, then of each velocity
    z = np.repeat(np.hstack([poses, twists]).astype(np.complex128)[None], count, axis=0)
    z[range(count), :, range(count)] += 1j * IMAGINARY
    q, v = (np.ascontiguousarray(z[..., part].reshape(-1, 6)) for part in (slice(6), slice(6, 12)))
    by = [(part.imag / IMAGINARY).reshape(count, n, *part.shape[1:]) for part in _equations(shape, numbers, q, v)]
    mass, force, jacobian, bias, phi = by
    turned, free = np.swapaxes(of.jacobian, 1, 2), np.linalg.solve(of.mass, _force(of, push)[..., None])
    right = (np.swapaxes(jacobian, 2, 3) @ push[..., None] - mass @ free)[..., 0] - force
    rates = np.moveaxis(bias + (jacobian @ free)[..., 0], 0, 2)
    rates = rates + of.jacobian @ np.linalg.solve(of.mass, np.moveaxis(right, 0, 2))
    damping = np.zeros((n, 6, 6)) if count == 6 else _right_solved(rates[..., 6:], of.jacobian)
    speeds = np.moveaxis((jacobian[:6] @ twists[..., None])[..., 0], 0, 2)
    stiffness = _right_solved(rates[..., :6] - damping @ speeds, np.moveaxis(phi[:6], 0, 2))
    return stiffness, damping, numbers[CONSTANTS.index("ratio")] * of.jacobian @ np.linalg.solve(of.mass, turned)


def _right_solved(left: Array, right: Array) -> Array:
    """Return X with X right = left, of matrices (n, 6, 6)."""
    return np.swapaxes(np.linalg.solve(np.swapaxes(right, 1, 2), np.swapaxes(left, 1, 2)), 1, 2)


def _at_nuts(plant: StewartPlatform, pose: Array, phidot: Array) -> tuple[Array, Array]:
    """Return mass matrix and bias torques at the nuts at one pose and nut rates (6,)."""
    smallest, largest = singularity(plant.geometry, pose)
    if not smallest > SINGULAR * largest:
        raise NoTrustworthyNumber(plant.name, f"singular pose: smallest singular value {smallest:.3g}")
    at = np.array(pose[None])
    inverse = np.linalg.inv(_equations(plant.geometry, plant.constants, at, np.zeros((1, 6))).jacobian[0])
    of = _equations(plant.geometry, plant.constants, at, np.array((inverse @ phidot)[None]))
    return inverse.T @ of.mass[0] @ inverse, inverse.T @ (of.force[0] - of.mass[0] @ (inverse @ of.bias[0]))


def mass_matrix(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """Return M in kg m2 at the nuts, shape (6, 6)."""
    return _at_nuts(plant, real_array_of_one(pose, plant.name), np.zeros(6))[0]


def bias_torque(plant: StewartPlatform, pose: ArrayLike, phidot: ArrayLike) -> Array:
    """Return torques b in N m at the nuts: gravity and velocity terms at the nut rates phidot (6,)."""
    return _at_nuts(plant, real_array_of_one(pose, plant.name), real_array("phidot", phidot, 1, plant.name))[1]
