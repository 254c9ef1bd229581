# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entries have their signatures in the decorator)
"""Compiled equations and simulation of the Stewart platform."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from robustlab.dynamics.integrator.steps import DONE, NOT_FINITE, Inputs, answers, entry, integrated, leaf  # noqa: F401  # pyright: ignore[reportUnusedImport]

# Columns of a leg's row; the order of `robustlab.dynamics.stewart.stewart_platform.Geometry.legs`.
HOME, MOUNT_Z, MOUNT_N = 9, 10, 11
# Places in the constants; the order of `robustlab.dynamics.stewart.stewart_platform.CONSTANTS`.
TURNS, C, GRAVITY, RATIO, MASS, IX, IY, IZ = 0, 1, 2, 3, 4, 5, 6, 7
M0, M1, M2, X1, X2, XZ, SCREW, SCREW_CG = 8, 9, 10, 11, 12, 13, 14, 15
LEG_I, LEG_J, LEG_K, NUT_I, NUT_J, NUT_K, ROTOR = 16, 17, 18, 19, 20, 21, 22
R_OHM, L_HENRY, KM, KB, KF, CX, CY, CZ, UP_X, UP_Y, UP_Z = 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33


class Motion(NamedTuple):
    """Work arrays of the equations of motion: mass (6, 6), force (6,), Jacobian (6, 6), bias (6,), nut angles (6,)."""

    mass: Any
    force: Any
    jacobian: Any
    bias: Any
    phi: Any


@leaf
def _solve(a, b, n, m):
    """Overwrite b (n, m) with a^-1 b by elimination with row pivoting, destroying a; return False if a is singular."""
    for k in range(n):
        pivot, best = k, abs(a[k, k])
        for i in range(k + 1, n):
            size = abs(a[i, k])
            if size > best:
                pivot, best = i, size
        if not best > 0.0:
            return False
        if pivot != k:
            for j in range(k, n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            for j in range(m):
                b[k, j], b[pivot, j] = b[pivot, j], b[k, j]
        inverse = 1.0 / a[k, k]
        for i in range(k + 1, n):
            factor = a[i, k] * inverse
            for j in range(k + 1, n):
                a[i, j] -= factor * a[k, j]
            for j in range(m):
                b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        inverse = 1.0 / a[k, k]
        for j in range(m):
            total = b[k, j]
            for i in range(k + 1, n):
                total -= a[k, i] * b[i, j]
            b[k, j] = total * inverse
    return True


@leaf
def _cholesky_solve(a, b):
    """Overwrite b (6,) with a^-1 b for a symmetric positive definite a; use and destroy its lower half."""
    for j in range(6):
        for k in range(j):
            scaled = a[j, k] * a[k, k]  # a[k, k] is 1/d_k
            a[j, j] -= a[j, k] * scaled
            for i in range(j + 1, 6):
                a[i, j] -= a[i, k] * scaled
        a[j, j] = 1.0 / a[j, j]
    # a = L D L^T with the columns of L still times d
    for i in range(6):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] *= a[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            b[i] -= a[k, i] * a[i, i] * b[k]


@leaf
def _rotation(q):
    """Return R = Rz(az) Ry(ay) Rx(ax), row by row."""
    cx, sx, cy, sy, cz, sz = np.cos(q[3]), np.sin(q[3]), np.cos(q[4]), np.sin(q[4]), np.cos(q[5]), np.sin(q[5])
    return (
        cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx,
        sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx,
        -sy, cy * sx, cy * cx,
    )  # fmt: skip


@leaf
def _turned(rotation, x, y, z):
    return (
        rotation[0] * x + rotation[1] * y + rotation[2] * z,
        rotation[3] * x + rotation[4] * y + rotation[5] * z,
        rotation[6] * x + rotation[7] * y + rotation[8] * z,
    )


@leaf
def _arm(rotation, legs, i):
    """Return the arm rho = R p of leg i."""
    return _turned(rotation, legs[i, 6], legs[i, 7], legs[i, 8])


@leaf
def _leg_length(legs, i, c, sx, sy, sz):
    """Return the normal part of s - b, L cos(beta), L sin(beta), r and L of leg i for the platform point s."""
    wx, wy, wz = sx - legs[i, 0], sy - legs[i, 1], sz - legs[i, 2]
    a = wx * legs[i, 3] + wy * legs[i, 4] + wz * legs[i, 5]
    nx, ny, nz = wx - a * legs[i, 3], wy - a * legs[i, 4], wz - a * legs[i, 5]
    r = np.sqrt(nx * nx + ny * ny + nz * nz)
    reach = r - c
    return nx, ny, nz, a, reach, r, np.sqrt(a * a + reach * reach)


@leaf
def _leg_axes(legs, i, c, sx, sy, sz):
    """Return y, z, K, N, cos(beta), sin(beta), r, L, 1/r, 1/L of leg i for the platform point s."""
    nx, ny, nz, a, reach, r, length = _leg_length(legs, i, c, sx, sy, sz)
    x0, x1, x2 = legs[i, 3], legs[i, 4], legs[i, 5]
    over_r, over_l = 1.0 / r, 1.0 / length  # complex divisions are expensive
    y0, y1, y2 = nx * over_r, ny * over_r, nz * over_r
    cb, sb = a * over_l, reach * over_l
    return (
        (y0, y1, y2),
        (x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0),
        (cb * x0 + sb * y0, cb * x1 + sb * y1, cb * x2 + sb * y2),
        (cb * y0 - sb * x0, cb * y1 - sb * x1, cb * y2 - sb * x2),
        cb, sb, r, length, over_r, over_l,
    )  # fmt: skip


@leaf
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@leaf
def angle_rates(q, wx, wy, wz):
    """Return the rates of (ax, ay, az) at the angular velocity w."""
    cy, sy, cz, sz = np.cos(q[4]), np.sin(q[4]), np.cos(q[5]), np.sin(q[5])
    roll = (cz * wx + sz * wy) / cy
    return roll, cz * wy - sz * wx, wz + sy * roll


@entry("void(f8[:,::1], f8[:,::1], f8, f8[:,::1])")
def inverse_lengths(poses, legs, c, lengths):
    """Compute actuator lengths (n, 6) of poses (n, 6)."""
    for k in range(poses.shape[0]):
        q = poses[k]
        rotation = _rotation(q)
        for i in range(6):
            rho = _arm(rotation, legs, i)
            lengths[k, i] = _leg_length(legs, i, c, q[0] + rho[0], q[1] + rho[1], q[2] + rho[2])[6]


@leaf
def lengths_and_jacobian(q, legs, c, lengths, jacobian):
    """Compute L (6,) and the rows (K, rho x K) of dL/dt = jacobian (v, w)."""
    rotation = _rotation(q)
    for i in range(6):
        rho = _arm(rotation, legs, i)
        _, _, k, _, _, _, _, lengths[i], _, _ = _leg_axes(legs, i, c, q[0] + rho[0], q[1] + rho[1], q[2] + rho[2])
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = k
        jacobian[i, 3], jacobian[i, 4], jacobian[i, 5] = _cross(rho, k)


@entry("void(f8[:,::1], f8[:,::1], f8, f8[:,::1], f8[:,:,::1])")
def jacobians(poses, legs, c, lengths, matrices):
    """Compute lengths (n, 6) and Jacobians (n, 6, 6) from the twist to the rates of the lengths."""
    for k in range(poses.shape[0]):
        lengths_and_jacobian(poses[k], legs, c, lengths[k], matrices[k])


@leaf
def _miss(q, legs, c, target):
    rotation, total = _rotation(q), 0.0
    for i in range(6):
        rho = _arm(rotation, legs, i)
        gap = target[i] - _leg_length(legs, i, c, q[0] + rho[0], q[1] + rho[1], q[2] + rho[2])[6]
        total += gap * gap
    return np.sqrt(total)


@leaf
def _newton(q, target, legs, c, limit, lengths, jacobian, step):
    """Damped Newton from q (overwritten); return the number of steps, -1 if the Jacobian is singular."""
    radius = np.sqrt(legs[0, 6] ** 2 + legs[0, 7] ** 2 + legs[0, 8] ** 2)
    trial, miss = np.empty(6), _miss(q, legs, c, target)
    for iteration in range(limit):
        lengths_and_jacobian(q, legs, c, lengths, jacobian)
        for i in range(6):
            step[i, 0] = target[i] - lengths[i]
        if not _solve(jacobian, step, 6, 1):
            return -1
        roll, pitch, yaw = angle_rates(q, step[3, 0], step[4, 0], step[5, 0])
        size = np.sqrt(
            step[0, 0] ** 2 + step[1, 0] ** 2 + step[2, 0] ** 2 + radius**2 * (roll * roll + pitch * pitch + yaw * yaw)
        )
        share = 1.0
        if size > radius:
            share = radius / size
        while True:
            for i in range(3):
                trial[i] = q[i] + share * step[i, 0]
            trial[3], trial[4], trial[5] = q[3] + share * roll, q[4] + share * pitch, q[5] + share * yaw
            there = _miss(trial, legs, c, target)
            if there < miss:
                break
            share *= 0.5
            if share < 1e-6:
                break
        if not there < miss:
            return iteration
        miss = there
        for i in range(6):
            q[i] = trial[i]
        if miss < 4e-17:
            return iteration + 1
    return limit


@leaf
def _certificate(q, target, legs, c, lengths, jacobian, unit):
    """Return (h, radius, miss) of Newton-Kantorovich at q in the coordinates (T, r_p angles)."""
    arm = np.sqrt(legs[0, 6] ** 2 + legs[0, 7] ** 2 + legs[0, 8] ** 2)
    lengths_and_jacobian(q, legs, c, lengths, jacobian)
    rotation, shortest, miss = _rotation(q), np.inf, 0.0
    for i in range(6):
        rho = _arm(rotation, legs, i)
        shortest = min(shortest, _leg_length(legs, i, c, q[0] + rho[0], q[1] + rho[1], q[2] + rho[2])[4])
        miss += (target[i] - lengths[i]) ** 2
        for j in range(6):
            unit[i, j] = 1.0 if i == j else 0.0
    miss = np.sqrt(miss)
    if not _solve(jacobian, unit, 6, 6):
        return np.inf, np.inf, miss
    beta = 0.0
    for j in range(6):
        roll, pitch, yaw = angle_rates(q, unit[3, j], unit[4, j], unit[5, j])
        beta += unit[0, j] ** 2 + unit[1, j] ** 2 + unit[2, j] ** 2
        beta += arm**2 * (roll * roll + pitch * pitch + yaw * yaw)
    beta = np.sqrt(beta)
    first = beta * (miss + 2.5e-15)
    # The theorem concerns a distance of 2 first from q, where platform points move by 4 first; L is at least r - c.
    room = shortest - 4.0 * first
    if not room > 0.0:
        return np.inf, np.inf, miss
    h = beta * np.sqrt(6.0) * (4.0 / room + 3.0 / arm) * first
    if not h <= 0.5:
        return h, np.inf, miss
    return h, 2.0 * first / (1.0 + np.sqrt(1.0 - 2.0 * h)), miss


@entry("void(f8[:,::1], f8[:,::1], f8[:,::1], f8, i8, f8[:,::1], f8[:,::1])")
def direct_poses(targets, starts, legs, c, limit, poses, facts):
    """Find poses (n, 6) with the lengths (n, 6), each from its start; facts (n, 4): iterations, h, radius, miss."""
    lengths, jacobian, step, unit = np.empty(6), np.empty((6, 6)), np.empty((6, 1)), np.empty((6, 6))
    for k in range(targets.shape[0]):
        q = poses[k]
        for i in range(6):
            q[i] = starts[k, i]
        facts[k, 0] = _newton(q, targets[k], legs, c, limit, lengths, jacobian, step)
        facts[k, 1], facts[k, 2], facts[k, 3] = _certificate(q, targets[k], legs, c, lengths, jacobian, unit)


@leaf
def _leg_forces(legs, i, p, axes, theta1, beta1, length1, phi, accelerations):
    """Return the mass matrix of leg i in (theta, beta, L), and its inertia, velocity and gravity forces."""
    y, z, k, n, cb, sb, _, length, _, _ = axes
    c, turns, iz, iy = p[C], p[TURNS], legs[i, MOUNT_Z], legs[i, MOUNT_N]
    along, across = p[X1] * iz, p[X1] * iy  # first moments of the motor body along z and N
    t_zz = p[M2] + p[LEG_I] * iz * iz + (p[LEG_J] + p[X2]) * iy * iy
    t_nn = p[M2] + p[LEG_I] * iy * iy + (p[LEG_J] + p[X2]) * iz * iz
    t_kk = p[LEG_K] + p[X2]
    t_zn = (p[LEG_I] - p[LEG_J] - p[X2]) * iz * iy
    t_zk, t_nk = -p[XZ] * iz, -p[XZ] * iy
    # the nut's axes are rotated by phi about K
    cp, sp = np.cos(phi), np.sin(phi)
    e_z, e_n = cp * iz + sp * iy, cp * iy - sp * iz
    uneven = p[NUT_I] - p[NUT_J]
    nut_zz = p[NUT_I] * e_z * e_z + p[NUT_J] * e_n * e_n
    nut_nn = p[NUT_I] * e_n * e_n + p[NUT_J] * e_z * e_z
    nut_zn = uneven * e_z * e_n
    d_zz = 2.0 * turns * uneven * e_z * e_n  # of nut_zz along L, and minus that of nut_nn
    d_zn = turns * uneven * (e_n * e_n - e_z * e_z)

    reach = length - p[SCREW_CG]
    lever = c + reach * sb
    screw, spin = p[SCREW], p[NUT_K] * turns
    ss, cc, sc = sb * sb, cb * cb, sb * cb
    m11 = p[M0] * c * c + 2.0 * c * (p[M1] * sb + across * cb) + (t_nn + nut_nn) * ss + (t_kk + p[NUT_K]) * cc
    m11 += screw * lever * lever - 2.0 * t_nk * sc
    m12 = t_zk * cb - (t_zn + nut_zn) * sb
    m13 = spin * cb
    m22 = t_zz + nut_zz + screw * reach * reach
    m33 = screw + spin * turns + p[ROTOR]

    b11 = 2.0 * (c * (p[M1] * cb - across * sb) + (t_nn + nut_nn - t_kk - p[NUT_K]) * sc - t_nk * (cc - ss))
    b11 += 2.0 * screw * lever * reach * cb
    b12 = -t_zk * sb - (t_zn + nut_zn) * cb
    b13 = -spin * sb
    l11 = 2.0 * screw * lever * sb - d_zz * ss
    l12 = -d_zn * sb
    l22 = 2.0 * screw * reach + d_zz

    r11, r12 = b11 * beta1 + l11 * length1, b12 * beta1 + l12 * length1
    r13, r22 = b13 * beta1, l22 * length1
    theta2, beta2, length2 = accelerations
    f1 = m11 * theta2 + m12 * beta2 + m13 * length2 + r11 * theta1 + r12 * beta1 + r13 * length1
    f2 = m12 * theta2 + m22 * beta2 + r12 * theta1 + r22 * beta1
    f2 -= theta1 * (0.5 * b11 * theta1 + b12 * beta1 + b13 * length1)
    f3 = m13 * theta2 + m33 * length2 + r13 * theta1
    f3 -= 0.5 * (l11 * theta1 * theta1 + 2.0 * l12 * theta1 * beta1 + l22 * beta1 * beta1)

    moment, up = p[M1] + screw * reach, (p[UP_X], p[UP_Y], p[UP_Z])
    f1 += p[GRAVITY] * (((p[M0] + screw) * c + moment * sb + across * cb) * _dot(up, z) - along * _dot(up, y))
    f2 += p[GRAVITY] * (moment * _dot(up, n) - across * _dot(up, k))
    f3 += p[GRAVITY] * screw * _dot(up, k)
    return m11, m12, m13, m22, m33, f1, f2, f3


@leaf
def _platform_terms(rotation, w, p, mass, force):
    """Set mass (6, 6), lower half, and force (6,) to the platform's own; its centre of mass is at r = R c."""
    m, r = p[MASS], _turned(rotation, p[CX], p[CY], p[CZ])
    for i in range(3):
        for j in range(3):
            mass[i, j] = m if i == j else 0.0
            mass[3 + i, 3 + j] = (
                rotation[3 * i] * rotation[3 * j] * p[IX]
                + rotation[3 * i + 1] * rotation[3 * j + 1] * p[IY]
                + rotation[3 * i + 2] * rotation[3 * j + 2] * p[IZ]
            ) + m * ((_dot(r, r) if i == j else 0.0) - r[i] * r[j])
    mass[3, 0], mass[3, 1], mass[3, 2] = 0.0, -m * r[2], m * r[1]
    mass[4, 0], mass[4, 1], mass[4, 2] = m * r[2], 0.0, -m * r[0]
    mass[5, 0], mass[5, 1], mass[5, 2] = -m * r[1], m * r[0], 0.0
    spin = _cross(w, (_dot(mass[3, 3:], w), _dot(mass[4, 3:], w), _dot(mass[5, 3:], w)))
    weight, pull, moment = m * p[GRAVITY], _cross(w, _cross(w, r)), _cross(r, (p[UP_X], p[UP_Y], p[UP_Z]))
    for i in range(3):
        force[i] = m * pull[i] + weight * p[UP_X + i]
        force[3 + i] = spin[i] + weight * moment[i]


