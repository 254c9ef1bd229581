"""Search for the worst member; the value is attained, not a proved bound (`robustlab.mu_analysis` has those)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import MILLION, Budget, one_thread, search_budget
from robustlab.display import AllFields, Displayable, Facts, Part, member, member_rows, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.result import Evidence, Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import delta_values
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import MemberSet, chunks, vertex_signs
from robustlab.worst_case_analysis.metrics import Metric, TimeMetric, make_metric, name_of

LABEL = "sampled: a lower bound of the true worst case"
LABEL_SMALLEST = "sampled: an upper bound of the true worst case, which is the smallest value"
UNBOUNDED = "attained: this member has no bounded value"
WORK = 60 * MILLION  # the usual work at effort 1, in units of about a microsecond
CLIMBING = 0.5  # share of it for the ascents, in equal parts
VERTICES = 1024  # at most, in addition to the points of a Latin hypercube
CLIMBS, CLIMB_STEPS = 8, 40  # ascents along gradients; more: more local maxima found. Steps of each
STARTS = 4  # compass searches where there are no gradients
SMALLEST_STEP = 1e-7  # of a compass search
APART = 0.2  # smallest distance of starting points, in the maximum norm
STEP = 1e-6  # of the difference quotients, in the box [-1, 1]
ROUNDING = 1e-11  # largest relative change of a score by rounding


@dataclass(frozen=True)
class WorstResponse(Evidence):
    """The response of one output, nominal and of the worst member."""

    t: Array  # times in s, (n_t,)
    nominal: Array  # the output, (n_t,)
    worst: Array
    output: str  # its name and unit
    unit: str


@dataclass(frozen=True)
class WorstCase(Displayable, AllFields):
    """The worst member that a search found."""

    quantities: ClassVar[Mapping[str, Any]] = {
        "value": float, "nominal_value": float, "evaluations": "1", "delta": {"*": ...}, "percent": "%",
    }  # fmt: skip

    value: float  # the metric at `delta`, by another method than the search's; infinite where it is unbounded
    delta: Mapping[str, Any]  # block -> value
    metric: str
    nominal_value: float  # the metric at Delta = 0, by the same method as `value`
    # INACCURATE: search and re-evaluation disagree or digits were lost. INCONCLUSIVE: the work budget ended the search.
    status: Status
    label: str  # meaning of the value, and the reason for an early end of the search
    evaluations: int  # members that were evaluated
    physical: Mapping[str, tuple[float, str]]  # block -> (value, unit), for blocks of a physical parameter
    at: float  # time in s or frequency in rad/s at which the value is attained; NaN where there is none
    location: str  # quantity of `at`
    search_value: float  # value of the search at `delta`
    unit: str
    input: str | None  # signals that the metric was restricted to; None for all
    output: str | None
    spectral_abscissa: float  # of the member at `delta`, all states
    seed: int
    response: WorstResponse | None = None  # of the metric's output; None for other metrics, and where it overflows

    @property
    def percent(self) -> float | None:
        """Largest change of the response in percent of the largest nominal value; None without one, or if it is 0."""
        if (found := self.response) is None or not found.nominal.any():
            return None
        return 100 * float(np.abs(found.worst - found.nominal).max() / np.abs(found.nominal).max())

    def headline(self) -> str:
        return f"worst {self.metric} found: {number(self.value, self.unit)}"

    def details(self) -> list[Part]:
        return [member_rows(self.delta, self.physical)]

    def facts(self) -> Facts:
        name, _, unit = self.location.partition(" [")
        return [
            (self.metric, number(self.value, self.unit, 6)),
            ("nominal", number(self.nominal_value, self.unit, 6)),
            ("largest change of the response", number(self.percent, "%")),
            ("worst member", member(self.delta, self.physical)),
            ("at", f"{name} = {number(self.at, unit.rstrip(']'))}" if name and number(self.at) else ""),
            ("meaning", self.label),
            ("evaluated", f"{self.evaluations} members, seed {self.seed}"),
            ("input, output", ", ".join(name for name in (self.input, self.output) if name)),
        ]


@error_context("worst_case")
def worst_case(
    uncertain: UncertainModel,
    metric: str | Callable[[StateSpaceModel], float] = "peak-deviation",
    *,
    output: str | None = None,
    input: str | None = None,
    t: ArrayLike | None = None,
    u: Mapping[str, ArrayLike] | ArrayLike | None = None,
    hold: Literal["zoh", "foh"] = "zoh",
    band: float = 0.02,
    n: int = 256,
    seed: int = 0,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> WorstCase:
    """The worst member of a set that a search over all normalised Delta finds.

    Parameters
    ----------
    uncertain
        The set.
    metric
        A name in ``METRICS``, or a function of a model that gives a number, the larger the worse:

        ============================  ==============================================================================
        peak-deviation, peak, rms     of one output over the given times; rms and peak of a control signal that the
                                      closed loop has as an output are its effort
        overshoot, settling-time      of the step response of one output, in % and s; infinite where unstable
        hinf, h2                      norms; infinite where unstable
        spectral-abscissa, damping    of the poles; the smallest damping is the worst
        ============================  ==============================================================================
    output, input
        Signals of the metric. A response needs an output if there are several; norms are of all signals by default.
    t, u, hold
        As in `Samples.respond`; by default eight time constants of the nominal model, and a unit step on ``input``.
    band
        Share of the final value that counts as settled.
    n
        Points of a Latin hypercube, in addition to the centre and up to 1024 vertices.
    seed
        Of the random numbers.
    time_limit
        In s. If it is reached, the status is TIMEOUT and the result depends on the machine.
    effort
        Work of the search as a multiple of the usual (about a minute); counted, not timed.

    Returns
    -------
    WorstCase
        The largest value found (for ``damping`` the smallest), re-evaluated, with the Delta that attains it.

    Raises
    ------
    UsageError
        Unknown metric, or several outputs and none named.
    InputError
        Unknown signals, complex blocks in time, an unstable nominal model without times.
    NoTrustworthyNumber
        The nominal model has no finite gain, or does not settle.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> found = worst_case(UncertainModel(M, [RealScalar("pole")]), "settling-time", t=np.linspace(0, 9, 901))
    >>> found.delta, round(found.value, 3)  # log(50) / 0.8
    ({'pole': -1.0}, 4.89)
    """
    budget = search_budget("worst_case", WORK, effort, time_limit)
    n, seed = checks.whole("n", n, 1), checks.whole("seed", seed)
    with one_thread():
        judge = make_metric(uncertain, metric, output, input, t, u, hold, band)
        search = _Search(judge, budget)
        theta, score = search.run(n, seed)
        delta = delta_values(uncertain.blocks, judge.set.deltas(theta[None])[0])
        again, nominal = judge.evaluate(delta), judge.evaluate({})
        abscissa = float(MemberSet(uncertain).members(theta[None]).spectral_abscissa()[0])
        response = _response(judge, delta)
    found, label = judge.sense * score, LABEL_SMALLEST if judge.sense < 0 else LABEL
    status = Status.CONVERGED if again.accurate and judge.agrees(found, again.value) else Status.INACCURATE
    if not np.isfinite(again.value):
        label = f"{UNBOUNDED}: {again.reason}" if again.reason else UNBOUNDED
    remark = []
    if search.ended:
        status = Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE
        remark = [budget.remark] if budget.remark else []
    return WorstCase(
        value=again.value,
        delta=delta,
        metric=name_of(metric),
        nominal_value=nominal.value,
        status=status,
        label="; ".join([label, *remark, *uncertain.remarks]),
        evaluations=search.evaluations,
        physical=uncertain.physical(delta),
        at=again.at,
        location=judge.location,
        search_value=found,
        unit=judge.unit,
        input=input,
        output=output,
        spectral_abscissa=abscissa,
        seed=seed,
        response=response,
    )


def _response(metric: Metric, delta: Mapping[str, Any]) -> WorstResponse | None:
    if not isinstance(metric, TimeMetric):
        return None
    try:
        nominal, worst = (metric.response(metric.uncertain.evaluate(values)) for values in ({}, delta))
    except NoTrustworthyNumber:
        return None
    return WorstResponse(metric.drive.t, nominal, worst, *metric.uncertain.outputs[0])


# --- the search ------------------------------------------------------------------------------------------------------


class _Ended(Exception):
    """The work of an ascent is used up, or a member without a bounded value was found."""


class _Search:
    """A search from the centre, vertices and a Latin hypercube; scores are ``sense * value``: the larger the worse."""

    def __init__(self, metric: Metric, budget: Budget) -> None:
        self.metric, self.budget, self.evaluations = metric, budget, 0
        self.ended = False  # early, by the budget
        self.best, self.top = np.zeros(metric.set.size), -np.inf

    def run(self, n: int, seed: int) -> tuple[Array, float]:
        d, blocks = self.metric.set.size, self.metric.set.blocks
        points = np.zeros((1, d))
        if d:
            real = [part.start for part, b in zip(self.metric.set.parts, blocks, strict=True) if b.interval]
            signs = vertex_signs(len(real), VERTICES, seed) if real else np.zeros((0, 0))
            vertices = np.zeros((len(signs), d))
            vertices[:, real] = signs
            points = np.vstack([points, vertices, 2.0 * _latin_hypercube(n, d, seed) - 1.0])
        scores = self._scores(points)
        order = np.argsort(-scores, kind="stable")
        self._keep(points[order[0]], float(scores[order[0]]))
        if not d or np.isposinf(self.top) or self.ended:
            return self.best, self.top
        if self.metric.set.all_real and self.metric.smooth:
            starts = list[Array]()
            for point in points[order]:
                if len(starts) < CLIMBS and all(np.abs(point - other).max() >= APART for other in starts):
                    starts.append(point)
            share = CLIMBING * self.budget.left / len(starts)
            for start in starts:
                self._climb(start, share)
            self._compass(self.best, self.top, 0.25)
        else:
            for index in order[:STARTS]:
                self._compass(points[index], float(scores[index]), 2.0)
        return self.best, self.top

    def _keep(self, theta: Array, score: float) -> None:
        if score > self.top:
            self.best, self.top = theta.copy(), score

    def _scores(self, theta: Array) -> Array:
        """Return the scores at vectors (k, d); -inf beyond the budget."""
        scores, m = np.full(len(theta), -np.inf), self.metric.uncertain.M
        for part in chunks(len(theta), 64 * (m.A.size + m.D.size + 1)):
            if self.evaluations and self.budget.over:
                self.ended = True
                break
            scores[part] = self._measure(theta[part])
        return scores

    def _measure(self, theta: Array) -> Array:
        """Return the scores at vectors (k, d) and count their work."""
        self.budget.spend(self.metric.work(len(theta)))
        self.evaluations += len(theta)
        return self.metric.sense * self.metric.of(self.metric.set.members(theta))

    def _climb(self, start: Array, work: float) -> None:
        """Ascend by L-BFGS-B; the best point is kept. It ends early where this much work is done."""
        from scipy.optimize import minimize

        last, sizes = self.budget.left - work, list[float]()

        def falling(theta: Array) -> tuple[float, Array]:
            """Difference quotients are on the same side of 0 (at 0 upwards), within the box."""
            if self.budget.over or self.budget.left <= last:
                self.ended = True
                if not self.budget.struck:
                    self.budget.use_up()
            if self.ended or np.isposinf(self.top):  # also one that another ascent found
                raise _Ended
            step = np.where(theta < 0.0, -STEP, STEP)
            step = np.where(np.abs(theta + step) > 1.0, -step, step)
            points = np.vstack([theta, theta + np.diag(step)])
            scores = self._measure(points)
            worst = int(scores.argmax()) if np.isposinf(scores).any() else 0
            self._keep(points[worst], float(scores[worst]))
            if np.isposinf(scores[worst]):
                raise _Ended
            score, change = float(scores[0]), scores[1:] - scores[0]
            sizes.append(max(abs(score), 1e-300))
            slope = np.where(np.abs(change) > ROUNDING * abs(score), change, 0.0) / step
            return -score / sizes[0], -slope / sizes[0]

        bounds = [(-1.0, 1.0)] * len(start)
        with suppress(_Ended):
            minimize(falling, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": CLIMB_STEPS})

    def _compass(self, theta: Array, score: float, step: float) -> None:
        """Search along every coordinate, the projected slope, and all gains together, in smaller and smaller steps."""
        d = len(theta)
        while step > SMALLEST_STEP and not self.ended and not np.isposinf(score):
            ahead, behind = (np.clip(theta + sign * step * np.eye(d), -1.0, 1.0) for sign in (1, -1))
            up, down = np.split(self._scores(np.vstack([ahead, behind])), 2)
            width = np.diag(ahead) - np.diag(behind)
            finite = np.isfinite(up) & np.isfinite(down)
            slope = np.subtract(up, down, where=finite, out=np.zeros(d)) / np.where(width > 0, width, 1.0)
            slope /= max(float(np.abs(slope).max()), np.finfo(float).tiny)
            along = np.clip(theta + step * np.exp2([[-2.0], [-1.0], [0.0], [1.0], [2.0]]) * slope, -1.0, 1.0)
            gain = np.where((up > score) & (up >= down), np.diag(ahead), np.where(down > score, np.diag(behind), theta))
            more = np.vstack([along, gain])
            trials, scores = np.vstack([ahead, behind, more]), np.concatenate([up, down, self._scores(more)])
            best = int(scores.argmax())
            if scores[best] > score + 1e-12 * abs(score):
                theta, score = trials[best], float(scores[best])
            else:
                step /= 4.0
        self._keep(theta, score)


def _latin_hypercube(n: int, d: int, seed: int) -> Array:
    """Return n points in [0, 1)^d, one in each of the n intervals of every coordinate."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 3)))
    return (rng.permuted(np.tile(np.arange(n), (d, 1)), axis=1).T + rng.random((n, d))) / n
