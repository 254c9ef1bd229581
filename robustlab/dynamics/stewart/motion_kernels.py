# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entries have their signatures in the decorator)
"""Compiled simulation of the Stewart platform: DOP853 with error control and dense output, and RK4 with a fixed step.

The state is z = (pose, twist) or (pose, twist, currents): in the pose the equations need no direct kinematics. Inputs
are piecewise polynomials of time; the integrator restarts only where they are marked as broken.
"""

from __future__ import annotations

import numpy as np

from robustlab.dynamics.stewart.dop853_tableau import E3, E5, STAGES_EXTENDED, A, B, C, D
from robustlab.dynamics.stewart.kernels import (
    KB,
    KF,
    KM,
    L_HENRY,
    R_OHM,
    RATIO,
    _accelerations,
    _angle_rates,
    _lengths_and_jacobian,
    _terms,
    entry,
    leaf,
)
from robustlab.dynamics.stewart.kernels import C as JOINT

DONE, LEFT_WORKSPACE, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2, 3

SAFETY, SMALLEST, LARGEST = 0.9, 0.2, 10.0
EXPONENT = -1.0 / 8.0
MAX_STEPS = 1_000_000
# The local error is held at rtol times these, for (T, angles, v, w, currents) in m, rad, m/s, rad/s, A: 10 mm,
# 0.05 rad of travel, and what is slow at a nut (16 rad/s) and small at a motor.
SCALE = np.array([1e-2] * 3 + [5e-2] * 3 + [1e-2] * 3 + [5e-2] * 3 + [1e-1] * 6)


@leaf
def _input_within(t, k, clock, polynomials, u):
    s = t - clock[k]
    for i in range(6):
        value = 0.0
        for j in range(5, -1, -1):
            value = value * s + polynomials[k, j, i]
        u[i] = value


@leaf
def _input_between(t, first, following, k, clock, polynomials, u):
    """Input at t, read from the intervals first .. following - 1 only: at a break the near side counts."""
    while k > first and t < clock[k]:
        k -= 1
    while k < following - 1 and t > clock[k + 1]:
        k += 1
    _input_within(t, k, clock, polynomials, u)
    return k


@leaf
def _rates(z, u, legs, p, motors, work, dz):
    """dz/dt under u: motor torques, or voltages with the motors attached."""
    _, torque, mass, force, jacobian, bias, phi = work
    q, v = z[:6], z[6:12]
    if motors:
        _terms(q, v, legs, p, mass, force, jacobian, bias, phi)
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
    _accelerations(q, v, torque, legs, p, mass, force, jacobian, bias, phi)
    for i in range(3):
        dz[i], dz[6 + i], dz[9 + i] = v[i], force[i], force[3 + i]
    dz[3], dz[4], dz[5] = _angle_rates(q, v[3], v[4], v[5])


@leaf
def _observe(z, legs, p, lengths, jacobian, shortest, longest, x):
    """Nut angles, rates (and currents) of z into x; False where an actuator is beyond its limits."""
    _lengths_and_jacobian(z[:6], legs, p[JOINT], lengths, jacobian)
    inside = True
    for i in range(6):
        inside = inside and shortest <= lengths[i] <= longest
        x[i] = p[0] * (lengths[i] - legs[i, 9])
        rate = 0.0
        for j in range(6):
            rate += jacobian[i, j] * z[6 + j]
        x[6 + i] = p[0] * rate
    for i in range(12, z.shape[0]):
        x[i] = z[i]
    return inside


@leaf
def _norm(a, scale):
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] / scale[i]) ** 2
    return np.sqrt(total / a.shape[0])


@leaf
def _stage(s, z, h, stages, at):
    """Point z + h sum_j A[s, j] stages[j] into at."""
    n = z.shape[0]
    for i in range(n):
        at[i] = 0.0
    for j in range(s):
        weight = A[s, j]
        if weight != 0.0:
            for i in range(n):
                at[i] += weight * stages[j, i]
    for i in range(n):
        at[i] = z[i] + h * at[i]


@leaf
def _stage_end(z, h, stages, end):
    for i in range(z.shape[0]):
        total = 0.0
        for j in range(12):
            total += B[j] * stages[j, i]
        end[i] = z[i] + h * total


