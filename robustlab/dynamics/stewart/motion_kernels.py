# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entries have their signatures in the decorator)
"""Compiled simulation of the Stewart platform: DOP853 with error control and dense output."""
# Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", Springer 1993, section II.10 (their code DOP853,
# whose coefficients scipy carries).

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from robustlab.dynamics.integrator.steps import (
    MAX_STEPS,
    C,
    Inputs,
    dense,
    entry,
    error_of,
    first_step,
    input_between,
    input_within,
    leaf,
    next_step,
    piece_end,
    polynomial,
    shorter,
    stage_point,
    step_end,
)
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

DONE, LEFT_WORKSPACE, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2, 3

# The local error is held at rtol times these, for (T, angles, v, w, currents) in m, rad, m/s, rad/s, A: 10 mm,
# 0.05 rad of travel, and what is slow at a nut (16 rad/s) and small at a motor.
SCALE = np.array([1e-2] * 3 + [5e-2] * 3 + [1e-2] * 3 + [5e-2] * 3 + [1e-1] * 6)


class Machine(NamedTuple):
    """Legs (6, 12) and constants (34,) of a platform, with motors or without, and the limits of its actuators."""

    legs: Any
    constants: Any
    motors: Any
    shortest: Any
    longest: Any


class Step(NamedTuple):
    """Work arrays of a step: stages (16, n), point of a stage, end and error's scale (n,); input and torque (6,)."""

    stages: Any
    at: Any
    end: Any
    scale: Any
    u: Any
    torque: Any
    motion: Any


@leaf
def _rates(z, machine, step, dz):
    """dz/dt under the input of the step: motor torques, or voltages with the motors attached."""
    legs, p, motors, _, _ = machine
    u, torque, motion = step.u, step.torque, step.motion
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


@leaf
def _observe(z, machine, step, x):
    """Nut angles, rates (and currents) of z into x; False where an actuator is beyond its limits."""
    legs, p, _, shortest, longest = machine
    lengths, jacobian = step.motion.phi, step.motion.jacobian
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


@leaf
def _attempt(z, t, h, span, inputs, machine, rtol, step):
    """One step of length h from z at t: its end, its 13 stages, and its error (below 1: accepted)."""
    stages, at, end, scale = step.stages, step.at, step.end, step.scale
    n, k = z.shape[0], span[0]
    for s in range(1, 12):
        stage_point(s, z, h, stages, at)
        k = input_between(t + C[s] * h, span, k, inputs, step.u)
        _rates(at, machine, step, stages[s])
    step_end(z, h, stages, end)
    input_between(t + h, span, k, inputs, step.u)
    _rates(end, machine, step, stages[12])
    for i in range(n):
        scale[i] = rtol * (SCALE[i] if i < 6 else max(SCALE[i], abs(z[i]), abs(end[i])))
    return error_of(h, stages, scale)


@leaf
def _extend(z, t, h, span, inputs, machine, step):
    """The three more stages that the dense output asks for."""
    k = span[0]
    for s in range(13, 16):
        stage_point(s, z, h, step.stages, step.at)
        k = input_between(t + C[s] * h, span, k, inputs, step.u)
        _rates(step.at, machine, step, step.stages[s])


@leaf
def _workspace(n):
    motion = Motion(np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6), np.empty(6))
    return Step(np.empty((16, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(6), np.empty(6), motion)


_VECTOR, _MATRIX = types.float64[::1], types.float64[:, ::1]
_INPUTS = types.NamedTuple((_VECTOR, types.float64[:, :, ::1], types.boolean[::1]), Inputs)
_MACHINE = types.NamedTuple((_MATRIX, _VECTOR, types.boolean, types.float64, types.float64), Machine)
_OUTCOME = types.Tuple((types.int64, types.float64, types.int64))
_SIGNATURE = _OUTCOME(_VECTOR, _INPUTS, _MACHINE, types.float64, _MATRIX, _MATRIX)


@entry(_SIGNATURE)
def integrate(start, inputs, machine, rtol, z_at, x_at):
    """States z (n, n_z) and x (n, n_x) at the times of the inputs (n,); gives (outcome, time, evaluations)."""
    clock, _, broken = inputs
    n, last = start.shape[0], clock.shape[0] - 1
    work = _workspace(n)
    stages, end, scale = work.stages, work.end, work.scale
    z, x, f = start.copy(), np.empty(n), np.empty((7, n))
    t, sample, evaluations, h = clock[0], 1, 0, 0.0
    z_at[0] = z
    if not _observe(z, machine, work, x_at[0]):
        return LEFT_WORKSPACE, t, evaluations
    piece = 0
    while piece < last:
        following = piece_end(piece, last, broken)
        stop = clock[following]
        span = (piece, following)
        input_within(t, piece, inputs, work.u)
        _rates(z, machine, work, stages[0])
        evaluations += 1
        if h == 0.0:
            for i in range(n):
                scale[i] = rtol * SCALE[i]
            h = first_step(z, stages[0], scale)
        while t < stop:
            if evaluations > 12 * MAX_STEPS:
                return TOO_MANY_STEPS, t, evaluations
            step, ends = h, False
            if t + 1.001 * step >= stop:
                step, ends = stop - t, True
            error = _attempt(z, t, step, span, inputs, machine, rtol, work)
            evaluations += 12
            if not error < 1.0:
                h = shorter(step, error)
                if h < 1e-14 * max(1.0, abs(t)):
                    return NOT_FINITE, t, evaluations
                continue
            t_end = stop if ends else t + step
            if sample <= last and clock[sample] < t_end:
                _extend(z, t, step, span, inputs, machine, work)
                evaluations += 3
                polynomial(z, end, step, stages, f)
                while sample <= last and clock[sample] < t_end:
                    dense(z, f, (clock[sample] - t) / step, z_at[sample])
                    if not _observe(z_at[sample], machine, work, x_at[sample]):
                        return LEFT_WORKSPACE, clock[sample], evaluations
                    sample += 1
            if sample <= last and clock[sample] == t_end:
                z_at[sample] = end
                sample += 1
                inside = _observe(end, machine, work, x_at[sample - 1])
            else:
                inside = _observe(end, machine, work, x)
            if not inside:
                return LEFT_WORKSPACE, t_end, evaluations
            for i in range(n):
                z[i], stages[0, i] = end[i], stages[12, i]
            t = t_end
            h = next_step(h, step, error, ends)
        piece = following
    return DONE, t, evaluations
