"""What "worst" means: peak deviation of an output, H-infinity gain, spectral abscissa.

Every metric has two ways to its value: ``values`` for many Deltas at once, which a search uses, and ``evaluate`` for
one, through `UncertainModel.evaluate` and the routines that a user would call: the result is re-evaluated with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.frequency import default_grid
from robustlab.structural import drop_unconnected
from robustlab.uncertainty.blocks import RealScalar, delta_matrix
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, Hold, chunks, members, peak_gains, time_responses
from robustlab.worst_case_analysis.excitation import Excitation

__all__ = ["Evaluation", "HinfGain", "Metric", "PeakDeviation", "SpectralAbscissa", "connected"]

Array = NDArray[np.float64]

GRID_POINTS = 48


class Evaluation(NamedTuple):
    """A metric at one Delta.

    Attributes
    ----------
    value
        The metric; ``inf`` where there is no bounded value.
    at
        Time in s or frequency in rad/s where it is attained; NaN where there is none.
    accurate
        False where the routine behind it lost digits.
    """

    value: float
    at: float = np.nan
    accurate: bool = True


class Metric(Protocol):
    """A number for each member of a set; the larger the worse.

    Attributes
    ----------
    uncertain
        The set, without what does not matter for the metric.
    unit
        Unit of the value; empty where not stated.
    location
        What ``at`` is: ``"t [s]"``, ``"omega [rad/s]"``, or empty.
    """

    uncertain: UncertainModel
    unit: str
    location: str

    def values(self, delta: NDArray[Any]) -> Array:
        """The metric at a stack of Deltas (k, q, p), shape (k,); ``inf`` where there is no bounded value."""
        ...

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """The metric at one Delta."""
        ...


def connected(uncertain: UncertainModel) -> UncertainModel:
    """The same set without states that no input reaches or no output sees, whatever Delta is."""
    return UncertainModel(drop_unconnected(uncertain.M), uncertain.blocks)


class PeakDeviation:
    """Largest ``|y(t; Delta) - y(t; 0)|`` over the given times, from zero initial state."""

    location = "t [s]"

    def __init__(self, uncertain: UncertainModel, output: str, drive: Excitation, hold: Hold) -> None:
        for block in uncertain.blocks:
            if not isinstance(block, RealScalar):
                raise InputError(
                    "worst_case",
                    f"block {block.name!r} is complex",
                    "real blocks",
                    "a complex Delta has a metric 'hinf' only",
                )
        self.uncertain = connected(_selected(uncertain, None, output))
        self.unit = self.uncertain.outputs[0].unit
        self._drive = drive
        self._hold: Hold = hold
        self._nominal = self._responses(members(self.uncertain, np.zeros((1, *uncertain.delta_shape))))[0]

    def _responses(self, ensemble: Ensemble) -> Array:
        start = np.zeros(ensemble.A.shape[1])
        return time_responses(ensemble, self._drive.h, self._drive.u, start, self._hold)[:, :, 0]

    def values(self, delta: NDArray[Any]) -> Array:
        """See `Metric.values`."""
        ensemble = members(self.uncertain, delta)
        with np.errstate(invalid="ignore", over="ignore"):
            deviation = np.abs(self._responses(ensemble) - self._nominal).max(axis=1)
        return np.where(ensemble.ill_posed | np.isnan(deviation), np.inf, deviation)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """See `Metric.evaluate`; `robustlab.dynamics.simulation.simulate` is the second way."""
        from robustlab.dynamics.simulation import simulate

        output, t, u = self.uncertain.outputs[0].name, self._drive.t, self._drive.u
        try:
            member = simulate(self.uncertain.evaluate(delta), t, u, hold=self._hold)[output]
        except NoTrustworthyNumber:  # ill-posed, or outgrown double precision
            return Evaluation(np.inf)
        deviation = np.abs(member - simulate(self.uncertain.nominal, t, u, hold=self._hold)[output])
        worst = int(deviation.argmax())
        return Evaluation(float(deviation[worst]), float(t[worst]))


class HinfGain:
    """H-infinity norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    location = "omega [rad/s]"
    unit = ""

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        self.uncertain = connected(_selected(uncertain, input, output))
        nominal = self.uncertain.nominal
        if not nominal.is_stable() and nominal.n_states:
            poles = nominal.poles()
            worst = poles[np.argmax(np.abs(poles) if nominal.is_discrete else poles.real)]
            raise NoTrustworthyNumber(
                "worst_case",
                f"nominal model is not asymptotically stable (pole {worst:.4g}): its H-infinity norm is infinite",
                None,
                "choose an output that does not see this pole, or close a loop around the model first",
            )
        self._grid = default_grid(nominal, GRID_POINTS)

    def values(self, delta: NDArray[Any]) -> Array:
        """See `Metric.values`."""
        return peak_gains(members(self.uncertain, delta), self._grid)[0]

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """See `Metric.evaluate`; for a real Delta `robustlab.norms.hinf_norm` is the second way."""
        from robustlab.norms import hinf_norm

        if np.iscomplexobj(delta_matrix(self.uncertain.blocks, delta)):
            return self._complex_gain(delta)
        try:
            norm = hinf_norm(self.uncertain.evaluate(delta))
        except NoTrustworthyNumber:  # ill-posed
            return Evaluation(np.inf)
        return Evaluation(norm.value, norm.frequency, norm.status.trustworthy)

    def _complex_gain(self, delta: Mapping[str, Any]) -> Evaluation:
        """Gain at the frequency that the search found, from `UncertainModel.response`; stability from the poles."""
        stack = delta_matrix(self.uncertain.blocks, delta)[None]
        ensemble = members(self.uncertain, stack)
        if not ensemble.spectral_abscissa()[0] < 0 and self.uncertain.M.n_states:
            return Evaluation(np.inf)
        omega = float(peak_gains(ensemble, self._grid)[1][0])
        # At a negative frequency M is the conjugate of itself at the positive one; so the gain is that of conj(Delta).
        values = delta if omega >= 0 else {name: np.conj(value) for name, value in delta.items()}
        response = self.uncertain.response([abs(omega)], values)[0]
        return Evaluation(float(np.linalg.norm(response, 2)) if response.size else 0.0, omega)