@leaf
def _polynomial(z, end, h, stages, f):
    """Coefficients (7, n) of the dense output of a step."""
    for i in range(z.shape[0]):
        change = end[i] - z[i]
        f[0, i] = change
        f[1, i] = h * stages[0, i] - change
        f[2, i] = 2.0 * change - h * (stages[12, i] + stages[0, i])
        for row in range(4):
            total = 0.0
            for j in range(STAGES_EXTENDED):
                total += D[row, j] * stages[j, i]
            f[3 + row, i] = h * total


@leaf
def _dense(z, f, share, out):
    for i in range(z.shape[0]):
        value = 0.0
        for row in range(6, -1, -1):
            value += f[row, i]
            value *= share if row % 2 == 0 else 1.0 - share
        out[i] = z[i] + value


_ARRAYS = "f8[::1], f8[::1], f8[:,:,::1], b1[::1], f8[:,::1], f8[::1], b1, f8, f8"


@leaf
def _attempt(z, t, h, piece, following, clock, polynomials, legs, p, motors, rtol, work, stages, at, end, scale):
    """One step of length h from z at t into end, its 13 stages, and its error (below 1: accepted)."""
    n, k, u = z.shape[0], piece, work[0]
    for s in range(1, 12):
        _stage(s, z, h, stages, at)
        k = _input_between(t + C[s] * h, piece, following, k, clock, polynomials, u)
        _rates(at, u, legs, p, motors, work, stages[s])
    _stage_end(z, h, stages, end)
    _input_between(t + h, piece, following, k, clock, polynomials, u)
    _rates(end, u, legs, p, motors, work, stages[12])
    e5, e3 = 0.0, 0.0
    for i in range(n):
        scale[i] = rtol * (SCALE[i] if i < 6 else max(SCALE[i], abs(z[i]), abs(end[i])))
        error5, error3 = 0.0, 0.0
        for j in range(13):
            error5 += E5[j] * stages[j, i]
            error3 += E3[j] * stages[j, i]
        e5 += (error5 / scale[i]) ** 2 / n
        e3 += (error3 / scale[i]) ** 2 / n
    if e5 == 0.0 and e3 == 0.0:
        return 0.0
    return h * e5 / np.sqrt(e5 + 0.01 * e3)


@leaf
def _extend(z, t, h, piece, following, clock, polynomials, legs, p, motors, work, stages, at):
    """The three more stages that the dense output asks for."""
    k, u = piece, work[0]
    for s in range(13, 16):
        _stage(s, z, h, stages, at)
        k = _input_between(t + C[s] * h, piece, following, k, clock, polynomials, u)
        _rates(at, u, legs, p, motors, work, stages[s])


@leaf
def _workspace():
    """Work arrays of `_rates`: input, torque, mass, force, Jacobian, bias, nut angles."""
    return np.empty(6), np.empty(6), np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6), np.empty(6)


