r"""The Stewart platform as a plant: six motors turn six nuts, the nuts move the platform.

.. math::
    M(\varphi)\,\ddot\varphi + b(\varphi, \dot\varphi) = k\,\tau, \qquad
    \text{with motors:}\quad \tau = K_m i - K_f k \dot\varphi, \quad L \frac{di}{dt} = u - R i - K_b k \dot\varphi \\
    L_i = |p_{T,i} - d_i|, \quad p_T = T + R p, \quad d = b + c\,y^*, \qquad
    \dot L = K \cdot v + (\rho \times K) \cdot \omega, \qquad \rho = R p
"""
# Březina 2010, eqs 6.1 to 6.8, sections 7.1, 7.2, 8.1, App. A and B (misprints of b6, m2 and m3 corrected), read as in
# ``docs/stewart.md``. Kantorovich, Akilov, "Functional Analysis", 2nd ed., Pergamon 1982, chapter XVIII.

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.display import Displayable
from robustlab.dynamics.equilibrium import descriptor
from robustlab.dynamics.integrator import compiled
from robustlab.dynamics.parameters import Parameter, overridden, published
from robustlab.dynamics.parametric_descriptor import TrimmedDescriptor
from robustlab.dynamics.plant_base import InputSignal, LocalModels, PlantAlong, PortPlace, Trim
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.result import Status
from robustlab.statespace import Signal, real_array

PRESETS = ("thesis", "physical")

_SHEET = "Březina 2010, App. A and section 7.2 (Maxon RE 35, order number 273754)"


def machine_parameters(preset: str, motors: bool) -> tuple[Parameter, ...]:
    """Return the published parameters; preset ``physical`` adds the rotor inertia omitted by the thesis."""
    if preset not in PRESETS:
        hint = did_you_mean(str(preset), PRESETS)
        raise InputError("stewart-platform: preset", f"{preset!r}", " or ".join(map(repr, PRESETS)), hint)
    if not isinstance(motors, bool):
        raise InputError("stewart-platform: motors", f"{motors!r}", "True or False")
    known = published(Path(__file__).with_name("parameters.toml"))
    parameters = (*known["machine"], *(known["motors"] if motors else ()))
    if preset == "thesis":
        return parameters
    rotor = {"value": 7.2e-6, "source": _SHEET}
    return tuple(replace(p, **rotor) if p.name == "rotor_J" else p for p in parameters)


_PAIR = np.repeat([0.0, 1.0, 2.0], 2) * (2 * np.pi / 3)
_SIDE = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # of a leg, in its pair of platform points

