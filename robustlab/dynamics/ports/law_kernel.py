"""Compiled stepping of a plant with force laws at its ports: linear, or linear about a motion."""
# Acary, Brogliato, *Numerical Methods for Nonsmooth Dynamical Systems* (2008), chapters 9 and 10 (time stepping);
# Hairer, Norsett, Wanner, *Solving Ordinary Differential Equations I* (1993), section II.4 (extrapolation); Irons,
# Tuck, *A version of the Aitken accelerator for computer iteration* (1969).

# pyright: reportMissingParameterType=false, reportUnnecessaryTypeIgnoreComment=false, reportCallIssue=false
from __future__ import annotations

import math

import numba as nb
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# Arguments of a law: position and velocity at the start of the step, both at its end without the law's own force,
# compliance of both, length of the step in s, time at its start in s.
Q0, V0, Q, V, GQ, GV, STEP, TIME = range(8)
N_SEEN = 8

NUMBERS = types.CPointer(types.float64)  # arrays would count references at every call
LAW_SIGNATURE = types.float64(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
SWEEPS = 100
RELAXED_FROM, RELAXED_TO = 4, 60  # relaxed sweeps
LEAST_RELAXED, MOST_RELAXED = 0.1, 100.0
SLOW = 0.1  # convergence rate of the squared change above which sweeps are relaxed
AGREED = 1e-9  # relative to the largest force of the step
UNRESOLVED = 0.1  # relative difference of the forces of a step and its halves above which the step is too long


def law(function):  # type: ignore[no-untyped-def]
    """Compile ``function(p, z, z_next, seen) -> force``."""
    return nb.cfunc(LAW_SIGNATURE, cache=True)(function)


@intrinsic
def _at(_typing, address):  # type: ignore[no-untyped-def]
    """Return the numbers at an address."""

    def pointer(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], context.get_value_type(NUMBERS))

    return NUMBERS(types.uintp), pointer