@entry(f"Tuple((i8, f8, i8))({_ARRAYS}, f8, f8[:,::1], f8[:,::1])")
def integrate(start, clock, polynomials, broken, legs, p, motors, shortest, longest, rtol, z_at, x_at):
    """States z (n, n_z) and x (n, n_x) at the times of the clock (n,); returns (outcome, time reached, evaluations).

    ``polynomials`` (n - 1, 6, 6) are the inputs between two times, ``broken`` (n - 1,) says before which the integrator
    must restart.
    """
    n, last = start.shape[0], clock.shape[0] - 1
    work = _workspace()
    lengths, jacobian, x = np.empty(6), np.empty((6, 6)), np.empty(n)
    stages, f = np.empty((16, n)), np.empty((7, n))
    z, end, at, scale = start.copy(), np.empty(n), np.empty(n), np.empty(n)
    t, sample, evaluations, h = clock[0], 1, 0, 0.0
    z_at[0] = z
    if not _observe(z, legs, p, lengths, jacobian, shortest, longest, x_at[0]):
        return LEFT_WORKSPACE, t, evaluations
    piece = 0
    while piece < last:
        following = piece + 1
        while following < last and not broken[following]:
            following += 1
        stop = clock[following]
        _input_within(t, piece, clock, polynomials, work[0])
        _rates(z, work[0], legs, p, motors, work, stages[0])
        evaluations += 1
        if h == 0.0:
            for i in range(n):
                scale[i] = rtol * SCALE[i]
            h = 0.01 * _norm(z, scale) / max(_norm(stages[0], scale), 1e-12)
            h = min(max(h, 1e-6), 1e-2)
        while t < stop:
            if evaluations > 12 * MAX_STEPS:
                return TOO_MANY_STEPS, t, evaluations
            step, ends = h, False
            if t + 1.001 * step >= stop:
                step, ends = stop - t, True
            error = _attempt(
                z, t, step, piece, following, clock, polynomials, legs, p, motors, rtol, work, stages, at, end, scale
            )
            evaluations += 12
            if not error < 1.0:
                if not np.isfinite(error):
                    error = 1e12
                h = step * max(SMALLEST, SAFETY * error**EXPONENT)
                if h < 1e-14 * max(1.0, abs(t)):
                    return NOT_FINITE, t, evaluations
                continue
            t_end = stop if ends else t + step
            if sample <= last and clock[sample] < t_end:
                _extend(z, t, step, piece, following, clock, polynomials, legs, p, motors, work, stages, at)
                evaluations += 3
                _polynomial(z, end, step, stages, f)
                while sample <= last and clock[sample] < t_end:
                    _dense(z, f, (clock[sample] - t) / step, z_at[sample])
                    if not _observe(z_at[sample], legs, p, lengths, jacobian, shortest, longest, x_at[sample]):
                        return LEFT_WORKSPACE, clock[sample], evaluations
                    sample += 1
            if sample <= last and clock[sample] == t_end:
                z_at[sample] = end
                sample += 1
                inside = _observe(end, legs, p, lengths, jacobian, shortest, longest, x_at[sample - 1])
            else:
                inside = _observe(end, legs, p, lengths, jacobian, shortest, longest, x)
            if not inside:
                return LEFT_WORKSPACE, t_end, evaluations
            for i in range(n):
                z[i], stages[0, i] = end[i], stages[12, i]
            t = t_end
            growth = LARGEST
            if error > 0.0:
                growth = min(LARGEST, SAFETY * error**EXPONENT)
            if not ends or growth * step < h:
                h = step * max(growth, SMALLEST)
        piece = following
    return DONE, t, evaluations


@entry(f"Tuple((i8, f8, i8))({_ARRAYS}, f8, f8[:,::1], f8[:,::1])")
def integrate_fixed(start, clock, polynomials, broken, legs, p, motors, shortest, longest, step, z_at, x_at):
    """The same by the classical Runge-Kutta method in equal steps of at most ``step`` between two samples."""
    n = start.shape[0]
    work, lengths, jacobian = _workspace(), np.empty(6), np.empty((6, 6))
    z, at, dz, total = start.copy(), np.empty(n), np.empty(n), np.empty(n)
    evaluations = 0
    z_at[0] = z
    if not _observe(z, legs, p, lengths, jacobian, shortest, longest, x_at[0]):
        return LEFT_WORKSPACE, clock[0], evaluations
    for k in range(clock.shape[0] - 1):
        length = clock[k + 1] - clock[k]
        count = int(np.ceil(length / step * (1.0 - 1e-9)))
        h = length / count
        for m in range(count):
            t = clock[k] + m * h
            for s in range(4):
                share = 0.0 if s == 0 else (1.0 if s == 3 else 0.5)
                for i in range(n):
                    at[i] = z[i] if s == 0 else z[i] + share * h * dz[i]
                _input_within(t + share * h, k, clock, polynomials, work[0])
                _rates(at, work[0], legs, p, motors, work, dz)
                weight = 1.0 if s in (0, 3) else 2.0
                for i in range(n):
                    total[i] = weight * dz[i] + (0.0 if s == 0 else total[i])
            evaluations += 4
            for i in range(n):
                z[i] += h / 6.0 * total[i]
                if not np.isfinite(z[i]):
                    return NOT_FINITE, t, evaluations
        z_at[k + 1] = z
        if not _observe(z, legs, p, lengths, jacobian, shortest, longest, x_at[k + 1]):
            return LEFT_WORKSPACE, clock[k + 1], evaluations
    return DONE, clock[-1], evaluations
