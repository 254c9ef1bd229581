"""Metrics of the response of one output to a given input: deviation, peak, RMS, overshoot, settling time.

The control effort of a closed loop is the peak or the RMS of its control signal, which is an output of the loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, Excitation, Hold, members, time_responses
from robustlab.worst_case_analysis.metric_contract import (
    Evaluation,
    Metric,
    connected,
    need_real,
    need_stable,
    selected,
)

NO_FINAL_VALUE = 1e-9  # share of a response's size below which a final value is zero


class TimeMetric(Metric):
    """What metrics of a response share. It starts from zero initial state.

    ``uncertain``: set with real blocks.
    ``output``: name of the output.
    ``drive``, ``hold``: times, input, and what the input does between samples.
    """

    name = "response"
    location = "t [s]"

    def __init__(self, uncertain: UncertainModel, output: str, drive: Excitation, hold: Hold) -> None:
        need_real(uncertain, self.name)
        self.uncertain = connected(selected(uncertain, None, output))
        self.unit = self.uncertain.outputs[0].unit
        self._drive = drive
        self._hold: Hold = hold
        self._centre = members(self.uncertain, np.zeros((1, *self.uncertain.delta_shape)))
        self._nominal = self._responses(self._centre)[0]

    @property
    def clock(self) -> Array:
        """Times in s, (n_t,)."""
        return self._drive.t

    def response(self, delta: Mapping[str, Any]) -> Array:
        """The output of a member, (n_t,), by the second way.

        Raises NoTrustworthyNumber: it outgrows double precision.
        """
        return self._simulated(self.uncertain.evaluate(delta))

    def _responses(self, ensemble: Ensemble) -> Array:
        start = np.zeros(ensemble.A.shape[1])
        return time_responses(ensemble, self._drive, start, self._hold)[:, :, 0]

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        """Value of each response (k, n_t), and the sample where it is attained."""
        raise NotImplementedError

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        with np.errstate(all="ignore"):
            value = self._measure(self._responses(ensemble), ensemble)[0]
        return np.where(ensemble.ill_posed | np.isnan(value), np.inf, value)

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; `robustlab.dynamics.simulation.simulate` is the second way."""
        try:
            y = self._simulated(model)
        except NoTrustworthyNumber:
            return Evaluation(np.inf, reason="the response outgrows double precision")
        return self._judge(model, y)

    def _simulated(self, model: StateSpaceModel) -> Array:
        from robustlab.dynamics.simulation import simulate

        return np.asarray(simulate(model, self._drive.t, self._drive.u, hold=self._hold)[model.output_names[0]])

    def _judge(self, model: StateSpaceModel, y: Array) -> Evaluation:
        """The metric of a simulated response (n_t,)."""
        raise NotImplementedError

    def _attained(self, size: Array) -> Evaluation:
        worst = int(size.argmax())
        return Evaluation(float(size[worst]), float(self._drive.t[worst]))

    def work(self, count: int) -> float:
        """See `Metric.work`; members side by side share most of the steps."""
        n, steps = self.uncertain.M.n_states, len(self._drive.t)
        return 300 + steps * (0.1 + n**2 / 160) + count * (20 + n**3 / 50 + steps * (0.05 + n**2 / 6000))


class PeakDeviation(TimeMetric):
    """Largest ``|y(t; Delta) - y(t; 0)|`` over the given times."""

    name = "peak-deviation"

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        gap = np.abs(y - self._nominal)
        return gap.max(axis=1), gap.argmax(axis=1)

    def _judge(self, model: StateSpaceModel, y: Array) -> Evaluation:
        return self._attained(np.abs(y - self._simulated(self.uncertain.nominal)))


class Peak(TimeMetric):
    """Largest ``|y(t)|`` over the given times."""

    name = "peak"

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        return np.abs(y).max(axis=1), np.abs(y).argmax(axis=1)

    def _judge(self, model: StateSpaceModel, y: Array) -> Evaluation:
        return self._attained(np.abs(y))


class Rms(TimeMetric):
    r"""Root mean square over the given times, :math:`\sqrt{\frac1T \int_0^T y^2 dt}` by the trapezoidal rule."""

    name = "rms"
    location = ""

    @property
    def _shares(self) -> Array:
        shares = np.full(len(self._drive.t), 1.0 / (len(self._drive.t) - 1))
        shares[[0, -1]] *= 0.5
        return shares

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        return np.sqrt((y**2 * self._shares).sum(axis=1)), np.zeros(len(y), dtype=np.intp)

    def _judge(self, model: StateSpaceModel, y: Array) -> Evaluation:
        return Evaluation(float(np.sqrt(np.trapezoid(y**2, self._drive.t) / np.ptp(self._drive.t))))


