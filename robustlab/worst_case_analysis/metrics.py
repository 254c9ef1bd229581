"""The catalogue of metrics: what each name means, how it is made for a set, and its values at seeded samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.simulation import default_clock
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError, did_you_mean, is_function
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.draws import BLOCK, Deltas, RealSet, is_count
from robustlab.worst_case_analysis.ensemble import Ensemble, Hold, blocks_of, delta_stack, excitation
from robustlab.worst_case_analysis.metric_contract import Evaluation, Metric, need_real
from robustlab.worst_case_analysis.model_metrics import (
    Damping,
    H2Gain,
    HinfGain,
    SpectralAbscissa,
)
from robustlab.worst_case_analysis.time_metrics import Overshoot, Peak, PeakDeviation, Rms, SettlingTime, TimeMetric

MOST_SAMPLES = 10_000_000
UserFunction = Callable[[StateSpaceModel], float]

# Name -> what it is. The largest value is the worst but where the text says otherwise.
METRICS: dict[str, str] = {
    "peak-deviation": "largest |y - nominal y| of an output over the given times",
    "peak": "largest |y| of an output over the given times; of a control signal its effort",
    "rms": "root mean square of an output over the given times; of a control signal its effort",
    "overshoot": "how far a step response goes beyond its final value, in % of it",
    "settling-time": "when a step response stays within 2 % (band) of its final value",
    "hinf": "H-infinity norm; infinite for unstable members",
    "h2": "H2 norm; infinite for unstable members",
    "spectral-abscissa": "largest real part of the poles",
    "damping": "smallest damping ratio of the poles; the smallest is the worst",
}
OF_A_RESPONSE: dict[str, type[TimeMetric]] = {
    kind.name: kind for kind in (PeakDeviation, Peak, Rms, Overshoot, SettlingTime)
}


@dataclass(frozen=True)
class MetricRequest:
    """A metric as asked for; see `robustlab.worst_case_analysis.worst_case` for the fields."""

    metric: str | UserFunction = "peak-deviation"
    output: str | None = None
    input: str | None = None
    t: ArrayLike | None = None
    u: Mapping[str, ArrayLike] | ArrayLike | None = None
    hold: Hold = "zoh"
    band: float = 0.02

    @property
    def name(self) -> str:
        """Name of the metric; that of the function for a user's own."""
        return self.metric if isinstance(self.metric, str) else getattr(self.metric, "__name__", "function")