@leaf
def equations_of_motion(q, v, legs, p, motion):
    """Compute the equations of motion in the twist V = (v, w), and the nut angles."""
    mass, force, jacobian, bias, phi = motion
    turns = p[TURNS]
    rotation = _rotation(q)
    w = (v[3], v[4], v[5])
    _platform_terms(rotation, w, p, mass, force)
    g = np.empty((3, 6), mass.dtype)
    h = np.empty((3, 6), mass.dtype)
    for i in range(6):
        rho = _arm(rotation, legs, i)
        axes = _leg_axes(legs, i, p[C], q[0] + rho[0], q[1] + rho[1], q[2] + rho[2])
        _, z, k, n, cb, sb, r, length, over_r, over_l = axes
        turn = _cross(w, rho)
        rate, pull = (v[0] + turn[0], v[1] + turn[1], v[2] + turn[2]), _cross(w, turn)
        theta1, beta1, length1 = _dot(z, rate) * over_r, _dot(n, rate) * over_l, _dot(k, rate)
        swing = r * theta1 * theta1
        r1 = length1 * sb + length * cb * beta1
        accelerations = (
            (_dot(z, pull) - 2.0 * r1 * theta1) * over_r,
            (_dot(n, pull) + swing * cb - 2.0 * length1 * beta1) * over_l,
            _dot(k, pull) + swing * sb + length * beta1 * beta1,
        )
        phi[i] = turns * (length - legs[i, HOME])
        m11, m12, m13, m22, m33, f1, f2, f3 = _leg_forces(
            legs, i, p, axes, theta1, beta1, length1, phi[i], accelerations
        )
        g[0, 0], g[0, 1], g[0, 2] = z[0] * over_r, z[1] * over_r, z[2] * over_r
        g[1, 0], g[1, 1], g[1, 2] = n[0] * over_l, n[1] * over_l, n[2] * over_l
        g[2, 0], g[2, 1], g[2, 2] = k
        for a in range(3):
            g[a, 3], g[a, 4], g[a, 5] = _cross(rho, (g[a, 0], g[a, 1], g[a, 2]))
        for j in range(6):
            h[0, j] = m11 * g[0, j] + m12 * g[1, j] + m13 * g[2, j]
            h[1, j] = m12 * g[0, j] + m22 * g[1, j]
            h[2, j] = m13 * g[0, j] + m33 * g[2, j]
            force[j] += f1 * g[0, j] + f2 * g[1, j] + f3 * g[2, j]
            jacobian[i, j] = turns * g[2, j]
        for j in range(6):
            for m in range(j + 1):
                mass[j, m] += g[0, j] * h[0, m] + g[1, j] * h[1, m] + g[2, j] * h[2, m]
        bias[i] = turns * accelerations[2]


