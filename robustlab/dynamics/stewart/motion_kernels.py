# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entry has its signature in the decorator)
"""Compiled simulation of the Stewart platform; its state z is (pose, twist), with motors (pose, twist, currents)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from robustlab.dynamics.integrator.steps import DONE, NOT_FINITE, Inputs, answers, entry, integrated  # noqa: F401  # pyright: ignore[reportUnusedImport]
from robustlab.dynamics.stewart.kernels import (
    KB,
    KF,
    KM,
    L_HENRY,
    R_OHM,
    RATIO,
    Motion,
    angle_rates,
    equations_of_motion,
    platform_acceleration,
)

# Scales of the local error of (T, angles, v, w, currents) in m, rad, m/s, rad/s, A.
SCALE = np.array([1e-2] * 3 + [5e-2] * 3 + [1e-2] * 3 + [5e-2] * 3 + [1e-1] * 6)


class Machine(NamedTuple):
    """Legs (6, 12), constants (34,), with motors or without; work arrays."""

    legs: Any
    constants: Any
    motors: Any
    torque: Any
    motion: Any


def machine(legs, constants, motors):
    """Return the machine with its work arrays."""
    motion = Motion(np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6), np.empty(6))
    return Machine(legs, constants, motors, np.empty(6), motion)


def _rates(z, u, machine, dz):
    """Compute dz/dt under motor torques, or voltages with motors."""
    legs, p, motors, torque, motion = machine
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


answers(Machine, _rates)

_VECTOR, _MATRIX = types.float64[::1], types.float64[:, ::1]
_INPUTS = types.NamedTuple((_VECTOR, types.float64[:, :, ::1], types.boolean[::1]), Inputs)
_MOTION = types.NamedTuple((_MATRIX, _VECTOR, _MATRIX, _VECTOR, _VECTOR), Motion)
_MACHINE = types.NamedTuple((_MATRIX, _VECTOR, types.boolean, _VECTOR, _MOTION), Machine)
_OUTCOME = types.Tuple((types.int64, types.float64, types.int64, types.int64))


@entry(_OUTCOME(_VECTOR, _INPUTS, _MACHINE, types.float64, _MATRIX))
def integrate(start, inputs, machine, rtol, z_at):
    """Integrate; write the states z at the times of the inputs (n,)."""
    n = start.shape[0]
    growing = np.ones(n)
    growing[:6] = 0.0
    return integrated(start, inputs, machine, rtol, SCALE[:n], growing, z_at)