class UserMetric(Metric):
    """A user's function of a model; the larger the worse, ``inf`` for a member without a bounded value."""

    smooth = False

    def __init__(self, uncertain: UncertainModel, function: UserFunction, name: str) -> None:
        need_real(uncertain, f"the function {name}")
        self.uncertain, self._function, self._name = uncertain, function, name

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        value = np.full(len(ensemble), np.inf)
        nominal = self.uncertain.nominal
        for k in np.flatnonzero(~ensemble.ill_posed):
            a, b, c, d = (matrix[k] for matrix in (ensemble.A, ensemble.B, ensemble.C, ensemble.D))
            model = StateSpaceModel(a, b, c, d, ensemble.dt, nominal.inputs, nominal.outputs, nominal.states)
            value[k] = self._number(model)
        return value

    def work(self, count: int) -> float:
        """See `Metric.work`; what the function does is not known: taken for a few milliseconds."""
        return 3000.0 * count

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`: the function once more, at the model of `UncertainModel.evaluate`."""
        return Evaluation(self._number(model))

    def _number(self, model: StateSpaceModel) -> float:
        found = self._function(model)
        try:
            value = float(found)
        except (TypeError, ValueError):
            raise InputError(f"metric {self._name}", f"gave a {type(found).__name__}", "a number") from None
        if math.isnan(value):
            raise NoTrustworthyNumber(f"metric {self._name}", "gave NaN", "a number, or inf where there is none")
        return value


def make_metric(uncertain: UncertainModel, request: MetricRequest, where: str = "worst_case") -> Metric:
    """The metric that a request names, made for a set.

    Raises UsageError: unknown metric, or several outputs and none named; InputError, NoTrustworthyNumber: signals,
    times or models that the metric cannot work with.
    """
    if not isinstance(uncertain, UncertainModel):
        raise InputError(where, type(uncertain).__name__, "an UncertainModel")
    metric = request.metric
    if not isinstance(metric, str):
        if not is_function(metric):
            raise UsageError(where, f"metric {metric!r}", "the name of a metric, or a function of a model")
        return UserMetric(uncertain, metric, request.name)
    if metric not in METRICS:
        raise UsageError(where, f"metric {metric!r}", f"one of {', '.join(METRICS)}", did_you_mean(metric, [*METRICS]))
    if metric in OF_A_RESPONSE:
        return _of_a_response(uncertain, request, where)
    if metric == "spectral-abscissa":
        return SpectralAbscissa(uncertain)
    if metric == "damping":
        return Damping(uncertain)
    return (HinfGain if metric == "hinf" else H2Gain)(uncertain, request.input, request.output)


def _of_a_response(uncertain: UncertainModel, request: MetricRequest, where: str) -> Metric:
    names = [s.name for s in uncertain.outputs]
    output = request.output
    if output is None and len(names) != 1:
        expected, hint = f"output: one of {', '.join(names)}", f"name one: output={names[0]!r}"
        raise UsageError(where, f"{len(names)} outputs and none named", expected, hint)
    u: Any = {request.input: 1.0} if request.u is None and request.input is not None else request.u
    clock = default_clock(uncertain.nominal, where) if request.t is None else request.t
    drive = excitation(uncertain.inputs, uncertain.dt, clock, u, where)
    kind = OF_A_RESPONSE[str(request.metric)]
    if kind is SettlingTime:
        return SettlingTime(uncertain, output or names[0], drive, request.hold, request.band)
    return kind(uncertain, output or names[0], drive, request.hold)


@dataclass(frozen=True)
class MetricBatch:
    """Values of a metric at samples ``first .. first + count - 1``; can be pickled and sent to another process.

    Sample i is that of ``sample(uncertain, n, seed)``, and its value is the same to the last bit in whatever batch it
    is computed.

    Attributes
    ----------
    uncertain
        The set.
    request
        The metric and its signals and times.
    seed
        Seed of the samples.

    Examples
    --------
    >>> from robustlab import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> batch = MetricBatch(UncertainModel(M, [RealScalar("pole")]), MetricRequest("spectral-abscissa"), 1)
    >>> bool((batch(0, 7)[5:] == batch(5, 2)).all())
    True
    """

    uncertain: UncertainModel
    request: MetricRequest
    seed: int

    def __post_init__(self) -> None:
        if not is_count(self.seed, 0):
            raise InputError("seed", f"{self.seed!r}", "a whole number, not negative")

    def __getstate__(self) -> dict[str, Any]:
        # What was prepared is made again where it is needed: a request and a model travel, nothing else.
        return {"uncertain": self.uncertain, "request": self.request, "seed": self.seed}

    @cached_property
    def judge(self) -> Metric:
        """The metric."""
        return make_metric(self.uncertain, self.request)

    @property
    def all_real(self) -> bool:
        """Whether every block is a real scalar."""
        return self._deltas(1).all_real

    @cached_property
    def real_set(self) -> RealSet:
        """The set, prepared for many members; for real scalars only."""
        return RealSet(self.judge.uncertain)

    def _deltas(self, n: int) -> Deltas:
        return Deltas(self.uncertain.blocks, n, self.seed, np.zeros((0, 0)))

    def __call__(self, first: int, count: int) -> Array:
        """Values of ``count`` samples, shape (count,)."""
        deltas = self._deltas(first + count)
        if not self.all_real:
            return self.judge.values(delta_stack(self.uncertain.blocks, deltas[first : first + count]))
        # Products are rounded the same for the same place in a block only: begin where a block begins.
        start = first - first % BLOCK
        values = np.empty(first + count - start)
        for part in blocks_of(len(values), self.real_set.block):
            theta = deltas.numbers(slice(start + part.start, start + part.stop))
            values[part] = self.judge.of(self.real_set.members(theta))
        return values[first - start :]

    def theta(self, n: int) -> Array:
        """Normalised deltas of the first n samples (n, d), for sets of real scalars."""
        return self._deltas(n).numbers(slice(0, n))

    def delta(self, index: int) -> dict[str, Any]:
        """Delta of one sample."""
        return dict(self._deltas(index + 1)[index])

    def all_values(self, n: int, workers: int = 1) -> Array:
        """Values of the first n samples (n,), by so many threads."""
        if not is_count(n, 1) or n > MOST_SAMPLES:
            raise InputError("n", f"{n!r}", f"a whole number of samples from 1 to {MOST_SAMPLES}")
        if not is_count(workers, 1):
            raise InputError("workers", f"{workers!r}", "a whole number, at least 1")
        if self.all_real:
            self.real_set  # noqa: B018  made before threads ask for it
        parts = blocks_of(int(n), BLOCK)
        with ThreadPoolExecutor(workers) as pool:
            return np.concatenate(list(pool.map(lambda part: self(part.start, part.stop - part.start), parts)))
