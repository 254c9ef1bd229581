"""Time response of the critical Delta."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.display import AllFields, Displayable, Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import realise_delta

__all__ = ["CriticalResponse", "replay"]


INSIDE = 0.95  # share of the critical Delta of the response just inside the margin


@dataclass(frozen=True, eq=False)
class CriticalResponse(AllFields, Displayable):
    """Free responses from the critical mode: of the nominal model, just inside the margin, and at the critical Delta.

    Attributes
    ----------
    t
        Times in s, shape (n,).
    outputs
        Signals of the columns.
    nominal, inside, critical
        Outputs (n, n_outputs) with no Delta, with 0.95 times the critical one, and with it; the largest output of
        the last starts at one.
    growth
        Size of ``critical`` over the last period divided by that over the first: 1 on the stability boundary.
    period
        Period in s of the critical mode; the time constant of the nominal model's slowest mode where it does not
        oscillate.
    """

    t: Array
    outputs: tuple[Signal, ...]
    nominal: Array
    inside: Array
    critical: Array
    growth: float
    period: float

    def facts(self) -> Facts:
        return [("last period over the first", number(self.growth)), ("period", number(self.period, "s"))]


def replay(uncertain: UncertainModel, margin: Margin, periods: int = 12, points: int = 40) -> CriticalResponse:
    """Simulate the model from the mode that the critical Delta brings to the stability boundary."""
    if not margin.delta or margin.frequency is None:
        raise InputError("replay", "a margin without a critical Delta", "one that was attained")
    if set(margin.delta) - {b.name for b in uncertain.blocks}:
        raise InputError("replay", f"blocks {', '.join(margin.delta)}", "the margin of this very model")
    if not np.isfinite(margin.frequency) or periods < 2 or points < 4:
        found = f"frequency {margin.frequency}, {periods} periods, {points} points"
        raise NoTrustworthyNumber("replay", f"{found}: a loop that is ill-posed, or too short a record, shows nothing")

    omega, nominal = float(margin.frequency), uncertain.nominal

    def member(factor: float) -> StateSpaceModel:
        values = {name: factor * value for name, value in margin.delta.items()}
        return uncertain.evaluate(realise_delta(uncertain.blocks, values, omega, uncertain.dt))

    critical = member(1.0)
    poles, right = np.linalg.eig(critical.A)
    aim = margin.pole if margin.pole is not None else 1j * omega
    k = int(np.argmin(np.minimum(np.abs(poles - aim), np.abs(np.conj(poles) - aim))))
    mode = right[:, k]
    x0 = np.real(mode) if np.abs(np.real(mode)).max() > 1e-3 else np.imag(mode)
    period = 2 * np.pi / omega if omega > 0 else _slowest(nominal)
    t = np.linspace(0.0, periods * period, periods * points + 1)
    if uncertain.dt:
        t = np.arange(max(round(periods * period / uncertain.dt), 2) + 1) * uncertain.dt
    response = _free(critical, x0, t)
    first = float(np.abs(response[t < period]).max(initial=0.0))
    if not first > 1e-12 * float(np.abs(x0).max()):
        raise NoTrustworthyNumber("replay", "the critical mode does not show at any output")
    x0 = x0 / first
    return CriticalResponse(
        t=t,
        outputs=uncertain.outputs,
        nominal=_free(nominal, x0[: uncertain.M.n_states], t),
        inside=_free(member(INSIDE), x0, t),
        critical=response / first,
        growth=float(np.abs(response[t >= t[-1] - period]).max() / first),
        period=float(period),
    )


def _slowest(nominal: StateSpaceModel) -> float:
    poles = nominal.poles()
    rates = -np.log(np.abs(poles[np.abs(poles) > 0])) / nominal.dt if nominal.is_discrete else -poles.real
    return float(1 / rates.min()) if len(rates) and rates.min() > 0 else 1.0


def _free(model: StateSpaceModel, x0: Array, t: Array) -> Array:
    """Outputs (n, n_outputs) without input."""
    from scipy.linalg import expm

    step = model.A if model.is_discrete else expm(model.A * (t[1] - t[0]))
    states = np.empty((len(t), model.n_states))
    states[0] = x0
    for i in range(1, len(t)):
        states[i] = step @ states[i - 1]
    return states @ model.C.T
