"""Sampled inputs as functions of time: held, straight between the samples, or a spline through them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError

__all__ = ["InputSignal", "NonlinearHold", "input_signal"]

Array = NDArray[np.float64]
NonlinearHold = Literal["zoh", "foh", "spline"]

# Slopes that differ by less than this share of the largest one are one straight line.
STRAIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class InputSignal:
    """Inputs that are a polynomial of degree 5 between two times.

    Attributes
    ----------
    t
        Times in s, shape (n,).
    coefficients
        ``u(t) = sum_j coefficients[k, j] (t - t[k])^j`` for t[k] <= t <= t[k + 1]; shape (n - 1, 6, n_u).
    broken
        True where interval k does not continue the one before smoothly: there an integrator must restart; (n - 1,).
    """

    t: Array
    coefficients: Array
    broken: NDArray[np.bool_]

    def at(self, time: float, interval: int) -> Array:
        """Input (n_u,) at a time, by the polynomial of the given interval."""
        return np.polynomial.polynomial.polyval(time - self.t[interval], self.coefficients[interval])


def input_signal(t: Array, samples: Array, hold: NonlinearHold) -> InputSignal:
    """Signal through the samples (n, n_u).

    Parameters
    ----------
    hold
        "zoh": constant until the next sample (a D/A converter). "foh": straight to the next sample. "spline": the
        not-a-knot spline of degree 5, for a smooth signal (a cubic one would break the integrator's order at every
        sample); it needs at least 6 samples.

    Raises
    ------
    InputError
        An unknown hold, or a spline of fewer than 6 samples.
    """
    coefficients = np.zeros((len(t) - 1, 6, samples.shape[1]))
    broken = np.zeros(len(t) - 1, dtype=np.bool_)
    if hold == "zoh":
        coefficients[:, 0] = samples[:-1]
        broken[1:] = (samples[1:-1] != samples[:-2]).any(axis=1)
    elif hold == "foh":
        slope = np.diff(samples, axis=0) / np.diff(t)[:, None]
        coefficients[:, 0], coefficients[:, 1] = samples[:-1], slope
        broken[1:] = (np.abs(np.diff(slope, axis=0)) > STRAIGHT * np.abs(slope).max(initial=0.0)).any(axis=1)
    elif hold == "spline":
        if len(t) < 6:
            raise InputError("simulate: hold", f"'spline' through {len(t)} samples", "at least 6")
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(t, samples, k=5)
        for j in range(6):
            coefficients[:, j] = spline(t[:-1], nu=j) / math.factorial(j)
    else:
        raise InputError("simulate: hold", f"{hold!r}", "'zoh', 'foh' or 'spline'")
    return InputSignal(t, coefficients, broken)
