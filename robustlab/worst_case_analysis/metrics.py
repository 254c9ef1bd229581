"""Metrics for the worst case: ``of`` many members at once, and ``evaluate`` at one Delta by the public routines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab import checks
from robustlab.arrays import Array
from robustlab.dynamics.simulation import default_clock, simulate
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError, did_you_mean, is_function, unknown_name
from robustlab.linear_analysis.frequency import default_grid
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import delta_matrix
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import (
    Deltas,
    Ensemble,
    Excitation,
    Hold,
    MemberSet,
    blocks_of,
    encoded,
    excitation,
    peak_gains,
    time_responses,
)

UserFunction = Callable[[StateSpaceModel], float]
GRID_POINTS = 48  # frequencies for the gain of every member, in addition to those of its own poles
NO_FINAL_VALUE = 1e-9  # share of a response's size below which a final value is zero


class Evaluation(NamedTuple):
    """A metric at one Delta."""

    value: float  # the metric; infinite where there is no bounded value
    at: float = np.nan  # time in s or frequency in rad/s where it is attained; NaN where there is none
    accurate: bool = True  # False where digits were lost
    reason: str = ""  # why there is no bounded value; else empty


class Metric:
    """A number for each member of a set."""

    uncertain: UncertainModel  # the set, without parts that do not affect the metric
    unit: str = ""  # unit of the value; empty where not stated
    location: str = ""  # quantity of `at`: `"t [s]"`, `"omega [rad/s]"`, or empty
    # 1 where the largest value is the worst, -1 where the smallest is; a member without a bounded value has sense * inf
    sense: float = 1.0
    tolerance: float = 1e-6  # search and re-evaluation must agree to this share of the value
    smooth: bool = True  # False where the value jumps with the parameters
    one_sided: bool = False  # True where re-evaluation may find a worse value (a peak between the search's grid points)

    def of(self, ensemble: Ensemble) -> Array:
        """Return the metric of each member, shape (k,)."""
        raise NotImplementedError

    @cached_property
    def set(self) -> MemberSet:
        """The set, prepared for many members."""
        return MemberSet(self.uncertain)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """Re-evaluate the metric at one Delta by the second method."""
        try:
            model = self.uncertain.evaluate(delta)
        except NoTrustworthyNumber as error:  # ill-posed
            return Evaluation(self.sense * np.inf, reason=error.found)
        return self.of_model(model)

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """Evaluate the metric of one model by the second method."""
        raise NotImplementedError

    def work(self, count: int) -> float:
        """Estimate the work for this number of members at once."""
        n = self.uncertain.M.n_states
        return 300 + count * (20 + n**2 + n**3 / 30)

    def slack(self, value: float) -> float:
        """Return the tolerated difference of a re-evaluation from ``value``."""
        return self.tolerance * abs(value)

    def agrees(self, found: float, again: float) -> bool:
        """Return whether re-evaluation confirms the found value."""
        if not np.isfinite(found) or not np.isfinite(again):
            return bool(found == again)
        slack = max(self.slack(found), self.slack(again))
        beyond = self.sense * (again - found)
        return bool(-slack <= beyond and (self.one_sided or beyond <= slack))


# --- shared checks ---------------------------------------------------------------------------------------------------


def selected(uncertain: UncertainModel, input: str | None, output: str | None) -> UncertainModel:
    """Return the set with the named input and output only (None: all), and the states that connect them."""
    for kind, name, known in (("input", input, uncertain.inputs), ("output", output, uncertain.outputs)):
        names = [s.name for s in known]
        if name is not None and name not in names:
            raise unknown_name(f"worst_case: {kind} {name!r}", "no such signal", name, names)
    chosen = uncertain.select([input] if input else None, [output] if output else None)
    return UncertainModel(drop_unconnected(chosen.M), chosen.blocks)


def need_real(uncertain: UncertainModel, what: str) -> None:
    for block in uncertain.blocks:
        if not block.is_real:
            hint = "a complex Delta has a metric 'hinf' only"
            raise InputError("worst_case", f"block {block.name!r} is complex", f"real blocks for {what}", hint)


def need_stable(nominal: StateSpaceModel, what: str) -> None:
    """Reject a nominal model that is not asymptotically stable; one without states is."""
    if nominal.n_states and not nominal.is_stable():
        poles = nominal.poles()
        worst = poles[np.argmax(np.abs(poles) if nominal.is_discrete else poles.real)]
        found = f"nominal model is not asymptotically stable (pole {worst:.4g}): {what}"
        hint = "choose an output that does not see this pole, or close a loop around the model first"
        raise NoTrustworthyNumber("worst_case", found, None, hint)


# --- metrics of a model ----------------------------------------------------------------------------------------------


class HinfGain(Metric):
    """H-infinity norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    location = "omega [rad/s]"
    one_sided = True

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        self.uncertain = selected(uncertain, input, output)
        nominal = self.uncertain.nominal
        need_stable(nominal, "its H-infinity norm is infinite")
        self._grid = default_grid(nominal, GRID_POINTS)

    def of(self, ensemble: Ensemble) -> Array:
        return peak_gains(ensemble, self._grid)[0]

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        from robustlab.norms import hinf_norm

        norm = hinf_norm(model)
        return Evaluation(norm.value, norm.frequency, norm.status.trustworthy, norm.reason)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """As `Metric.evaluate`; of a complex Delta the gain at the search's frequency, stability from the poles."""
        if not np.iscomplexobj(delta_matrix(self.uncertain.blocks, delta)):
            return super().evaluate(delta)
        values, places = peak_gains(self.set.members(encoded(self.uncertain.blocks, delta)[None]), self._grid)
        if np.isinf(values[0]):
            return Evaluation(np.inf)
        omega = float(places[0])
        # At a negative frequency M is the conjugate of itself at the positive one; so the gain is that of conj(Delta).
        turned = delta if omega >= 0 else {name: np.conj(value) for name, value in delta.items()}
        response = self.uncertain.response([abs(omega)], turned)[0]
        return Evaluation(float(np.linalg.norm(response, 2)) if response.size else 0.0, omega)


