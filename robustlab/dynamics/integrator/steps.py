# pyright: reportMissingParameterType=false
# (the compiler infers the types of the leaves)
"""Steps of the Runge-Kutta pair DOP853 under inputs that are piecewise polynomials of time; to be compiled in."""
# Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", Springer 1993, section II.10 (their code DOP853,
# whose coefficients scipy carries).

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from robustlab.errors import EnvironmentFault

_options: dict[str, Any] = {"error_model": "numpy", "nogil": True}
leaf = njit(**_options)


def entry(*signatures):
    """Compile for the given signatures, and keep the code on disk."""
    return njit(list(signatures), cache=True, **_options)


try:
    from scipy.integrate._ivp import dop853_coefficients as table
    from scipy.integrate._ivp.dop853_coefficients import E3, E5, A, B, C, D  # noqa: F401  # pyright: ignore[reportUnusedImport]
except ImportError as error:
    raise EnvironmentFault(
        "DOP853", f"scipy no longer has its coefficients where they were ({error})", "scipy < 1.18"
    ) from error


# Stages 0..11 make the step, stage 12 is its end, 13..15 serve the dense output.
STAGES_EXTENDED = 16
TABLE = table.__file__
SHAPES = {"A": (16, 16), "B": (12,), "C": (16,), "D": (4, 16), "E3": (13,), "E5": (13,)}

for name, shape in SHAPES.items():
    if getattr(table, name).shape != shape:
        raise EnvironmentFault("DOP853", f"scipy's {name} has the shape {getattr(table, name).shape}", f"{shape}")


SAFETY, SMALLEST, LARGEST = 0.9, 0.2, 10.0
EXPONENT = -1.0 / 8.0
MAX_STEPS = 1_000_000


class Inputs(NamedTuple):
    """Inputs as functions of time: times (n,), polynomials (n - 1, 6, n_u) between two, and before which they break."""

    clock: Any
    polynomials: Any
    broken: Any


@leaf
def input_within(t, k, inputs, u):
    """Input (n_u,) at t by the polynomial of interval k into u."""
    s = t - inputs.clock[k]
    for i in range(u.shape[0]):
        value = 0.0
        for j in range(5, -1, -1):
            value = value * s + inputs.polynomials[k, j, i]
        u[i] = value


@leaf
def input_between(t, span, k, inputs, u):
    """Input at t, read from the intervals of the span (first, one past the last): at a break the near side counts."""
    first, following = span
    while k > first and t < inputs.clock[k]:
        k -= 1
    while k < following - 1 and t > inputs.clock[k + 1]:
        k += 1
    input_within(t, k, inputs, u)
    return k


@leaf
def norm(a, scale):
    """Root mean square of a / scale, both (n,)."""
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] / scale[i]) ** 2
    return np.sqrt(total / a.shape[0])


@leaf
def stage_point(s, z, h, stages, at):
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
def step_end(z, h, stages, end):
    """The step's end z + h sum_j B[j] stages[j] into end."""
    for i in range(z.shape[0]):
        total = 0.0
        for j in range(12):
            total += B[j] * stages[j, i]
        end[i] = z[i] + h * total


@leaf
def polynomial(z, end, h, stages, f):
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
def dense(z, f, share, out):
    """State at the share 0 .. 1 of a step from z with the coefficients of `polynomial`, into out."""
    for i in range(z.shape[0]):
        value = 0.0
        for row in range(6, -1, -1):
            value += f[row, i]
            value *= share if row % 2 == 0 else 1.0 - share
        out[i] = z[i] + value


@leaf
def error_of(h, stages, scale):
    """Error of a step of length h with the stages (13.., n), as a share of the scale (n,): below 1 it is accepted."""
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
def piece_end(piece, last, broken):
    """Sample up to which the inputs of ``piece`` are smooth."""
    end = piece + 1
    while end < last and not broken[end]:
        end += 1
    return end


@leaf
def first_step(z, rates, scale):
    """Length of the first step (s), from the size of the states beside that of their rates."""
    h = 0.01 * norm(z, scale) / max(norm(rates, scale), 1e-12)
    return min(max(h, 1e-6), 1e-2)


@leaf
def shorter(step, error):
    """Length after a step that was refused."""
    if not np.isfinite(error):
        error = 1e12
    return step * max(SMALLEST, SAFETY * error**EXPONENT)


@leaf
def next_step(h, step, error, ends):
    """Length after a step that was taken; one that was cut to end with its piece says nothing where it would shrink."""
    growth = LARGEST
    if error > 0.0:
        growth = min(LARGEST, SAFETY * error**EXPONENT)
    return step * max(growth, SMALLEST) if not ends or growth * step < h else h
