# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves)
"""The Runge-Kutta pair DOP853 for inputs that are piecewise polynomials of time; compiled into entries."""
# Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", Springer 1993, section II.10 (their code DOP853,
# whose coefficients, of order 8(5, 3) with dense output of order 7, scipy has in a private module).
# No fast arithmetic, not even fused multiply-adds: a leaf is compiled into several entries, and with plain IEEE
# arithmetic all copies give the same bits.

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload
from scipy.integrate._ivp import dop853_coefficients as table  # private: pyproject.toml limits the version of scipy
from scipy.integrate._ivp.dop853_coefficients import E3, E5, A, B, C, D

_options: Any = {"error_model": "numpy", "nogil": True}
leaf = njit(**_options)


def entry(*signatures):
    """Compile for the given signatures, cached on disk."""
    return njit(list(signatures), cache=True, **_options)


# The rates are selected by the type of the machine's NamedTuple: code with functions as arguments is not cached.
def rates(z, u, machine, dz):
    """Write the rates dz (n,) at the state z under the inputs u."""
    raise NotImplementedError


def answers(kind, rates_of):
    """Register the rates of machines of this type."""

    def typed(z, u, machine, dz):
        return rates_of if getattr(machine, "instance_class", None) is kind else None

    overload(rates, jit_options=_options)(typed)


# Stages 0..11: step, 12: its end, 13..15: dense output.
STAGES_EXTENDED = 16
TABLE = table.__file__

SAFETY, SMALLEST, LARGEST = 0.9, 0.2, 10.0
EXPONENT = -1.0 / 8.0
MAX_STEPS = 1_000_000
DONE, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2


class Inputs(NamedTuple):
    """Inputs as functions of time: times (n,), polynomials (n - 1, 6, n_u) between them, and discontinuities."""

    clock: Any
    polynomials: Any
    broken: Any


@leaf
def _input_between(t, span, k, inputs, u):
    """Evaluate the input at t from the intervals of the span (first, one past the last)."""
    first, following = span
    while k > first and t < inputs.clock[k]:
        k -= 1
    while k < following - 1 and t > inputs.clock[k + 1]:
        k += 1
    s = t - inputs.clock[k]
    for i in range(u.shape[0]):
        value = 0.0
        for j in range(5, -1, -1):
            value = value * s + inputs.polynomials[k, j, i]
        u[i] = value
    return k


@leaf
def _norm(a, scale):
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] / scale[i]) ** 2
    return np.sqrt(total / a.shape[0])


@leaf
def _stage(s, machine, z, t, h, span, k, inputs, u, at, stages):
    """Compute the rates of stage s of a step of length h from z at t, into its row."""
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
    k = _input_between(t + C[s] * h, span, k, inputs, u)
    rates(at, u, machine, stages[s])
    return k


@leaf
def _polynomial(z, end, h, stages, f):
    """Compute coefficients (7, n) of the dense output of a step."""
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
    """Evaluate the dense output at the share 0 .. 1 of a step from z, into out."""
    for i in range(z.shape[0]):
        value = 0.0
        for row in range(6, -1, -1):
            value += f[row, i]
            value *= share if row % 2 == 0 else 1.0 - share
        out[i] = z[i] + value


@leaf
def _error(h, stages, scale):
    """Return the error of a step of length h relative to the scale (n,); accepted below 1."""
    n = scale.shape[0]
    e5, e3 = 0.0, 0.0
    for i in range(n):
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
def _not_finite(stages, found):
    for s in range(13):
        for i in range(stages.shape[1]):
            if not np.isfinite(stages[s, i]):
                return i
    return found


@leaf
def integrated(start, inputs, machine, rtol, least, growing, z_at):
    """Integrate to the times of the inputs; return (outcome, time reached, samples reached, state not finite)."""
    # Error tolerance: rtol times ``least``, or times the state's magnitude where that is larger and it is ``growing``.
    clock, polynomials, broken = inputs
    n, last = start.shape[0], clock.shape[0] - 1
    stages, at, end, scale, u = np.zeros((16, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(polynomials.shape[2])
    z, f = start.copy(), np.empty((7, n))
    t, sample, evaluations, h, culprit = clock[0], 1, 0, 0.0, -1
    z_at[0] = z
    piece = 0
    while piece < last:  # restart only at discontinuities of the inputs
        following = piece + 1
        while following < last and not broken[following]:
            following += 1
        stop = clock[following]
        span = (piece, following)
        _input_between(t, (piece, piece + 1), piece, inputs, u)
        rates(z, u, machine, stages[0])
        evaluations += 1
        if h == 0.0:
            scale[:] = rtol * least
            h = min(max(0.01 * _norm(z, scale) / max(_norm(stages[0], scale), 1e-12), 1e-6), 1e-2)
        while t < stop:
            if evaluations > 12 * MAX_STEPS:
                return TOO_MANY_STEPS, t, sample, culprit
            step, ends = h, False
            if t + 1.001 * step >= stop:
                step, ends = stop - t, True
            k = piece
            for s in range(1, 12):
                k = _stage(s, machine, z, t, step, span, k, inputs, u, at, stages)
            for i in range(n):
                total = 0.0
                for j in range(12):
                    total += B[j] * stages[j, i]
                end[i] = z[i] + step * total
            _input_between(t + step, span, k, inputs, u)
            rates(end, u, machine, stages[12])
            evaluations += 12
            for i in range(n):
                scale[i] = rtol * max(least[i], growing[i] * max(abs(z[i]), abs(end[i])))
            error = _error(step, stages, scale)
            if not error < 1.0:
                if not np.isfinite(error):
                    culprit, error = _not_finite(stages, culprit), 1e12
                h = step * max(SMALLEST, SAFETY * error**EXPONENT)
                if h < 1e-14 * max(1.0, abs(t)):
                    return NOT_FINITE, t, sample, culprit
                continue
            t_end = stop if ends else t + step
            if sample <= last and clock[sample] < t_end:
                k = piece
                for s in range(13, 16):
                    k = _stage(s, machine, z, t, step, span, k, inputs, u, at, stages)
                evaluations += 3
                _polynomial(z, end, step, stages, f)
                while sample <= last and clock[sample] < t_end:
                    _dense(z, f, (clock[sample] - t) / step, z_at[sample])
                    sample += 1
            if sample <= last and clock[sample] == t_end:
                z_at[sample] = end
                sample += 1
            for i in range(n):
                z[i], stages[0, i] = end[i], stages[12, i]
            t = t_end
            growth = min(LARGEST, SAFETY * error**EXPONENT) if error > 0.0 else LARGEST
            # A step cut at the end of its piece must not shrink the next one.
            h = step * max(growth, SMALLEST) if not ends or growth * step < h else h
        piece = following
    return DONE, t, sample, culprit