class H2Gain(Metric):
    """H2 norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    tolerance = 1e-5

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        need_real(uncertain, "h2")
        self.uncertain = selected(uncertain, input, output)
        need_stable(self.uncertain.nominal, "its H2 norm is infinite")
        if not uncertain.dt and self.uncertain.nominal.D.any():
            hint = "choose input and output without direct feedthrough, or use the metric hinf"
            raise NoTrustworthyNumber("worst_case", "the model has a direct term: its H2 norm is infinite", None, hint)

    def of(self, ensemble: Ensemble) -> Array:
        from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

        value = np.full(len(ensemble), np.inf)
        for k in np.flatnonzero(ensemble.is_stable() & (bool(ensemble.dt) | ~ensemble.D.any(axis=(1, 2)))):
            a, b, c, d = (matrix[k] for matrix in (ensemble.A, ensemble.B, ensemble.C, ensemble.D))
            reach = solve_discrete_lyapunov(a, b @ b.T) if ensemble.dt else solve_continuous_lyapunov(a, -b @ b.T)
            value[k] = math.sqrt(max(float(np.einsum("ij,jl,il->", c, reach, c) + (d**2).sum()), 0.0))
        return value

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        from robustlab.norms import h2_by_gramians

        norm = h2_by_gramians(model)
        return Evaluation(norm.value, accurate=norm.status.trustworthy, reason=norm.reason)


class PoleMetric(Metric):
    """Largest real part of the poles (discrete: modulus minus one), or smallest damping ratio -Re(s)/|s|."""

    def __init__(self, uncertain: UncertainModel, damping: bool) -> None:
        if not uncertain.M.n_states:
            raise InputError("worst_case", "a model without states", "states: a static gain has no poles")
        need_real(uncertain, "its poles")
        self.uncertain, self._damping = uncertain, damping
        self.sense = -1.0 if damping else 1.0
        self.unit = "" if damping or uncertain.dt else "rad/s"

    def _worst(self, of: NDArray[Any]) -> Array:
        """Return the worst over the poles (..., n_x)."""
        poles: Any = of.astype(complex)
        if not self._damping:
            return (np.abs(poles) - 1.0 if self.uncertain.dt else poles.real).max(axis=-1)
        if self.uncertain.dt:
            poles = np.log(np.where(np.abs(poles) > 1e-300, poles, 1e-300))
        size = np.abs(poles)
        return np.where(size > 0, -poles.real / np.where(size > 0, size, 1.0), 0.0).min(axis=-1)

    def of(self, ensemble: Ensemble) -> Array:
        return np.where(ensemble.ill_posed, self.sense * np.inf, self._worst(np.linalg.eigvals(ensemble.A)))

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        return Evaluation(float(self._worst(model.poles())))

    def slack(self, value: float) -> float:
        """Return the tolerance relative to the largest pole, or to 1 for damping ratios."""
        largest = float(np.abs(self.uncertain.nominal.poles()).max())
        return self.tolerance * (1.0 if self._damping else max(abs(value), largest))


class UserMetric(Metric):
    """A user's function of a model; the larger the worse, ``inf`` for a member without a bounded value."""

    smooth = False

    def __init__(self, uncertain: UncertainModel, function: UserFunction) -> None:
        need_real(uncertain, f"the function {name_of(function)}")
        self.uncertain, self._function = uncertain, function

    def of(self, ensemble: Ensemble) -> Array:
        value = np.full(len(ensemble), np.inf)
        nominal = self.uncertain.nominal
        for k in np.flatnonzero(~ensemble.ill_posed):
            a, b, c, d = (matrix[k] for matrix in (ensemble.A, ensemble.B, ensemble.C, ensemble.D))
            model = StateSpaceModel(a, b, c, d, ensemble.dt, nominal.inputs, nominal.outputs, nominal.states)
            value[k] = self.of_model(model).value
        return value

    def work(self, count: int) -> float:
        return 3000.0 * count  # a few milliseconds per call

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        found, where = self._function(model), f"metric {name_of(self._function)}"
        try:
            value = float(found)
        except (TypeError, ValueError):
            raise InputError(where, f"gave a {type(found).__name__}", "a number") from None
        if math.isnan(value):
            raise NoTrustworthyNumber(where, "gave NaN", "a number, or inf where there is none")
        return Evaluation(value)


