# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entry has its signature in the decorator)
"""Compiled simulation of the Stewart platform; its state z is (pose, twist), with motors (pose, twist, currents)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from robustlab.dynamics.integrator.steps import DONE, LEFT, NOT_FINITE, Inputs, answers, entry, integrated  # noqa: F401  # pyright: ignore[reportUnusedImport]
from robustlab.dynamics.stewart.kernels import (
    HOME,
    KB,
    KF,
    KM,
    L_HENRY,
    R_OHM,
    RATIO,
    TURNS,
    Motion,
    angle_rates,
    equations_of_motion,
    lengths_and_jacobian,
    platform_acceleration,
)
from robustlab.dynamics.stewart.kernels import C as JOINT

# The local error is held at rtol times these, for (T, angles, v, w, currents) in m, rad, m/s, rad/s, A: 10 mm,
# 0.05 rad of travel, and what is slow at a nut (16 rad/s) and small at a motor.
SCALE = np.array([1e-2] * 3 + [5e-2] * 3 + [1e-2] * 3 + [5e-2] * 3 + [1e-1] * 6)


class Machine(NamedTuple):
    """Legs (6, 12), constants (34,), with motors or without, limits of the actuators; work arrays."""

    legs: Any
    constants: Any
    motors: Any
    shortest: Any
    longest: Any
    torque: Any
    motion: Any


def machine(legs, constants, motors, shortest, longest):
    """The machine with its work arrays."""
    motion = Motion(np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6), np.empty(6))
    return Machine(legs, constants, motors, shortest, longest, np.empty(6), motion)


def _rates(z, u, machine, dz):
    """dz/dt under motor torques, or voltages with the motors attached."""
    legs, p, motors, _, _, torque, motion = machine
    force, jacobian = motion.force, motion.jacobian
    q, v = z[:6], z[6:12]
    if motors:
        equations_of_motion(q, v, legs, p, motion)
        for i in range(6):
            speed = 0.0
            for j in range(6):
                speed += jacobian[i, j] * v[j]
            speed *= p[RATIO]
            torque[i] = p[KM] * z[12 + i] - p[KF] * speed
            dz[12 + i] = (u[i] - p[R_OHM] * z[12 + i] - p[KB] * speed) / p[L_HENRY]
    else:
        for i in range(6):
            torque[i] = u[i]
    platform_acceleration(q, v, torque, legs, p, motion)
    for i in range(3):
        dz[i], dz[6 + i], dz[9 + i] = v[i], force[i], force[3 + i]
    dz[3], dz[4], dz[5] = angle_rates(q, v[3], v[4], v[5])


def _observe(z, machine, x):
    """Nut angles, rates (and currents) of z into x; False where an actuator is beyond its limits."""
    legs, p, _, shortest, longest, _, motion = machine
    lengths, jacobian = motion.phi, motion.jacobian
    lengths_and_jacobian(z[:6], legs, p[JOINT], lengths, jacobian)
    inside = True
    for i in range(6):
        inside = inside and shortest <= lengths[i] <= longest
        x[i] = p[TURNS] * (lengths[i] - legs[i, HOME])
        rate = 0.0
        for j in range(6):
            rate += jacobian[i, j] * z[6 + j]
        x[6 + i] = p[TURNS] * rate
    for i in range(12, z.shape[0]):
        x[i] = z[i]
    return inside


def _scaled(rtol, z, end, machine, first, scale):
    for i in range(z.shape[0]):
        scale[i] = rtol * (SCALE[i] if first or i < 6 else max(SCALE[i], abs(z[i]), abs(end[i])))


answers(Machine, _rates, _observe, _scaled)

_VECTOR, _MATRIX = types.float64[::1], types.float64[:, ::1]
_INPUTS = types.NamedTuple((_VECTOR, types.float64[:, :, ::1], types.boolean[::1]), Inputs)
_MOTION = types.NamedTuple((_MATRIX, _VECTOR, _MATRIX, _VECTOR, _VECTOR), Motion)
_MACHINE = types.NamedTuple((_MATRIX, _VECTOR, types.boolean, types.float64, types.float64, _VECTOR, _MOTION), Machine)
_OUTCOME = types.Tuple((types.int64, types.float64, types.int64))


@entry(_OUTCOME(_VECTOR, _INPUTS, _MACHINE, types.float64, _MATRIX, _MATRIX))
def integrate(start, inputs, machine, rtol, z_at, x_at):
    """States z and x (n, n_x) at the times of the inputs (n,)."""
    return integrated(start, inputs, machine, rtol, z_at, x_at)
