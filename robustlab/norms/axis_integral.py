r"""The H2 norm as an integral over the frequency axis: a voice that solves no Lyapunov equation.

.. math:: \|G\|_2^2 = \frac{1}{\pi} \int_0^\infty \|G(j\omega)\|_F^2 \, d\omega, \qquad
    \|G\|_2^2 = \frac{1}{\pi} \int_0^\pi \|G(e^{j\theta})\|_F^2 \, d\theta \quad (dt > 0)

Panels shrink towards the frequency of every pole down to the width of its peak; each is halved until its integral by
Gauss and Legendre's rule no longer moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.statespace import StateSpaceModel

__all__ = ["AxisTuning", "mean_square_gain", "panel_ends"]


@dataclass(frozen=True)
class AxisTuning:
    """How finely the axis is cut."""

    # Points of Gauss and Legendre's rule in a panel.
    nodes: int = 10
    # Next to a pole at a distance r from the axis, panels end at r, r times this, r times its square ...
    growth: float = 8.0
    # A panel is done where halving it moves its integral by less than this share of the whole.
    rtol: float = 1e-10
    # Frequencies at most, and halvings of a panel: what has not settled by then is rounding.
    points: int = 100_000
    halvings: int = 40


TUNING = AxisTuning()


def mean_square_gain(m: StateSpaceModel, tuning: AxisTuning = TUNING) -> tuple[float, bool]:
    """The square of the H2 norm of a stable model, strictly proper where it is continuous, and whether it settled.

    Raises
    ------
    NoTrustworthyNumber
        The frequency response overflows.
    """
    if not m.n_states or not m.n_inputs or not m.n_outputs:
        return float((m.D**2).sum()), True
    ends = panel_ends(m, tuning.growth)
    x, weights = np.polynomial.legendre.leggauss(tuning.nodes)

    def integrals(low: AnyArray, high: AnyArray) -> AnyArray:
        half = 0.5 * (high - low)
        at = 0.5 * (high + low)[:, None] + half[:, None] * x
        return half * (_density(m, at.ravel(), ends[-2]).reshape(at.shape) @ weights)

    low, high = ends[:-1], ends[1:]
    value, done, spent = integrals(low, high), 0.0, 0
    for _ in range(tuning.halvings):
        spent += 2 * len(low) * tuning.nodes
        if spent > tuning.points:
            return (done + float(value.sum())) / np.pi, False
        middle = 0.5 * (low + high)
        left, right = integrals(low, middle), integrals(middle, high)
        total = done + float((left + right).sum())
        moved = np.abs(left + right - value) > tuning.rtol * total
        done += float((left + right)[~moved].sum())
        if not moved.any():
            return done / np.pi, True
        low, high = np.concatenate([low[moved], middle[moved]]), np.concatenate([middle[moved], high[moved]])
        value = np.concatenate([left[moved], right[moved]])
    return (done + float(value.sum())) / np.pi, False


def panel_ends(m: StateSpaceModel, growth: float = TUNING.growth) -> AnyArray:
    """Ends of the first panels: angles from 0 to pi, or frequencies from 0 to W and then one more step for the rest."""
    poles: AnyArray = m.poles()
    if m.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12])
    at, width = np.abs(np.imag(poles)), np.maximum(np.abs(np.real(poles)), np.spacing(np.abs(poles)))
    last = np.pi if m.is_discrete else 4.0 * float(np.abs(poles).max())
    steps = np.ceil(np.log(max(last / width.min(initial=last), 1.0)) / np.log(growth)) + 1
    away = width[:, None] * growth ** np.arange(steps)
    ends = np.concatenate([[0.0, last], at, (at[:, None] + away).ravel(), (at[:, None] - away).ravel()])
    ends = np.unique(ends[(ends >= 0) & (ends <= last)])
    return ends if m.is_discrete else np.append(ends, 2 * last)


def _density(m: StateSpaceModel, at: AnyArray, last: float) -> AnyArray:
    """``||G||_F^2`` at angles; at frequencies, where W + t W stands for the frequency W / (1 - t) beyond the last W."""
    if m.is_discrete:
        omega, stretch = at / m.dt, np.ones_like(at)
    else:
        share = np.where(at > last, 2 - at / last, 1.0)
        omega, stretch = np.where(at > last, last / share, at), 1 / share**2
    response = frequency_response(m, omega)
    square = (np.abs(response) ** 2).sum(axis=(1, 2)) * stretch
    if not np.isfinite(square).all():
        raise NoTrustworthyNumber("h2_norm", "the frequency response overflows")
    return square
