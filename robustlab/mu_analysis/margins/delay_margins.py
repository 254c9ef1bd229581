r"""Gains of models with exact delays: attained at a frequency, and proved on the whole axis.

The largest gain over frequency is bracketed: from below by the exact response at the frequency where it was found
largest, from above by the exact responses at points and how far the response can go between them
(`robustlab.mu_analysis.margins.delay_axis`); `delay_stability` and `robustlab.delays.pade` have the other proofs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.margins.delay_axis import FINEST, DelayAxis, Measured, proved_peak
from robustlab.mu_analysis.margins.delay_stability import DelayStability, delay_stability
from robustlab.norms import PeakGain
from robustlab.result import Status
from robustlab.shown import Facts

__all__ = ["DelayGain", "delay_gain"]

POINTS, PEAKS = 4000, 4
ROUNDING = 1e-12
SHARE = 0.1  # of the tolerance that the proof aims at: it is cheap


@dataclass(frozen=True, eq=False)
class DelayGain(PeakGain):
    """Bounds of the largest gain over frequency of a model with exact delays.

    Attributes
    ----------
    lower, upper
        ``lower <= gain <= upper``: the exact gain at ``frequency``, and a bound that is proved on the whole axis; inf
        where none was. Both inf where the model is proved not to be stable.
    frequency
        In rad/s.
    stability
        That of the model, without which no gain is proved.
    status
        CERTIFIED where the bounds are within the tolerance, INACCURATE where they are not, INCONCLUSIVE without an
        upper one.
    system
        The model, for `robustlab.verify`.
    """

    frequency: float
    unstable: ClassVar[str] = "infinite: the model is not stable"

    stability: DelayStability
    system: DelayedModel | None = None

    unsaved: ClassVar[tuple[str, ...]] = ("system",)

    def evidence(self) -> Facts:
        """Whether the model is stable, and the root that shows that it is not."""
        facts = self.stability.facts()
        return [facts[0], *(facts[3:4] if self.stability.stable is False else [])]


@told_as("delay_gain")
def delay_gain(model: DelayedModel, tolerance: float = 0.01, highest_order: int = 16, effort: float = 1.0) -> DelayGain:
    """`robustlab.peak_gain` of a model with exact delays, or of one without."""
    g = as_delayed(model, "delay_gain")
    if not FINEST <= tolerance < 1:
        raise InputError("delay_gain: tolerance", f"{tolerance!r}", f"a number from {FINEST:g} to 1")
    known = delay_stability(g, highest_order, effort)
    if known.stable is False:
        return DelayGain(np.inf, np.inf, np.nan, Status.CERTIFIED, known)
    lower, frequency = _attained(g)
    if not known.stable:
        return DelayGain(lower, np.inf, frequency, Status.INCONCLUSIVE, known)
    axis = DelayAxis(g, range(g.n_outputs), range(g.n_inputs))
    best = [lower, frequency]

    def attained(response: ComplexArray, omega: Array) -> float:
        size = np.linalg.norm(response, 2, axis=(1, 2))
        k = int(np.argmax(size)) if len(size) else 0
        if len(size) and size[k] > best[0]:
            best[:] = float(size[k]), float(omega[k])
        return best[0]

    def measured(response: ComplexArray) -> Measured:
        return Measured(np.linalg.norm(response, 2, axis=(1, 2)) * (1.0 + ROUNDING), np.ones(len(response)))

    upper = proved_peak(axis, axis.D, SHARE * tolerance, attained, measured)
    near = upper <= (1.0 + tolerance) * best[0] * (1.0 + 10.0 * ROUNDING)
    status = Status.CERTIFIED if near else Status.INACCURATE if np.isfinite(upper) else Status.INCONCLUSIVE
    return DelayGain(best[0], upper, best[1], status, known, g)


def _attained(g: DelayedModel) -> tuple[float, float]:
    """The largest exact gain found, and its frequency: a grid, then each of its highest peaks by itself."""
    from scipy.optimize import minimize_scalar

    grid = np.concatenate([[0.0], default_grid(g.pade(4), POINTS)])
    if len(g.delays):  # echoes are as far apart as the delays turn
        turns = np.linspace(0.0, 40.0, POINTS) / g.delays.max()
        grid = np.unique(np.concatenate([grid, turns]))
    size = _gains(g, grid)
    inner = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])) + 1
    highest = inner[np.argsort(-size[inner])][:PEAKS]
    found = [(float(size.max()), float(grid[np.argmax(size)]))]
    for k in highest:
        ends = float(grid[k - 1]), float(grid[k + 1])
        near: Any = minimize_scalar(lambda w: -_gains(g, np.array([w]))[0], bounds=ends, method="bounded")
        found.append((-float(near.fun), float(near.x)))
    return max(found)


def _gains(g: DelayedModel, omega: Array) -> Array:
    return np.linalg.svd(frequency_response(g, omega), compute_uv=False).max(axis=1, initial=0.0)
