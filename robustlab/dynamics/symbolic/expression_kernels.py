# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves; the entries have their signatures in the decorator)
"""Compiled evaluation and simulation of tapes, common to all plants."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from robustlab.dynamics.integrator.steps import DONE, NOT_FINITE, Inputs, answers, entry, integrated, leaf  # noqa: F401  # pyright: ignore[reportUnusedImport]

# Error tolerance of a state: rtol times the larger of this (in its unit) and its magnitude.
LEAST_SCALE = 1e-2


class Code(NamedTuple):
    """A tape: operations, their arguments (n,), constants (n_c,), and places of the outputs (n_out,)."""

    operations: Any
    left: Any
    right: Any
    constants: Any
    outputs: Any
    moving: Any
    still: Any


@leaf
def _operate(op, a, b):
    """Evaluate one elementary operation of `robustlab.dynamics.symbolic.symbolic_plant.OPERATIONS`."""
    if op == 0:
        return a + b
    elif op == 1:
        return a - b
    elif op == 2:
        return a * b
    elif op == 3:
        return a / b
    elif op == 4:
        return -a
    elif op == 5:
        return a * a
    elif op == 6:
        return a + a
    elif op == 7:
        return 1.0 / a
    elif op == 8:
        return math.sqrt(a) if a >= 0.0 else math.nan
    elif op == 9:
        return math.sin(a)
    elif op == 10:
        return math.cos(a)
    elif op == 11:
        return math.tan(a)
    elif op == 12:
        return np.arcsin(a)
    elif op == 13:
        return np.arccos(a)
    elif op == 14:
        return math.atan(a)
    elif op == 15:
        return math.atan2(a, b)
    elif op == 16:
        return np.exp(a)
    elif op == 17:
        return np.log(a)
    elif op == 18:
        return a**b
    elif op == 19:
        return np.sinh(a)
    elif op == 20:
        return np.cosh(a)
    elif op == 21:
        return math.tanh(a)
    elif op == 22:
        return math.asinh(a)
    elif op == 23:
        return np.arccosh(a)
    elif op == 24:
        return np.arctanh(a)
    elif op == 25:
        return np.expm1(a)
    elif op == 26:
        return np.log1p(a)
    elif op == 27:
        return math.hypot(a, b)
    elif op == 28:
        return abs(a)
    elif op == 29:
        return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else a)
    elif op == 30:
        return min(a, b)
    elif op == 31:
        return max(a, b)
    elif op == 32:
        return 1.0 if a < b else 0.0
    elif op == 33:
        return 1.0 if a <= b else 0.0
    elif op == 34:
        return 1.0 if a == b else 0.0
    elif op == 35:
        return 1.0 if a != b else 0.0
    elif op == 36:
        return 1.0 if a == 0.0 else 0.0
    elif op == 37:
        return 1.0 if a != 0.0 and b != 0.0 else 0.0
    elif op == 38:
        return 1.0 if a != 0.0 or b != 0.0 else 0.0
    elif op == 39:
        return b if a != 0.0 else 0.0
    elif op == 40:
        return math.erf(a)
    elif op == 41:
        return math.copysign(a, b)
    return math.nan


@leaf
def _run(code, start, stop, first, w):
    """Execute operations start .. stop - 1 on the row w; ``first``: place of the first result."""
    operations, left, right = code.operations, code.left, code.right
    k = start
    while k < stop:
        op, end = operations[k], k + 1
        while end < stop and operations[end] == op:
            end += 1
        if op == 0:
            for i in range(k, end):
                w[first + i] = w[left[i]] + w[right[i]]
        elif op == 1:
            for i in range(k, end):
                w[first + i] = w[left[i]] - w[right[i]]
        elif op == 2:
            for i in range(k, end):
                w[first + i] = w[left[i]] * w[right[i]]
        else:
            for i in range(k, end):
                w[first + i] = _operate(op, w[left[i]], w[right[i]])
        k = end


@leaf
def _row(code, n_in):
    """Return a row for a tape of n_in inputs, with its constants."""
    w = np.empty(n_in + code.constants.shape[0] + code.operations.shape[0])
    for k in range(code.constants.shape[0]):
        w[n_in + k] = code.constants[k]
    return w


_VECTOR, _MATRIX, _PLACES = types.float64[::1], types.float64[:, ::1], types.uint32[::1]
_CODE = types.NamedTuple((_PLACES, _PLACES, _PLACES, _VECTOR, _PLACES, types.int64, types.int64), Code)
_INPUTS = types.NamedTuple((_VECTOR, types.float64[:, :, ::1], types.boolean[::1]), Inputs)


@entry(types.void(_CODE, _MATRIX, _MATRIX))
def evaluate(code, points, results):
    """Evaluate outputs (n, n_out) of a tape at the points (n, n_in)."""
    n, n_in = points.shape
    first = n_in + code.constants.shape[0]
    w = _row(code, n_in)
    for p in range(n):
        same = p > 0
        for i in range(n_in):
            same = same and (i < code.moving or w[i] == points[p, i])
            w[i] = points[p, i]
        if not same:
            _run(code, 0, code.still, first, w)
        _run(code, code.still, code.operations.shape[0], first, w)
        for j in range(code.outputs.shape[0]):
            results[p, j] = w[code.outputs[j]]


class Plant(NamedTuple):
    """A tape of rates, place of its first result, row of values."""

    code: Any
    first: Any
    w: Any


def _rates(z, u, machine, dz):
    code, first, w = machine
    n = z.shape[0]
    for i in range(n):
        w[i] = z[i]
    for i in range(u.shape[0]):
        w[n + i] = u[i]
    _run(code, code.still, code.operations.shape[0], first, w)
    for i in range(n):
        dz[i] = w[code.outputs[i]]


answers(Plant, _rates)

_OUTCOME = types.Tuple((types.int64, types.float64, types.int64, types.int64))


@entry(_OUTCOME(_CODE, _VECTOR, _VECTOR, _INPUTS, types.float64, _MATRIX))
def integrate(code, start, values, inputs, rtol, x_at):
    """Integrate the tape (x, u, values) -> rates; write states (n, n_x) at the times of the inputs (n,)."""
    n, n_u = start.shape[0], inputs.polynomials.shape[2]
    n_in = n + n_u + values.shape[0]
    w, first = _row(code, n_in), n_in + code.constants.shape[0]
    for i in range(values.shape[0]):
        w[n + n_u + i] = values[i]
    _run(code, 0, code.still, first, w)
    return integrated(start, inputs, Plant(code, first, w), rtol, np.full(n, LEAST_SCALE), np.ones(n), x_at)
