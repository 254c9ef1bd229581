r"""Rigid-body dynamics of the Stewart platform in nut coordinates, and dry friction at its nuts.

.. math:: M(\varphi)\,\ddot\varphi + b(\varphi, \dot\varphi) = k\,u, \qquad M = J^{-T} M_V J^{-1}

with u the motor torques and :math:`M_V` the mass matrix in the platform's twist, to which every body of every leg
contributes: lower link and motor body (mounted at home, riding on the joint), nut (turning by phi about K), ball screw
(sliding without turning), reflected rotor :math:`J_r k^2`.

Dry friction takes fixed time steps, with exact sticking. With the nut rates :math:`v = \dot\varphi`, the mass matrix M
at the nuts and friction torques :math:`\lambda` there, a step of length h goes through the middle position (Moreau's
midpoint rule):

.. math::
    \varphi_m = \varphi + \tfrac h2 v, \qquad
    v^+ = v + h \, a(\varphi_m, v, u) + h M(\varphi_m)^{-1} \lambda, \qquad
    \varphi^+ = \varphi_m + \tfrac h2 v^+

where :math:`\lambda` and :math:`v^+` satisfy Coulomb's law *together*: :math:`v_i^+ = 0` and
:math:`|\lambda_i| \le F_i`, or :math:`\lambda_i = -F_i \operatorname{sgn} v_i^+`. These are the optimality conditions
of one convex quadratic programme in a box; the torques that hold are solved for, so a nut that sticks has the rate zero
and not a small one. The scheme is of second order between changes and of first order across them; friction never adds
energy.

References
----------
Březina 2010, section 7.1 and App. A; Moreau, "Unilateral contact and dry friction in finite freedom dynamics" (1988);
Acary, Brogliato, *Numerical Methods for Nonsmooth Dynamical Systems* (2008), chapter 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.dynamics.dry_friction import DryFriction, FrictionEvent, StickSlip
from robustlab.dynamics.plant_contract import Trim
from robustlab.dynamics.simulation import recorded, sampled_inputs
from robustlab.dynamics.stewart.geometry import up
from robustlab.dynamics.stewart.kinematics import (
    SINGULAR,
    check_pose,
    kernels,
    real_array_of_one,
    rotation,
    singularity,
)
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.dynamics.tuning import TUNING, DynamicsTuning
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.record import Record
from robustlab.statespace import real_array


def nut_to_twist(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """J^-1 of ``V = J^-1 dphi/dt``, shape (6, 6). Raises NoTrustworthyNumber: a singular pose."""
    array = real_array_of_one(pose, plant.name)
    smallest, largest = singularity(plant.geometry, array)
    if not smallest > SINGULAR * largest:
        raise NoTrustworthyNumber(plant.name, f"singular pose: smallest singular value {smallest:.3g}")
    return np.asarray(np.linalg.inv(_equations(plant, array, np.zeros(6))[2]), dtype=np.float64)


def mass_matrix(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """M in kg m2 at the nuts, shape (6, 6)."""
    inverse = nut_to_twist(plant, pose)
    mass = _equations(plant, real_array_of_one(pose, plant.name), np.zeros(6))[0]
    return np.asarray(inverse.T @ mass @ inverse, dtype=np.float64)


def bias_torque(plant: StewartPlatform, pose: ArrayLike, phidot: ArrayLike) -> Array:
    """Torques b in N m at the nuts: gravity and velocity terms at the nut rates phidot (6,)."""
    inverse = nut_to_twist(plant, pose)
    array, rates = real_array_of_one(pose, plant.name), real_array("phidot", phidot, 1, plant.name)
    mass, force, _, bias = _equations(plant, array, inverse @ rates)
    return inverse.T @ (force - mass @ (inverse @ bias))


def trim_torque(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """Motor torques in N m that hold the pose, shape (6,); the pose must be within the workspace."""
    return bias_torque(plant, check_pose(plant.geometry, pose, plant.name), np.zeros(6)) / plant.values["ratio"]


def kinetic_energy(plant: StewartPlatform, pose: ArrayLike, phidot: ArrayLike) -> float:
    """1/2 phidot^T M phidot in J."""
    rates = real_array("phidot", phidot, 1, plant.name)
    return float(0.5 * rates @ mass_matrix(plant, pose) @ rates)


def potential_energy(plant: StewartPlatform, pose: ArrayLike) -> float:
    """Sum of m g times height over all bodies in J; zero where every centre of gravity is as high as the origin."""
    g, p, array = plant.geometry, plant.values, real_array_of_one(pose, plant.name)
    top = array[:3] + g.platform @ rotation(array).T
    w = top - g.base
    y = w - np.sum(w * g.axis, axis=1)[:, None] * g.axis
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    joint = g.base + g.c * y
    k = (top - joint) / np.linalg.norm(top - joint, axis=1, keepdims=True)
    z = np.cross(g.axis, y)
    i = g.mount[:, :1] * z + g.mount[:, 1:] * np.cross(z, k)
    middle = array[:3] + rotation(array) @ [p[f"platform_c{a}"] for a in "xyz"]
    height = p["platform_mass"] * float(middle @ up(p)) + sum(
        p[f"{body}_mass"] * float(np.sum(points @ up(p)))
        for body, points in {
            "link": joint + p["link_cg"] * k,
            "nut": joint + (p["nut_at"] + p["nut_cg"]) * k,
            "screw": top - p["screw_cg"] * k,
            "motor": joint + (p["motor_at"] + p["motor_cg"]) * k + p["motor_x"] * i,
        }.items()
    )
    return float(p["gravity"] * height)


def _equations(plant: StewartPlatform, pose: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
    """Mass matrix, forces, nut Jacobian and bias in the platform's twist."""
    mass, jacobian = np.empty((6, 6)), np.empty((6, 6))
    force, bias = np.empty(6), np.empty(6)
    kernels().equations(
        np.array(pose),
        np.array(twist),
        plant.geometry.legs,
        np.array(plant.constants),
        mass,
        force,
        jacobian,
        bias,
        np.empty(6),
    )
    return mass, force, jacobian, bias