# --- metrics of a response -------------------------------------------------------------------------------------------


class Measure(NamedTuple):
    """Measure of responses: times, responses (k, n_t), final values (k,), band -> values (k,), their samples."""

    of: Callable[[Array, Array, Array, float], tuple[Array, NDArray[np.intp] | None]]
    unit: str = ""  # empty: that of the output
    deviation: bool = False  # from the nominal response
    settled: bool = False  # relative to the final value of a step
    smooth: bool = True
    # Tolerance of re-evaluation: size added to the value, and whether a time step is added.
    size: float = 0.0
    steps: bool = False


def _largest(size: Array) -> tuple[Array, NDArray[np.intp]]:
    at = size.argmax(axis=1)
    return size[np.arange(len(size)), at], at


def _overshoot(t: Array, y: Array, final: Array, band: float) -> tuple[Array, NDArray[np.intp]]:
    share, at = _largest(y / final[:, None])
    return np.where(np.isfinite(final), 100.0 * np.maximum(share - 1.0, 0.0), np.inf), at


def settling_times(t: Array, y: Array, final: Array, band: float) -> Array:
    """Return the times (k,) from which responses y stay within ``band`` of their final values; infinite where never."""
    gap, edge = y - final[:, None], band * np.abs(final)
    outside: NDArray[Any] = ~(np.abs(gap) <= edge[:, None])
    last = len(t) - 1 - outside[:, ::-1].argmax(axis=1)
    rows, following = np.arange(len(y)), np.minimum(last + 1, len(t) - 1)
    here, there = gap[rows, last], gap[rows, following]
    share = (np.abs(here) - edge) / (np.abs(here) - np.sign(here) * there)
    crossing = t[last] + share * (t[following] - t[last])
    settled = np.where(outside.any(axis=1), crossing, 0.0)
    return np.where(outside[:, -1] | ~np.isfinite(final), np.inf, settled)