@intrinsic
def _answer(_typing, address, p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Call the law at an address."""

    def call(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        number = context.get_value_type(types.float64)
        function = ir.FunctionType(number, [context.get_value_type(NUMBERS)] * 4).as_pointer()
        return builder.call(builder.inttoptr(arguments[0], function), arguments[1:])

    return types.float64(types.uintp, NUMBERS, NUMBERS, NUMBERS, NUMBERS), call


@nb.njit("void(f8[:,:,::1], f8[:,:,::1], i8[::1], f8[:,::1], f8[:,:,::1])", cache=True, nogil=True)
def drifts(entering, phi, points, rates, drift):  # type: ignore[no-untyped-def]
    """Compute drift (3, n_steps, n) of rates (n_steps, k) along a motion, in each step and its halves."""
    n, k = entering.shape[1:]
    for s in range(rates.shape[0]):
        at = points[s]
        for i in range(n):
            a = 0.0
            for c in range(k):
                a += entering[at, i, c] * rates[s, c]
            drift[1, s, i] = drift[2, s, i] = a
        for i in range(n):
            a = drift[1, s, i]
            for c in range(n):
                a += phi[at, i, c] * drift[1, s, c]
            drift[0, s, i] = a


@nb.njit(cache=True, nogil=True)
def step_windows(  # type: ignore[no-untyped-def]
    laws, parameters, memory,
    phi, gamma_u, gamma_f, velocity, position, drift, stride,
    u, h, t0, sub, starts, length, x0, own, halves,
    states, forces,
):  # fmt: skip
    """Simulate windows one after the other; with more rows of x0 than windows, all of them several times.

    Whole step, first and second half, with held forces: phi (3, m, n, n), gamma_u (3, m, n, columns of u), gamma_f (3,
    m, n_laws, n); arguments of each law: velocity, position (n_laws, n). About a motion row (w, j) is valid for
    ``stride`` steps of window w, drift (3, steps of all windows, n) is that of its rates; for a linear plant m = 1 and
    drift is empty. ``own``: leading states that x0 sets after the first window.
    """
    # x+ = phi x + gamma_u u + drift + sum_j gamma_f f_j. Each law returns the force that is consistent with the motion
    # at the end of the step. Every step is computed whole and in two halves and extrapolated: fourth order for smooth
    # forces. Several laws are swept (Gauss-Seidel, Aitken relaxation).
    n, n_u, n_z = phi.shape[2], gamma_u.shape[3], memory.shape[1]
    n_laws = forces.shape[2]
    x = np.zeros((4, n))  # at the start, after a whole step, in its middle, after two halves
    f = np.zeros((3, n_laws))
    mean = np.zeros(n_laws)  # of the forces over the sample so far
    seen = np.zeros(N_SEEN)
    z_next = memory.copy()
    own_p, own_z, own_next, own_seen = parameters.ctypes.data, memory.ctypes.data, z_next.ctypes.data, seen.ctypes.data
    row_p, row_z = np.uintp(8 * parameters.shape[1]), np.uintp(8 * n_z)
    q0, v0, q_free, v_free = np.zeros(n_laws), np.zeros(n_laws), np.zeros(n_laws), np.zeros(n_laws)
    q_asked, v_asked = np.zeros(n_laws), np.zeros(n_laws)
    f_before, moved = np.zeros(n_laws), np.zeros(n_laws)  # forces before a sweep; their change in the previous one
    gq, gv = np.zeros((3, n_laws, n_laws)), np.zeros((3, n_laws, n_laws))  # compliance of port j under force k
    moving = drift.shape[1] > 0
    rows = (length * sub + stride - 1) // stride  # of the table per window
    at = 0
    _compliances(position, velocity, gamma_f, at, gq, gv)
    sweeps = SWEEPS if n_laws > 1 else 1
    parts = 3 if n_laws and halves else 1
    first = memory.copy()
    for run in range(x0.shape[0]):
        w = run % starts.shape[0]
        for i in range(own if w else n):
            x[0, i] = x0[run, i]
        if w == 0:
            memory[:] = first
        f[:] = 0.0
        mean[:] = 0.0
        for k in range(length):
            for i in range(n):
                states[run, k, i] = x[0, i]
            for j in range(n_laws):
                forces[run, k, j] = mean[j]
                mean[j] = 0.0
            for s in range(sub):
                row = (starts[w] + k) * sub + s
                step = k * sub + s
                if moving and at != w * rows + step // stride:
                    at = w * rows + step // stride
                    _compliances(position, velocity, gamma_f, at, gq, gv)
                for part in range(parts):
                    origin = 2 if part == 2 else 0
                    end = part + 1
                    for i in range(n):
                        a = 0.0
                        for c in range(n):
                            a += phi[part, at, i, c] * x[origin, c]
                        for c in range(n_u):
                            a += gamma_u[part, at, i, c] * u[row, c]
                        x[end, i] = a
                    if moving:
                        for i in range(n):
                            x[end, i] += drift[part, w * length * sub + step, i]
                    # The sweeps start from the forces of the previous step.
                    before = 2 if part == 0 else part - 1
                    for j in range(n_laws):
                        a, b, c_q, c_v = 0.0, 0.0, 0.0, 0.0
                        for i in range(n):
                            a += position[j, i] * x[origin, i]
                            b += velocity[j, i] * x[origin, i]
                            c_q += position[j, i] * x[end, i]
                            c_v += velocity[j, i] * x[end, i]
                        q0[j], v0[j], q_free[j], v_free[j] = a, b, c_q, c_v
                        f[part, j] = f[before, j]
                        for i in range(n_z):
                            z_next[j, i] = memory[j, i]
                    seen[STEP] = h if part == 0 else 0.5 * h
                    seen[TIME] = t0 + (row + 0.5 if part == 2 else row) * h
                    least = -1.0  # change of a port's motion for a new evaluation
                    relaxed = 1.0
                    for sweep in range(sweeps):
                        change = 0.0
                        largest = 0.0
                        for j in range(n_laws):
                            f_before[j] = f[part, j]
                        for j in range(n_laws):
                            a, b = q_free[j], v_free[j]
                            for other in range(n_laws):
                                if other != j:
                                    a += gq[part, j, other] * f[part, other]
                                    b += gv[part, j, other] * f[part, other]
                            compliance = gv[part, j, j]
                            if abs(b - v_asked[j]) <= least and abs(a - q_asked[j]) <= least * seen[STEP]:
                                largest = max(largest, abs(f[part, j]) * compliance)
                                continue
                            q_asked[j], v_asked[j] = a, b
                            seen[Q0] = q0[j]
                            seen[V0] = v0[j]
                            seen[Q] = a
                            seen[V] = b
                            seen[GQ] = gq[part, j, j]
                            seen[GV] = compliance
                            force = _answer(
                                laws[j],
                                _at(own_p + j * row_p),
                                _at(own_z + j * row_z),
                                _at(own_next + j * row_z),
                                _at(own_seen),
                            )
                            change = max(change, abs(force - f[part, j]) * compliance)
                            largest = max(largest, abs(force) * compliance)
                            f[part, j] = force
                        least = AGREED * largest
                        if change <= least or sweeps == 1:
                            break
                        relaxed = _relaxed(f[part], f_before, moved, relaxed, sweep)
                        if relaxed != 1.0:
                            least = -1.0  # relaxed forces: evaluate all laws
                    for j in range(n_laws):
                        for i in range(n):
                            x[end, i] += gamma_f[part, at, j, i] * f[part, j]
                        if part or parts == 1:
                            for i in range(n_z):
                                memory[j, i] = z_next[j, i]
                if parts == 1:
                    for i in range(n):
                        x[0, i] = x[1, i]
                    for j in range(n_laws):
                        mean[j] += f[0, j] / sub
                    continue
                weight = _resolved(f) / 3.0
                for i in range(n):
                    x[0, i] = x[3, i] + weight * (x[3, i] - x[1, i])
                for j in range(n_laws):
                    half = 0.5 * (f[1, j] + f[2, j])
                    f[0, j] = half + weight * (half - f[0, j])
                    mean[j] += f[0, j] / sub


@nb.njit(cache=True, nogil=True)
def _relaxed(f, before, moved, relaxed, sweep):  # type: ignore[no-untyped-def]
    """Relax the change of the forces f in a sweep (Aitken, Irons and Tuck); return the relaxation factor."""
    along, apart, now, last = 0.0, 0.0, 0.0, 0.0
    for j in range(len(f)):
        step = f[j] - before[j]
        along += moved[j] * (step - moved[j])
        apart += (step - moved[j]) ** 2
        now += step * step
        last += moved[j] * moved[j]
        moved[j] = step
    if not RELAXED_FROM <= sweep < RELAXED_TO or now < SLOW * last or apart == 0.0:
        return 1.0
    relaxed = min(max(-relaxed * along / apart, LEAST_RELAXED), MOST_RELAXED)
    for j in range(len(f)):
        f[j] = before[j] + relaxed * moved[j]
    return relaxed


@nb.njit(cache=True, nogil=True)
def _compliances(position, velocity, gamma_f, at, gq, gv):  # type: ignore[no-untyped-def]
    """Compute the compliance of position and velocity at port j under force k, (3, n_laws, n_laws) each, of a row."""
    n_laws, n = velocity.shape
    for part in range(3):
        for j in range(n_laws):
            for k in range(n_laws):
                a, b = 0.0, 0.0
                for i in range(n):
                    a += position[j, i] * gamma_f[part, at, k, i]
                    b += velocity[j, i] * gamma_f[part, at, k, i]
                gq[part, j, k], gv[part, j, k] = a, b


@nb.njit(cache=True, nogil=True)
def _resolved(f):  # type: ignore[no-untyped-def]
    """Return 1 if a step and its two halves agree on the forces (3, n_laws), else 0."""
    unlike = 0.0
    for j in range(f.shape[1]):
        size = UNRESOLVED * (abs(f[0, j]) + abs(f[1, j]) + abs(f[2, j]))
        if size > 0.0:
            ratio = (f[0, j] - 0.5 * (f[1, j] + f[2, j])) / size
            unlike += ratio * ratio * ratio * ratio
    return 1.0 / (1.0 + unlike)


ROUNDING = 4e-16
MOST_LOOKS = 200
CLOSE = 1e-13  # of the largest force: rounding of a position of many turns
SECANTS = 6  # secant steps of a law with weak feedback, before it brackets its root
FAR = 6.1  # Stribeck velocities, beyond which exp(-(v/vs)^2) is below rounding
SERIES_BELOW = 1e-3  # of the Stribeck velocity: cancellation in the difference of two error functions


@nb.njit(cache=True)
def bracket(low, r_low, high, r_high):  # type: ignore[no-untyped-def]
    """Return the bracket of a root of r(x) with r(low) <= 0 <= r(high), x and r of one unit; closed if violated."""
    if r_low >= 0.0:
        return low, 0.0, low, 0.0, 0.0, 0.0
    if r_high <= 0.0:
        return high, 0.0, high, 0.0, 0.0, 0.0
    return low, r_low, high, r_high, 0.0, ROUNDING * (abs(low) + abs(high))


@nb.njit(cache=True)
def is_open(b):  # type: ignore[no-untyped-def]
    """Return whether the bracket is wider than rounding."""
    return b[2] - b[0] > b[5]


@nb.njit(cache=True)
def guess(b):  # type: ignore[no-untyped-def]
    """Return the next point: regula falsi, bisection every fourth time."""
    low, r_low, high, r_high, count, _ = b
    x = (low * r_high - high * r_low) / (r_high - r_low)
    if int(abs(count)) % 4 == 3 or not low < x < high:
        x = low + 0.5 * (high - low)
    return x


@nb.njit(cache=True)
def narrowed(b, x, r):  # type: ignore[no-untyped-def]
    """Return the bracket after the evaluation r at x (Illinois weighting)."""
    low, r_low, high, r_high, count, rounding = b
    looks = abs(count) + 1.0
    if not abs(r) > rounding or looks > MOST_LOOKS:
        return x, 0.0, x, 0.0, 0.0, 0.0
    if r < 0.0:
        return x, r, high, 0.5 * r_high if count < 0.0 else r_high, -looks, rounding
    return low, 0.5 * r_low if count > 0.0 else r_low, x, r, looks, rounding


@nb.njit(cache=True)
def stribeck_mean(start, end, width):  # type: ignore[no-untyped-def]
    r"""Return the mean of :math:`e^{-(v/v_s)^2}` between two velocities: a difference of error functions."""
    a, b = start / width, end / width
    if abs(b - a) < SERIES_BELOW:
        x = 0.5 * (a + b)
        return math.exp(-x * x) * (1.0 + (4.0 * x * x - 2.0) * (b - a) ** 2 / 24.0)
    return 0.5 * math.sqrt(math.pi) * (math.erf(b) - math.erf(a)) / (b - a)


@nb.njit(cache=True)
def _slide(start, free, compliance, level, rise, width):  # type: ignore[no-untyped-def]
    """Return the end velocity >= 0 of a body sliding forward from ``start`` >= 0, or -1 if it stops."""
    fall, swing = compliance * level, compliance * rise
    if rise == 0.0 or min(start, free - fall) > FAR * width:
        return free - fall if free >= fall else -1.0
    here = start - free + fall + swing * stribeck_mean(start, start, width)
    if here <= 0.0:
        end = max(start, free)
        b = bracket(start, here, end, end - free + fall + swing * stribeck_mean(start, end, width))
    else:
        still = fall - free + swing * stribeck_mean(start, 0.0, width)
        if still > 0.0:
            return -1.0
        b = bracket(0.0, still, start, here)
    while is_open(b):
        end = guess(b)
        b = narrowed(b, end, end - free + fall + swing * stribeck_mean(start, end, width))
    return b[0]


@nb.njit(cache=True)
def dry_mean_force(v0, v_free, compliance, level, rise, width):  # type: ignore[no-untyped-def]
    r"""Return the mean dry friction :math:`-(F + \Delta F e^{-(v/v_s)^2}) \operatorname{sgn} v` over a step."""
    sign = 1.0 if v0 > 0.0 or (v0 == 0.0 and v_free > 0.0) else -1.0
    start, free = sign * v0, sign * v_free
    drive = free - start  # change of velocity over the step without friction
    holding = compliance * (level + rise)
    if start > 0.0 or drive > holding:
        end = _slide(start, free, compliance, level, rise, width)
        if end >= 0.0:
            return -sign * (level if rise == 0.0 else level + rise * stribeck_mean(start, end, width))
    if drive >= -holding:
        return -sign * free / compliance
    friction = level if rise == 0.0 else level + rise * stribeck_mean(start, 0.0, width)
    left = 1.0 - start / (compliance * friction - drive)  # share of the step after the stop
    back = _slide(0.0, -left * drive, left * compliance, level, rise, width)
    return -sign * (max(back, 0.0) + free) / compliance