def simulate_platform_with_friction(
    plant: StewartPlatform,
    friction: DryFriction | Sequence[DryFriction],
    t: ArrayLike,
    u: Mapping[str, ArrayLike] | ArrayLike,
    x0: Trim | ArrayLike | None = None,
    *,
    step: float = 1e-4,
    name: str | None = None,
) -> StickSlip:
    """Response of the platform, driven by torques, with dry friction at some of its nuts.

    ``plant``: a Stewart platform without motors.
    ``friction``: one for each nut that has any: ``DryFriction("phidot_1", coulomb, static)``, torques at the nut in N
    m.
    ``t``: sample times in s.
    ``u``: motor torques at the samples, held until the next one.
    ``x0``: start, home at rest where left out.
    ``step``: longest time step in s.
    Returns: events carry the end of the step in which they happened.
    Raises InputError: a plant with motors, a velocity that is no nut rate, two frictions on one nut, a moving surface.
    NoTrustworthyNumber: the platform leaves its workspace; the message names the time.
    """
    where = "simulate_platform_with_friction"
    if plant.motors:
        raise InputError(where, "a platform with motors", "motors=False: torques as inputs")
    number(f"{where}: step", step, "a positive time in s", above=0)
    joints = (friction,) if isinstance(friction, DryFriction) else tuple(friction)
    slide, hold = _limits(plant, joints)
    clock = Record(t, name=where).t
    samples = sampled_inputs(plant.inputs, u, len(clock))
    start = plant.equilibrium().x if x0 is None else x0.x if isinstance(x0, Trim) else real_array("x0", x0, 1, where)
    if len(start) != 12:
        raise InputError(where, f"x0 has {len(start)} entries", "12")
    x, torque = np.empty((len(clock), 12)), np.zeros((len(clock), 6))
    x[0] = start
    pose = plant.poses(start[:6])
    events: list[FrictionEvent] = []
    motion = np.sign(start[6:])
    for k in range(len(clock) - 1):
        parts = int(np.ceil((clock[k + 1] - clock[k]) / step - 1e-9))
        h, state = (clock[k + 1] - clock[k]) / parts, x[k]
        for part in range(parts):
            time = clock[k] + (part + 1) * h
            state, pose, torque[k] = _step(plant, state, pose, samples[k], h, slide, hold, time)
            now = np.sign(state[6:])
            changed = [i for i in np.flatnonzero(now != motion) if hold[i] > 0]
            events += [FrictionEvent(float(time), plant.states[6 + i].name, int(now[i])) for i in changed]
            motion = now
        x[k + 1] = state
    torque[-1] = torque[-2]
    at = [_nut(plant, joint) for joint in joints]
    record = recorded(plant, clock, samples, x, name or plant.name)
    return StickSlip(record, x, torque[:, at], np.sign(x[:, 6:])[:, at].astype(np.int8), tuple(events))