MEASURES = {
    "peak-deviation": Measure(lambda t, y, *_: _largest(np.abs(y)), deviation=True),
    "peak": Measure(lambda t, y, *_: _largest(np.abs(y))),
    "rms": Measure(lambda t, y, *_: (np.sqrt(np.trapezoid(y**2, t, axis=1) / np.ptp(t)), None)),
    "overshoot": Measure(_overshoot, "%", settled=True, size=100.0),
    "settling-time": Measure(
        lambda *given: (settling_times(*given), None), "s", settled=True, smooth=False, steps=True
    ),
}


class TimeMetric(Metric):
    """A measure of the response of one output from zero initial state; infinite where that grows without bound."""

    def __init__(
        self, uncertain: UncertainModel, name: str, output: str, drive: Excitation, hold: Hold, band: float
    ) -> None:
        need_real(uncertain, name)
        self.uncertain = selected(uncertain, None, output)
        self._measure, self.drive, self._band = MEASURES[name], drive, band
        self._hold: Hold = hold
        self.unit = self._measure.unit or self.uncertain.outputs[0].unit
        self.location = "" if name in ("rms", "settling-time") else "t [s]"
        self.smooth = self._measure.smooth
        centre = self.set.members(np.zeros((1, self.set.size)))
        self._nominal = self._responses(centre)[0]
        if not self._measure.settled:
            return
        checks.number("worst_case: band", band, "a share of the final value between 0 and 1", above=0, below=1)
        if np.ptp(self.drive.u, axis=0).max(initial=0.0) > 0:
            raise InputError("worst_case", "an input that changes", f"constant inputs: {name} is that of a step")
        need_stable(self.uncertain.nominal, f"it has no {name}")
        final = float(self._finals(centre)[0])
        if abs(final) <= NO_FINAL_VALUE * float(np.abs(self._nominal).max(initial=0.0)):
            found, expected = (
                f"the nominal response settles at {final:.3g}",
                f"another final value: {name} is relative to it",
            )
            raise NoTrustworthyNumber("worst_case", found, expected, "use the metric peak")

    def _responses(self, ensemble: Ensemble) -> Array:
        return time_responses(ensemble, self.drive, np.zeros(ensemble.A.shape[1]), self._hold)[:, :, 0]

    def _finals(self, ensemble: Ensemble) -> Array:
        """Return the final values of all members (k,) if the measure needs them; infinite for unstable members."""
        final, u = np.full(len(ensemble), np.inf), self.drive.u[0]
        if self._measure.settled:
            stable = np.flatnonzero(ensemble.is_stable())
            some = ensemble.part(stable)
            shift = np.eye(some.A.shape[1]) if ensemble.dt else 0.0
            x = np.linalg.solve(shift - some.A, (some.B @ u)[:, :, None])
            final[stable] = (some.C @ x)[:, 0, 0] + some.D[:, 0] @ u
        return final

    def of(self, ensemble: Ensemble) -> Array:
        with np.errstate(all="ignore"):
            y = self._responses(ensemble)
            y = y - self._nominal if self._measure.deviation else y
            value, _ = self._measure.of(self.drive.t, y, self._finals(ensemble), self._band)
        return np.where(ensemble.ill_posed | np.isnan(value), np.inf, value)

    def response(self, model: StateSpaceModel) -> Array:
        """Return the output of a model, (n_t,), by the second method; NoTrustworthyNumber where it overflows."""
        return np.asarray(simulate(model, self.drive.t, self.drive.u, hold=self._hold)[model.output_names[0]])

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        t, final = self.drive.t, np.full(1, np.inf)
        try:
            y = self.response(model) - (self.response(self.uncertain.nominal) if self._measure.deviation else 0.0)
        except NoTrustworthyNumber:
            return Evaluation(np.inf, reason="the response outgrows double precision")
        if self._measure.settled:
            if model.n_states and not model.is_stable():
                return Evaluation(np.inf, reason="this member is unstable and never settles")
            final[0] = model.dc_gain()[0] @ self.drive.u[0]
        with np.errstate(all="ignore"):
            values, at = self._measure.of(t, y[None], final, self._band)
        reason = "" if np.isfinite(values[0]) else f"this member has not settled by t = {t[-1]:.6g} s, the last time"
        return Evaluation(float(values[0]), np.nan if at is None else float(t[at[0]]), reason=reason)

    def slack(self, value: float) -> float:
        """Return the tolerance, including that of the final value and of a time step."""
        return self.tolerance * (abs(value) + self._measure.size + self.drive.h * self._measure.steps)

    def work(self, count: int) -> float:
        """Estimate the work; members computed together share most of the steps."""
        n, steps = self.uncertain.M.n_states, len(self.drive.t)
        return 300 + steps * (0.1 + n**2 / 160) + count * (20 + n**3 / 50 + steps * (0.05 + n**2 / 6000))