# Order of the kernels' constants; see `constants`.
CONSTANTS = (
    "turns", "c", "gravity", "ratio", "platform_mass", "platform_x", "platform_y", "platform_z",
    "m0", "m1", "m2", "x1", "x2", "xz", "screw_mass", "screw_cg",
    "leg_I", "leg_J", "leg_K", "nut_I", "nut_J", "nut_K", "rotor", "R", "L", "Km", "Kb", "Kf",
    "platform_cx", "platform_cy", "platform_cz", "up_x", "up_y", "up_z",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Geometry(Displayable):
    """Points and axes, in m; arrays are read-only."""

    # points b and m in the base frame, shape (6, 3)
    base: Array
    bearing: Array
    platform: Array  # points p in the platform frame, shape (6, 3)
    axis: Array  # unit vectors x* of the first joint axes, shape (6, 3)
    # components of the bodies' axis I along the second joint axis z* and along N = z* x K, shape (6, 2)
    mount: Array
    c: float  # distance between the joint's two axes
    home: Array  # home pose (tx, ty, tz, ax, ay, az), shape (6,)
    home_lengths: Array  # actuator lengths at zero nut angles: those at home except for the offsets, shape (6,)
    limits: tuple[float, float]  # shortest and longest actuator
    turns: float  # nut angle per extension, 2 pi / lead in rad/m

    @property
    def radius(self) -> float:
        """Radius of the platform points, which converts angles to lengths."""
        return math.hypot(self.platform[0, 0], self.platform[0, 1])

    @cached_property
    def legs(self) -> Array:
        """Rows for the kernels: b, x*, p, length at home, mount; shape (6, 12)."""
        return np.column_stack([self.base, self.axis, self.platform, self.home_lengths, self.mount])


def geometry(p: Mapping[str, float]) -> Geometry:
    """Compute points and axes from the parameters."""
    if p["L_min"] >= p["L_max"]:
        raise InputError("stewart-platform: L_min", f"{p['L_min']:g} m", f"less than L_max = {p['L_max']:g} m")
    angle_p = np.pi / 6 + _PAIR + _SIDE * p["alpha_p"]
    angle_b = np.pi / 2 + _PAIR[[5, 0, 1, 2, 3, 4]] - _SIDE * p["alpha_b"]
    base = _circle(p["r_b"], angle_b, 0.0)
    bearing = _circle(p["r_m"], angle_b + _SIDE * p["alpha_m"], p["z_m"])
    axis = bearing - base
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    if (length < 1e-9).any():
        raise InputError("stewart-platform", "bearing points fall on the base points", "another r_m, alpha_m or z_m")
    axis = axis / length
    platform = _circle(p["r_p"], angle_p, 0.0)
    home = np.array([0.0, 0.0, p["z_home"], 0.0, 0.0, 0.0])
    lengths, mount = _assembly(base, axis, platform + home[:3], p["c"])
    turns = 2 * np.pi / p["lead"]
    lengths = lengths - np.array([p[f"offset_{i}"] for i in range(1, 7)]) / turns
    limits = p["L_min"], p["L_max"]
    made = Geometry(base, bearing, platform, axis, mount, p["c"], home, lengths, limits, turns)
    for array in (made.base, made.bearing, made.platform, made.axis, made.mount, made.home, made.home_lengths):
        array.setflags(write=False)
    return made


def _assembly(base: Array, axis: Array, top: Array, c: float) -> tuple[Array, Array]:
    """Return lengths at home and mount: the legs are assembled with I = (-1)^i K x e_z / |K x e_z| (eq. 7.2)."""
    w = top - base
    y = w - np.sum(w * axis, axis=1)[:, None] * axis
    reach = np.linalg.norm(y, axis=1, keepdims=True)
    if (reach <= c).any():
        expected = f"less than {reach.min():.6g} m, the joint's distance at home"
        raise InputError("stewart-platform: c", f"{c:g} m", expected)
    y = y / reach
    k = w - c * y
    lengths = np.linalg.norm(k, axis=1)
    k = k / lengths[:, None]
    z = np.cross(axis, y)
    i = _SIDE[:, None] * np.cross(k, [0.0, 0.0, 1.0])
    i = i / np.linalg.norm(i, axis=1, keepdims=True)
    return lengths, np.column_stack([np.sum(i * z, axis=1), np.sum(i * np.cross(z, k), axis=1)])


def constants(p: Mapping[str, Any]) -> Array:
    """Return the constants of the equations of motion besides the legs' geometry, in the order of `CONSTANTS`."""
    link, nut, motor = p["link_mass"], p["nut_mass"], p["motor_mass"]
    at_link, at_nut, at_motor = p["link_cg"], p["nut_at"] + p["nut_cg"], p["motor_at"] + p["motor_cg"]
    turns, x = 2 * np.pi / p["lead"], p["motor_x"]
    about_x, about_y = p["tilt_x"], p["tilt_y"]
    made = {
        "turns": turns,
        "m0": link + nut + motor,
        "m1": link * at_link + nut * at_nut + motor * at_motor,
        "m2": link * at_link**2 + nut * at_nut**2 + motor * at_motor**2,
        "x1": motor * x,
        "x2": motor * x**2,
        "xz": motor * x * at_motor,
        **{f"leg_{a}": p[f"link_{a}"] + p[f"screw_{a}"] + p[f"motor_{a}"] for a in "IJK"},
        "rotor": p["rotor_J"] * (p["ratio"] * turns) ** 2,
        "up_x": -np.sin(about_y),
        "up_y": np.sin(about_x) * np.cos(about_y),
        "up_z": np.cos(about_x) * np.cos(about_y),
    }
    columns = [made[name] if name in made else p.get(name, 0.0) for name in CONSTANTS]
    return np.stack(np.broadcast_arrays(*columns), axis=-1).astype(np.float64)


def check_bodies(p: Mapping[str, float]) -> None:
    """Reject inertias of no rigid body: each principal one is at most the sum of the others."""
    for body, axes in {"platform": "xyz", **dict.fromkeys(("link", "nut", "screw", "motor"), "IJK")}.items():
        inertia = np.array([p[f"{body}_{a}"] for a in axes])
        if 2 * inertia.max() > inertia.sum() * (1 + 1e-12):
            found = f"principal inertias {', '.join(f'{value:g}' for value in inertia)} kg m2"
            hint = f"override {', '.join(f'{body}_{a}' for a in axes)} together"
            expected = "no one larger than the sum of the other two (triangle inequality)"
            raise InputError(f"stewart-platform: {body}", found, expected, hint)


def _circle(radius: float, angle: Array, z: float) -> Array:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(6, z)])


