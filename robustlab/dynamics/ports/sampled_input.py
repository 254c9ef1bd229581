r"""An input between its samples, shifted in time, as what a simulation's steps see of it.

A sampled input is one polynomial per sample interval, with :math:`\theta = (t - t_k)/\Delta t \in [0, 1)`:

.. math:: u(t_k + \theta\,\Delta t) = \sum_m c_{km}\, \theta^m

``"zoh"``: held, :math:`c_{k0} = u_k`; ``"linear"``: the straight line to the next sample; ``"smooth"``: the spline of
degree five through the samples, for inputs that were band-limited before they were sampled. A sine of 8 samples a
period keeps :math:`\operatorname{sinc}^2(1/8) = 0.95` of its amplitude as straight lines, and 0.99999 as that spline.
Before its first and after its last sample the input stands still.

Over a step of the simulation the input counts by its mean m and its first moment, those of the line
:math:`m + s (2\tau/h - 1)`; whatever lies within the step (an edge, a kink) has both exactly, so that the response is
third order in the step and smooth in the shift. The line is given by its values at a quarter and at three quarters of
the step, which are the means of its halves.

References
----------
Unser, Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16 (1999) 22-38.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import unknown_name

__all__ = ["Hold", "SampledInput"]

Hold = Literal["zoh", "linear", "smooth"]
DEGREE = 5


class SampledInput:
    """One input of a record.

    Parameters
    ----------
    samples
        Shape (n,).
    hold
        What it is between them.

    Raises
    ------
    InputError
        An unknown hold.
    """

    def __init__(self, samples: Array, hold: Hold = "zoh") -> None:
        if hold not in get_args(Hold):
            raise unknown_name("hold of an input", f"{hold!r}", hold, get_args(Hold))
        self.hold: Hold = hold
        self.count = len(samples)
        pieces = samples[:, None] if hold == "zoh" else _pieces(samples, 1 if hold == "linear" else DEGREE)
        still = np.zeros((1, pieces.shape[1]))
        still[0, 0] = samples[0]
        self._pieces = np.vstack([still, pieces])  # row k + 1: the interval after sample k; row 0: before the first

    def steps(self, sub: int, shift: float = 0.0) -> Array:
        """Means of the halves of each step, (n * sub, 2), ``sub`` steps a sample; ``shift`` in samples (late: > 0)."""
        found = np.empty((self.count, sub, 2))
        for r in range(sub):
            start = r / sub - shift
            first = int(np.floor(start))
            into, across = _weights(start - first, 1.0 / sub, self._pieces.shape[1])
            found[:, r] = self._after(first) @ into
            if across.any():
                found[:, r] += self._after(first + 1) @ across
        return found.reshape(-1, 2)

    def samples(self, shift: float = 0.0) -> Array:
        """The shifted input at the samples, (n,)."""
        first = int(np.floor(-shift))
        return self._after(first) @ (-shift - first) ** np.arange(self._pieces.shape[1])

    def _after(self, first: int) -> Array:
        """Coefficients of the intervals ``first`` samples after each sample."""
        return self._pieces[np.clip(np.arange(self.count) + first + 1, 0, self.count)]


def _pieces(samples: Array, degree: int) -> Array:
    """Coefficients (n, degree + 1) of the spline; its degree is odd, and less where there are too few samples."""
    from scipy.interpolate import PPoly, make_interp_spline

    n = len(samples)
    degree = min(degree, n - 1)
    degree -= 1 - degree % 2 if degree else 0
    found = np.zeros((n, degree + 1))
    if degree > 0:
        spline = PPoly.from_spline(make_interp_spline(np.arange(n), samples, k=degree))
        # An odd spline's inner knots are samples; near the ends one piece spans several of them.
        for m in range(degree + 1):
            found[:-1, m] = spline(np.arange(n - 1), nu=m) / _factorial(m)
    found[:, 0] = samples
    return found


def _factorial(m: int) -> float:
    return float(np.prod(np.arange(1, m + 1)))


def _weights(a: float, w: float, terms: int) -> tuple[Array, Array]:
    r"""Weights (terms, 2) with which a step from :math:`\theta = a` of width w sees two neighbouring intervals.

    Of each power :math:`\theta^m` the mean :math:`\frac1w \int \theta^m d\theta` and the slope
    :math:`\frac{6}{w^2} \int (\theta - c)\, \theta^m d\theta` about the step's middle c.
    """
    m = np.arange(terms)

    def seen(low: float, high: float, middle: float) -> Array:
        mean = (high ** (m + 1) - low ** (m + 1)) / (m + 1) / w
        slope = 6.0 / w * ((high ** (m + 2) - low ** (m + 2)) / (m + 2) / w - middle * mean)
        return np.column_stack([mean - 0.5 * slope, mean + 0.5 * slope])

    middle = a + 0.5 * w
    if a + w <= 1.0:
        return seen(a, a + w, middle), np.zeros((terms, 2))
    return seen(a, 1.0, middle), seen(0.0, a + w - 1.0, middle - 1.0)