class SpectralAbscissa:
    """Largest real part of the poles in rad/s, or largest modulus minus one for discrete models; negative is stable."""

    location = ""

    def __init__(self, uncertain: UncertainModel) -> None:
        if not uncertain.M.n_states:
            raise InputError("worst_case", "a model without states", "states: a static gain has no poles")
        self.uncertain = uncertain
        self.unit = "" if uncertain.dt else "rad/s"

    def values(self, delta: NDArray[Any]) -> Array:
        """See `Metric.values`."""
        result = np.empty(len(delta))
        for part in chunks(len(delta), self.uncertain.M.A.size):
            result[part] = members(self.uncertain, delta[part]).spectral_abscissa()
        return result

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """See `Metric.evaluate`."""
        d = delta_matrix(self.uncertain.blocks, delta)
        if not np.iscomplexobj(d):
            try:
                return Evaluation(self.uncertain.evaluate(delta).spectral_abscissa())
            except NoTrustworthyNumber:  # ill-posed
                return Evaluation(np.inf)
        m11 = self.uncertain.delta_channels
        a = m11.A + m11.B @ d @ np.linalg.solve(np.eye(d.shape[1]) - m11.D @ d, m11.C)
        poles = np.linalg.eigvals(a)
        return Evaluation(float(np.abs(poles).max() - 1.0 if m11.is_discrete else poles.real.max()))


def _selected(uncertain: UncertainModel, input: str | None, output: str | None) -> UncertainModel:
    for kind, name, known in (("input", input, uncertain.inputs), ("output", output, uncertain.outputs)):
        names = [s.name for s in known]
        if name is not None and name not in names:
            raise InputError(
                f"worst_case: {kind} {name!r}",
                "no such signal",
                f"one of {', '.join(names)}",
                did_you_mean(name, names),
            )
    return uncertain.select([input] if input else None, [output] if output else None)