# --- kinematics -------------------------------------------------------------------------------------------------------


@cache
def kernels() -> ModuleType:
    text = "stewart-platform: compiling the equations of motion (once on this machine, a minute or two) ..."
    return compiled("stewart.kernels", text)


# Limit of Newton steps of the direct kinematics; a pose needs four or five.
LIMIT = 60


def poses_array(value: ArrayLike, name: str = "pose", where: str = "stewart-platform") -> tuple[Array, bool]:
    """Return one pose (6,) or many (n, 6) as a finite array (n, 6), and whether it was one."""
    one = np.ndim(value) == 1
    array = real_array(name, value, 1 if one else 2, where)
    if array.shape[-1] != 6:
        raise InputError(where, f"{name} has shape {array.shape}", "(6,) or (n, 6)")
    return np.array(array.reshape(-1, 6), order="C"), one  # writable, as required by the kernels


def inverse_kinematics(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return actuator lengths in m at the poses (6,) or (n, 6), of the same shape."""
    array, one = poses_array(poses)
    lengths = np.empty_like(array)
    kernels().inverse_lengths(array, geometry.legs, geometry.c, lengths)
    return lengths[0] if one else lengths


def nut_angles(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return nut angles phi = 2 pi / lead (L - L(home)) in rad at the poses (6,) or (n, 6); positive: extension."""
    return geometry.turns * (inverse_kinematics(geometry, poses) - geometry.home_lengths)


def velocity_jacobian(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return J of dL/dt = J (v, omega), shape (6, 6) or (n, 6, 6); times ``geometry.turns``: nut rates."""
    array, one = poses_array(poses)
    matrices = np.empty((len(array), 6, 6))
    kernels().jacobians(array, geometry.legs, geometry.c, np.empty_like(array), matrices)
    return matrices[0] if one else matrices


@dataclass(frozen=True, eq=False)
class DirectPoses:
    """Poses found by Newton's method, each with its certificate; arrays of n rows."""

    poses: Array  # shape (n, 6)
    # true where the Newton-Kantorovich theorem proves a unique pose within ``radius``
    proved: NDArray[np.bool_]
    # Kantorovich's number (at most 1/2), and the bound on |dT|, r_p |d angles| to the exact pose in m
    h: Array
    radius: Array

    @property
    def pose(self) -> Array:
        """The pose (6,) if there is only one."""
        if len(self.poses) != 1:
            raise InputError("DirectPoses.pose", f"{len(self.poses)} poses", "one; take .poses")
        return self.poses[0]

    @property
    def status(self) -> Status:
        return Status.CERTIFIED if self.proved.all() else Status.INCONCLUSIVE


def direct_kinematics(geometry: Geometry, lengths: ArrayLike, start: ArrayLike | None = None) -> DirectPoses:
    """Find the poses for these actuator lengths."""
    target, _ = poses_array(lengths, "lengths")
    if (target <= 0).any():
        k, i = np.argwhere(target <= 0)[0]
        raise InputError("direct_kinematics", f"lengths[{k},{i}] = {target[k, i]:g} m", "positive lengths")
    seed, one = poses_array(geometry.home if start is None else start, "start")
    if not one and len(seed) != len(target):
        raise InputError("direct_kinematics", f"{len(seed)} starts", f"1 or {len(target)}, one for each row of lengths")
    seeds = np.array(np.broadcast_to(seed, target.shape), order="C")
    poses, facts = np.empty_like(target), np.empty((len(target), 4))
    kernels().direct_poses(target, seeds, geometry.legs, geometry.c, LIMIT, poses, facts)
    proved = (facts[:, 0] >= 0) & (facts[:, 1] <= 0.5)  # facts: Newton steps (-1: singular), h, radius, residual
    return DirectPoses(poses, proved, facts[:, 1], facts[:, 2])


# Allowed excess of a limit in m: rounding of a published limit pose.
SLACK = 1e-9
# Ratio of singular values below which a pose counts as singular: six digits of the torques are lost.
SINGULAR = 1e-6


def inside(geometry: Geometry, poses: ArrayLike) -> NDArray[np.bool_]:
    """Return where all six actuators are within their limits, shape (n,)."""
    array, _ = poses_array(poses)
    lengths = inverse_kinematics(geometry, array)
    low, high = geometry.limits
    return np.asarray(((lengths >= low - SLACK) & (lengths <= high + SLACK)).all(axis=1))


def singularity(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return the smallest and largest singular value of the dimensionless Jacobian, shape (2,) or (n, 2)."""
    array, one = poses_array(poses)
    jacobian = velocity_jacobian(geometry, array)
    jacobian[:, :, 3:] /= geometry.radius
    sigma = np.linalg.svd(jacobian, compute_uv=False)[:, [5, 0]]
    return np.asarray(sigma[0] if one else sigma, dtype=np.float64)


def check_pose(geometry: Geometry, pose: ArrayLike, where: str) -> Array:
    """Return the pose (6,) if it is within the workspace and not singular."""
    array = real_array_of_one(pose, where)
    lengths = inverse_kinematics(geometry, array)
    low, high = geometry.limits
    count = int(((lengths < low - SLACK) | (lengths > high + SLACK)).sum())
    if count:
        i = int(np.argmax(np.maximum(low - lengths, lengths - high)))
        more = f" ({count} of 6 actuators are out of range)" if count > 1 else ""
        found = f"pose out of the workspace: actuator {i + 1} would be {1e3 * lengths[i]:.6g} mm{more}"
        hint = "the limits are the parameters L_min and L_max"
        raise InputError(where, found, f"{1e3 * low:.6g} .. {1e3 * high:.6g} mm", hint)
    smallest, largest = singularity(geometry, array)
    if not smallest > SINGULAR * largest:
        found = f"singular pose: the Jacobian's smallest singular value is {smallest:.3g}"
        raise NoTrustworthyNumber(where, found, None, "the actuators cannot hold the platform there")
    return array


def real_array_of_one(pose: ArrayLike, where: str) -> Array:
    """Return one finite pose of shape (6,)."""
    array, one = poses_array(pose, "pose", where)
    if not one:
        raise InputError(where, f"{len(array)} poses", "one pose (tx, ty, tz, ax, ay, az)")
    return array[0]


# --- the plant --------------------------------------------------------------------------------------------------------

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
        z, code = np.empty((len(signal.t), len(x0))), kernels()
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