class _Settled(TimeMetric):
    """What metrics share that are relative to the final value."""

    def __init__(self, uncertain: UncertainModel, output: str, drive: Excitation, hold: Hold) -> None:
        super().__init__(uncertain, output, drive, hold)
        if np.ptp(drive.u, axis=0).max(initial=0.0) > 0:
            raise InputError("worst_case", "an input that changes", f"constant inputs: {self.name} is that of a step")
        need_stable(self.uncertain.nominal, f"it has no {self.name}")
        final = float(self._finals(self._centre)[0])
        if abs(final) <= NO_FINAL_VALUE * float(np.abs(self._nominal).max(initial=0.0)):
            raise NoTrustworthyNumber(
                "worst_case",
                f"the nominal response settles at {final:.3g}",
                f"a final value other than zero: {self.name} is relative to it",
                "use the metric peak",
            )

    def _finals(self, ensemble: Ensemble) -> Array:
        """Final values of all members (k,); infinite where a member does not settle."""
        n = ensemble.A.shape[1]
        stable = ensemble.is_stable()
        final = np.full(len(ensemble), np.inf)
        some = ensemble.part(np.flatnonzero(stable))
        u = self._drive.u[0]
        shift = np.eye(n) if ensemble.dt else np.zeros((n, n))
        x = np.linalg.solve(shift - some.A, (some.B @ u)[:, :, None])
        final[stable] = (some.C @ x)[:, 0, 0] + some.D[:, 0] @ u
        return final

    def _judge(self, model: StateSpaceModel, y: Array) -> Evaluation:
        if model.n_states and not model.is_stable():
            return Evaluation(np.inf, reason="this member is unstable and never settles")
        return self._relative(y, float(model.dc_gain()[0] @ self._drive.u[0]))

    def _relative(self, y: Array, final: float) -> Evaluation:
        raise NotImplementedError


class Overshoot(_Settled):
    """How far a step response goes beyond its final value, in percent of it; 0 where it never does."""

    name = "overshoot"

    def __init__(self, uncertain: UncertainModel, output: str, drive: Excitation, hold: Hold) -> None:
        super().__init__(uncertain, output, drive, hold)
        self.unit = "%"

    def slack(self, value: float) -> float:
        """See `Metric.slack`: percent of a final value that both ways know to the tolerance."""
        return self.tolerance * (100.0 + abs(value))

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        final = self._finals(ensemble)
        share = y / final[:, None]
        value = 100.0 * np.maximum(share.max(axis=1) - 1.0, 0.0)
        return np.where(np.isfinite(final), value, np.inf), share.argmax(axis=1)

    def _relative(self, y: Array, final: float) -> Evaluation:
        found = self._attained(y / final)
        return Evaluation(max(0.0, 100.0 * (found.value - 1.0)), found.at)


class SettlingTime(_Settled):
    """Last time at which a step response is farther from its final value than ``band`` times it, in s.

    Interpolated between samples. Infinite for a member that is unstable, or still outside at the last of the given
    times; the re-evaluation says which.
    """

    name = "settling-time"
    location = ""
    smooth = False

    def __init__(
        self, uncertain: UncertainModel, output: str, drive: Excitation, hold: Hold, band: float = 0.02
    ) -> None:
        if not 0 < band < 1:
            raise InputError("worst_case", f"band is {band!r}", "a share of the final value between 0 and 1")
        super().__init__(uncertain, output, drive, hold)
        self.unit, self.band = "s", band

    def slack(self, value: float) -> float:
        """See `Metric.slack`: a crossing is known to a share of the step only."""
        return self.tolerance * (abs(value) + self._drive.h)

    def _measure(self, y: Array, ensemble: Ensemble) -> tuple[Array, NDArray[np.intp]]:
        final = self._finals(ensemble)
        value = settling_times(self._drive.t, y, final, self.band)
        return value, np.zeros(len(y), dtype=np.intp)

    def _relative(self, y: Array, final: float) -> Evaluation:
        value = float(settling_times(self._drive.t, y[None], np.array([final]), self.band)[0])
        last = f"{self._drive.t[-1]:.6g}"
        reason = "" if np.isfinite(value) else f"this member has not settled by t = {last} s, the last of the times"
        return Evaluation(value, reason=reason)


def settling_times(t: Array, y: Array, final: Array, band: float) -> Array:
    """When responses y (k, n_t) come to stay within ``band * |final|`` of their final values (k,), shape (k,)."""
    gap = y - final[:, None]
    edge = band * np.abs(final)
    outside: NDArray[Any] = ~(np.abs(gap) <= edge[:, None])
    last = len(t) - 1 - outside[:, ::-1].argmax(axis=1)
    rows = np.arange(len(y))
    following = np.minimum(last + 1, len(t) - 1)
    here, there = gap[rows, last], gap[rows, following]
    with np.errstate(all="ignore"):
        share = (np.abs(here) - edge) / (np.abs(here) - np.sign(here) * there)
        crossing = t[last] + share * (t[following] - t[last])
    settled = np.where(outside.any(axis=1), crossing, 0.0)
    return np.where(outside[:, -1] | ~np.isfinite(final), np.inf, settled)
