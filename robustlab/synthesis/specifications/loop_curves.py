"""Curves of a finished design over frequency: the weighted loop, its peak, the controller's gains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.frequency import frequency_response
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.design import Synthesis

__all__ = ["LoopCurves", "frequencies", "loop_curves"]

POINTS = 400
SPAN = 1e3


@dataclass(frozen=True, eq=False)
class LoopCurves:
    """Curves of a design.

    Attributes
    ----------
    omega
        Frequencies in rad/s, (n,).
    closed_loop
        Singular values of the weighted loop, largest first, (n, k).
    peak
        Frequency in rad/s and height of the highest point: gamma, where that bounds the norm of the loop.
    level
        What that height is.
    controller
        Norm of the controller's column of each measurement, (n, n_y), in control units per unit of the measurement.
    measurements
        Names of the measurements.
    """

    omega: Array
    closed_loop: Array
    peak: tuple[float, float]
    controller: Array
    measurements: tuple[str, ...]
    level: str


def frequencies(model: StateSpaceModel, points: int = POINTS, around: float | None = None) -> Array:
    """Frequencies in rad/s for a picture of a loop, (points,): a decade beyond its poles, and beyond ``around``.

    Poles more than three decades above the middle one (those of a controller that hurries for nothing) do not stretch
    the picture; a discrete model's ends at its Nyquist frequency.
    """
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / model.dt
    size = np.abs(poles)
    size = size[size > 1e-12 * size.max(initial=0.0)]
    middle = float(np.median(size)) if len(size) else 1.0
    seen = size[(size <= SPAN * middle) & (size >= middle / SPAN)] if len(size) else np.array([1.0])
    low, high = float(seen.min()) / 10, float(seen.max()) * 10
    if around is not None and np.isfinite(around) and around > 0:
        low, high = min(low, around / 10), max(high, around * 10)
    if model.is_discrete:
        high = np.pi / model.dt
        low = min(low, high / 1e3)
    return np.geomspace(low, high, points)


def loop_curves(design: Synthesis) -> LoopCurves:
    """Singular values of the weighted closed loop and gains of the controller, for figures.

    Examples
    --------
    >>> from robustlab.synthesis import hinf
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> curves = loop_curves(hinf(P, 1, 1))
    >>> bool((curves.closed_loop[:, 0] <= curves.peak[1] * (1 + 1e-9)).all())
    True
    """
    omega = frequencies(design.closed_loop, around=getattr(design, "peak_frequency", None))
    sigma = np.linalg.svd(frequency_response(design.closed_loop, omega), compute_uv=False).astype(np.float64)
    at = float(getattr(design, "peak_frequency", np.nan))
    peak, level = (at, float(design.gamma)), "γ, verified"
    if not np.isfinite(at):  # gamma is another norm, or that of another loop
        highest = int(sigma[:, 0].argmax())
        peak, level = (float(omega[highest]), float(sigma[highest, 0])), "highest of the curve"
    gains = np.linalg.norm(frequency_response(design.K, omega), axis=1)
    names = tuple(s.name for s in design.plant.measurements)
    return LoopCurves(omega, sigma, peak, gains, names, level)