@leaf
def platform_acceleration(q, v, torque, legs, p, motion):
    """Overwrite the force of ``motion`` with dV/dt under the motor torques (6,)."""
    equations_of_motion(q, v, legs, p, motion)
    mass, force, jacobian, _, _ = motion
    for j in range(6):
        total = -force[j]
        for i in range(6):
            total += jacobian[i, j] * (p[RATIO] * torque[i])
        force[j] = total
    _cholesky_solve(mass, force)


_REAL = "f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1]"
_COMPLEX = (
    "c16[:,::1], c16[:,::1], f8[:,::1], f8[:,::1], c16[:,:,::1], c16[:,::1], c16[:,:,::1], c16[:,::1], c16[:,::1]"
)


@entry(f"void({_REAL})", f"void({_COMPLEX})")
def equations(poses, twists, legs, constants, mass, force, jacobian, bias, phi):
    """Compute `equations_of_motion` at poses and twists (n, 6) with constants (n, 34), and full mass matrices."""
    for k in range(poses.shape[0]):
        motion = Motion(mass[k], force[k], jacobian[k], bias[k], phi[k])
        equations_of_motion(poses[k], twists[k], legs, constants[k], motion)
        for i in range(6):
            for j in range(i):
                mass[k, j, i] = mass[k, i, j]


# --- simulation; the state z is (pose, twist), with motors (pose, twist, currents) ------------------------------------

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