def friction_torques(
    response: Array, free: Array, rates: Array, slide: Array, hold: Array, tuning: DynamicsTuning = TUNING
) -> tuple[Array, Array]:
    r"""Friction torques and the rates after the step, ``v = free + response @ torques``, by Coulomb's law.

    ``response``: ``h M^-1``, symmetric and positive definite, shape (n, n). ``free``: rates after a step without
    friction, (n,). ``rates``: rates before it: a joint at exactly zero sticks, and its static torque holds it.
    ``slide``, ``hold``: F_c and F_s of each joint, (n,).
    """
    bound = np.where(rates == 0, hold, slide)
    while True:
        torques = np.zeros(len(free))
        for _ in range(tuning.platform_sweeps):
            before = torques.copy()
            for i in range(len(free)):
                torques[i] -= (free[i] + response[i] @ torques) / response[i, i]
                torques[i] = min(max(torques[i], -bound[i]), bound[i])
            if np.array_equal(before, torques):
                break
        stuck = (np.abs(torques) < bound) & (bound > 0)
        if stuck.any():
            # The torques that hold are solved for, so that the rates they leave are zero and not a small number.
            known = free[stuck] + response[np.flatnonzero(stuck)][:, ~stuck] @ torques[~stuck]
            torques[stuck] = -np.linalg.solve(response[np.flatnonzero(stuck)][:, stuck], known)
        after = free + response @ torques
        after[stuck] = 0.0
        broken = ~stuck & (bound > slide)
        if not broken.any():
            return torques, after
        bound[broken] = slide[broken]  # a joint that its static torque could not hold slides against F_c


def _step(
    plant: StewartPlatform, state: Array, pose: Array, u: Array, h: float, slide: Array, hold: Array, time: float
) -> tuple[Array, Array, Array]:
    """State, pose and friction torques one step later."""
    rates = state[6:]
    middle = state[:6] + 0.5 * h * rates
    pose = plant.poses(middle, pose)
    lengths = plant.geometry.home_lengths + middle / plant.geometry.turns
    low, high = plant.geometry.limits
    if (lengths < low).any() or (lengths > high).any():
        raise NoTrustworthyNumber(
            plant.name,
            f"an actuator reaches the end of its range ({1e3 * low:g} .. {1e3 * high:g} mm) at t = {time:.6g} s",
        )
    compliance = np.asarray(np.linalg.inv(mass_matrix(plant, pose)), dtype=np.float64)
    free = rates + h * compliance @ (plant.values["ratio"] * u - bias_torque(plant, pose, rates))
    torques, after = friction_torques(h * compliance, free, rates, slide, hold)
    return np.concatenate([middle + 0.5 * h * after, after]), pose, torques


def _nut(plant: StewartPlatform, joint: DryFriction) -> int:
    names = [s.name for s in plant.states[6:12]]
    if joint.velocity not in names:
        raise unknown_name(f"dry friction on {joint.velocity!r}", "no such nut rate", joint.velocity, names)
    return names.index(joint.velocity)


def _limits(plant: StewartPlatform, joints: Sequence[DryFriction]) -> tuple[Array, Array]:
    """F_c and F_s of the six nuts; zero where there is no friction."""
    slide, hold = np.zeros(6), np.zeros(6)
    for joint in joints:
        i = _nut(plant, joint)
        if hold[i] or slide[i]:
            raise InputError(f"dry friction on {joint.velocity!r}", "given twice", "one for each nut")
        if joint.surface:
            raise InputError(
                f"dry friction on {joint.velocity!r}", f"surface = {joint.surface:g}", "0: the nut's own housing"
            )
        slide[i], hold[i] = joint.coulomb, joint.holding
    return slide, hold