# --- metrics by name, and at samples ---------------------------------------------------------------------------------


METRICS = (*MEASURES, "hinf", "h2", "spectral-abscissa", "damping")


def name_of(metric: str | UserFunction) -> str:
    """Return the name of a metric; that of the function for a user's own."""
    return metric if isinstance(metric, str) else getattr(metric, "__name__", "function")


def make_metric(
    uncertain: UncertainModel,
    metric: str | UserFunction = "peak-deviation",
    output: str | None = None,
    input: str | None = None,
    t: ArrayLike | None = None,
    u: Mapping[str, ArrayLike] | ArrayLike | None = None,
    hold: Hold = "zoh",
    band: float = 0.02,
    where: str = "worst_case",
) -> Metric:
    """Build a metric of a set; see `robustlab.worst_case_analysis.worst_case` for the arguments and errors."""
    if not isinstance(uncertain, UncertainModel):
        raise InputError(where, type(uncertain).__name__, "an UncertainModel")
    if not isinstance(metric, str):
        if not is_function(metric):
            raise UsageError(where, f"metric {metric!r}", "the name of a metric, or a function of a model")
        return UserMetric(uncertain, metric)
    if metric not in METRICS:
        raise UsageError(where, f"metric {metric!r}", f"one of {', '.join(METRICS)}", did_you_mean(metric, METRICS))
    if metric in ("spectral-abscissa", "damping"):
        return PoleMetric(uncertain, metric == "damping")
    if metric not in MEASURES:
        return (HinfGain if metric == "hinf" else H2Gain)(uncertain, input, output)
    names = [s.name for s in uncertain.outputs]
    if output is None and len(names) != 1:
        expected, hint = f"output: one of {', '.join(names)}", f"name one: output={names[0]!r}"
        raise UsageError(where, f"{len(names)} outputs and none named", expected, hint)
    driven: Any = {input: 1.0} if u is None and input is not None else u
    clock = default_clock(uncertain.nominal, where) if t is None else t
    drive = excitation(uncertain.inputs, uncertain.dt, clock, driven, where)
    return TimeMetric(uncertain, metric, output or names[0], drive, hold, band)


def values_at(metric: Metric, deltas: Deltas) -> Array:
    """Return the metric at all samples (k,); a sample's value does not depend on their number."""
    parts = blocks_of(len(deltas), metric.set.block)
    return np.concatenate([metric.of(metric.set.members(deltas.numbers(part))) for part in parts])
