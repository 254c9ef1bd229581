r"""Statistics of samples: Clopper-Pearson bounds of a probability, required number of samples, quantiles.

They hold for independent parameters uniform in their ranges, and do not bound the worst case (Clopper, Pearson
1934; Tempo, Bai, Dabbene 1997; David, Nagaraja, *Order Statistics*, 2003, 7.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.display import Displayable, Facts, Part, listed, member, number
from robustlab.errors import InputError, error_context
from robustlab.result import Status, Table, Tabular
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.units import amount
from robustlab.worst_case_analysis.batched_members import Deltas
from robustlab.worst_case_analysis.metrics import Metric, make_metric, name_of, values_at

SMALLEST_SHARE = 1e-14  # needs some 10^15 samples
MOST_SAMPLES = 10_000_000
SHOWN = 12  # parameters in a report's table
MOST_BINS = 32  # along each parameter, for the share of the variance that it explains


@dataclass(frozen=True)
class Influence(Tabular, Displayable):
    """Influence of each real parameter on a metric, from samples."""

    names: tuple[str, ...]  # the parameters (blocks)
    first_order: Array  # share of the variance that each explains by itself, (d,); at least 0
    noise: float  # 95 % quantile of ``first_order`` for a parameter without influence
    # 1 where the metric grows with a parameter, -1 where it falls, 0 where its rank correlation is not significant
    directions: NDArray[np.int_]
    worst_value: float  # the metric at the worst sample
    # the metric with that sample's delta k at nominal and all others kept, (d,): the effect of knowing parameter k
    restored: Array
    nominal_value: float  # the metric at Delta = 0
    unit: str
    n: int  # number of samples

    @property
    def savings(self) -> Array:
        """Change of the worst value if one parameter alone is nominal, (d,); 0 where unbounded."""
        with np.errstate(invalid="ignore"):
            return np.nan_to_num(np.abs(self.worst_value - self.restored), nan=0.0, posinf=0.0)

    @property
    def order(self) -> tuple[int, ...]:
        """Parameters ranked by influence: by ``first_order`` above the noise, then by ``savings``."""
        shares = np.where(self.first_order > self.noise, self.first_order, 0.0)
        return tuple(int(k) for k in np.lexsort((-self.savings, -shares)))

    @property
    def matters(self) -> NDArray[np.bool_]:
        """Which parameters are relevant by either measure, (d,)."""
        return (self.first_order > self.noise) | (self.savings > 1e-3 * self.savings.max(initial=0.0))

    def rows(self) -> list[tuple[str, ...]]:
        """Return the relevant parameters: name, share of the spread, direction, the worst sample with it nominal."""
        ways = {1: "grows with it", -1: "falls with it", 0: "-"}
        shares = [f"{100 * share:.1f} %" if share > self.noise else "-" for share in self.first_order]
        relevant = [k for k in self.order[:SHOWN] if self.matters[k]]
        return [(self.names[k], shares[k], ways[int(self.directions[k])], f"{self.restored[k]:.6g}") for k in relevant]

    def table(self) -> Table:
        """A row for each parameter: share of the spread, and the metric without its change."""
        columns = {"first_order": self.first_order, "restored": self.restored}
        return Table(("parameter", self.names), columns, {"restored": self.unit})

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "order": [self.names[k] for k in self.order]}


def influence_of(judge: Metric, theta: Array, values: Array, worst: int) -> Influence:
    """Return the influence of real scalars on a metric from samples ``theta`` (n, d) and their ``values`` (n,)."""
    from scipy.special import fdtri
    from scipy.stats import rankdata

    n, d = theta.shape
    ranks = rankdata(values)
    numbers = values if np.isfinite(values).all() else ranks
    bins = int(np.clip(np.sqrt(n), 4, MOST_BINS))
    ratio = float(fdtri(bins - 1, n - bins, 0.95))
    found = judge.of(judge.set.members(np.vstack([np.where(np.eye(d), 0.0, theta[worst]), np.zeros((1, d))])))
    x, y = rankdata(theta, axis=0) - (n + 1) / 2, ranks - (n + 1) / 2
    spread = np.sqrt((x**2).sum(axis=0) * (y**2).sum())
    correlation = np.divide(y @ x, spread, where=spread > 0, out=np.zeros(d))
    return Influence(
        names=tuple(b.name for b in judge.set.blocks),
        first_order=np.array([_between_bins(theta[:, k], numbers, bins) for k in range(d)]),
        noise=max(0.0, (bins - 1) * (ratio - 1) / ((bins - 1) * ratio + n - bins + 1)),
        directions=np.where(np.abs(correlation) > 3.0 / np.sqrt(n), np.sign(correlation), 0).astype(int),
        worst_value=float(values[worst]),
        restored=found[:d],
        nominal_value=float(found[-1]),
        unit=judge.unit,
        n=n,
    )


def _between_bins(x: Array, y: Array, bins: int) -> float:
    """Return omega squared of y in bins of x of equal count, an estimate of Var(E[y|x]) / Var(y)."""
    ordered = y[np.argsort(x, kind="stable")] - y.mean()
    parts, total = np.array_split(ordered, bins), float((ordered**2).sum())
    between = sum(len(part) * float(part.mean()) ** 2 for part in parts)
    within = (total - between) / (len(y) - bins)
    # Ignore the rounding of equal values.
    if total <= len(y) * (1e-12 * float(np.abs(y).max())) ** 2:
        return 0.0
    return float(np.clip((between - (bins - 1) * within) / (total + within), 0.0, 1.0))


FEWEST_SAMPLES = 32
LABEL = "sampled: of deltas that are uniform and independent in their ranges; no statement on the worst case"
DEFAULT_SAMPLES = 1000


def clopper_pearson(violations: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return both bounds of a probability from ``violations`` in n samples; see the module."""
    from scipy.stats import binomtest

    interval = binomtest(violations, n).proportion_ci(confidence, "exact")
    return float(interval.low), float(interval.high)


class Quantile(NamedTuple):
    """Quantile of the samples, and order statistics that bound the distribution's quantile at the confidence."""

    share: float
    value: float
    lower: float
    upper: float


def quantile_bounds(values: ArrayLike, share: float, confidence: float = 0.95) -> Quantile:
    """Return distribution-free bounds of a quantile from independent samples (n,), infinite values included."""
    from scipy.stats import binom

    ordered = np.concatenate([[-np.inf], np.sort(np.asarray(values, dtype=float)), [np.inf]])
    n, rest = len(ordered) - 2, (1.0 - confidence) / 2.0
    # P(X_(l) > quantile) = P(fewer than l below it) = cdf(l - 1): the largest l with at most ``rest`` of that.
    counts = binom.cdf(np.arange(n), n, share)
    lower, upper = np.searchsorted(counts, rest, side="right"), np.searchsorted(counts, 1.0 - rest, side="left") + 1
    return Quantile(share, *(float(ordered[rank]) for rank in (max(1, math.ceil(share * n)), lower, upper)))


@dataclass(frozen=True)
class ViolationProbability(Tabular, Displayable):
    """Probability that a sampled member violates a limit."""

    metric: str
    unit: str
    limit: float
    sense: float  # values above (1) or below (-1) the limit violate it
    n: int  # samples
    violations: int  # of these; a member without a bounded value violates the limit ...
    unbounded: int  # ... and these are such
    probability: float  # violations / n
    lower: float  # two-sided Clopper-Pearson bounds of the probability at `confidence`
    upper: float
    at_most: float  # one-sided bound
    confidence: float
    wanted: float | None  # the required probability; None where none was required
    shown: bool | None  # whether `at_most` confirms it
    samples_needed: int | None  # samples without a violation that would
    quantiles: tuple[Quantile, ...]  # of the metric
    worst_value: float  # the worst sample, re-evaluated by another method
    worst_index: int
    worst_delta: Mapping[str, Any]
    values: Array  # the metric of each sample, (n,)
    influence: Influence | None  # None for fewer than 32 samples or blocks that are not real scalars
    seed: int  # sample i was drawn from ``SeedSequence(seed, spawn_key=(i,))``
    status: Status  # CONVERGED, or INACCURATE where the worst sample's re-evaluation disagrees
    label: str = LABEL

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("n", "violations", "unbounded", "probability", "lower", "upper", "at_most"), "1"),
        "worst_value": float, "worst_delta": {"*": ...}, "shown": bool, "samples_needed": "1",
        "quantiles": {"*": {"*": float}}, "influence": {"*": "1"},
    }  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        """The quantiles by their share in percent, the influences by the parameters' names."""
        found = super().numbers() | {"quantiles": {f"{100 * q.share:g}": q._asdict() for q in self.quantiles}}
        known = self.influence
        if known is not None:
            found["influence"] = dict(zip(known.names, known.first_order.tolist(), strict=True))
        return found

    @property
    def met(self) -> bool | None:
        """Return whether the required probability is confirmed; None where none was stated."""
        return self.shown

    @property
    def _event(self) -> str:
        return f"{self.metric} {'above' if self.sense > 0 else 'below'} {number(self.limit, self.unit)}"

    def headline(self) -> str:
        return f"{self._event} in {self.violations} of {self.n} random members"

    def details(self) -> list[Part]:
        value = f"value [{self.unit}]" if self.unit else "value"
        header = ("quantile", value, f"bounds at {100 * self.confidence:g} %")
        rows = [(f"{100 * q.share:g} %", f"{q.value:.6g}", f"{q.lower:.6g} .. {q.upper:.6g}") for q in self.quantiles]
        matter = [] if self.influence is None else self.influence.rows()
        header_of_rows = ("relevant parameter", "of the spread", "metric", "worst sample with it nominal")
        return [Part("", header, rows), Part("", header_of_rows, matter)]

    def facts(self) -> Facts:
        sure = f"{100 * self.confidence:g} %"
        span = f"{number(self.lower)} .. {number(self.upper)} at {sure} confidence (Clopper-Pearson)"
        word, worst = "shown" if self.shown else "not shown", number(self.worst_value, self.unit)
        need = f"({self.samples_needed} samples without a violation would do)"
        return [
            ("probability", f"{span}; {self.violations} of {self.n} samples"),
            ("one-sided", f"at most {number(self.at_most)} at {sure} confidence"),
            ("of", self._event),
            ("wanted", "" if self.wanted is None else f"at most {self.wanted:g}: {word} at {sure} {need}"),
            ("without a bounded value", f"{self.unbounded} (unstable, or not settled)" if self.unbounded else ""),
            ("worst sample", f"number {self.worst_index}: {worst}: {member(self.worst_delta)}"),
            ("quantiles", listed(f"{q.share:g}: {number(q.value, self.unit)}" for q in self.quantiles)),
            ("meaning", self.label),
        ]

    def table(self) -> Table:
        return Table(("sample", np.arange(self.n)), {self.metric: self.values}, {self.metric: self.unit})

    def to_json(self) -> dict[str, object]:
        """All fields except the single values, which follow from the seed; quantiles as mappings."""
        data = {key: value for key, value in vars(self).items() if key != "values"}
        data["quantiles"] = [q._asdict() for q in self.quantiles]
        return data


@error_context("violation_probability")
@one_thread()
def violation_probability(
    uncertain: UncertainModel,
    metric: str | Callable[[StateSpaceModel], float],
    limit: float | str,
    *,
    probability: float | None = None,
    confidence: float = 0.95,
    n: int | None = None,
    quantiles: Sequence[float] = (0.05, 0.5, 0.95),
    output: str | None = None,
    input: str | None = None,
    t: ArrayLike | None = None,
    u: Mapping[str, ArrayLike] | ArrayLike | None = None,
    hold: Literal["zoh", "foh"] = "zoh",
    band: float = 0.02,
    seed: int = 0,
) -> ViolationProbability:
    """Probability that a metric violates a limit, from seeded samples, with Clopper-Pearson bounds.

    Parameters
    ----------
    uncertain
        The set; its parameters are assumed independent and uniform in their ranges.
    metric, output, input, t, u, hold, band
        As in `worst_case`.
    limit
        A number in the metric's unit, or a text with a unit that converts to it such as ``"0.5 rad"``.
    probability
        Required upper bound of P(violation).
    confidence
        Between 0 and 1.
    n
        Samples; by default as many as confirm ``probability`` without a violation, or 1000.
    quantiles
        Shares of the metric's quantiles, between 0 and 1.
    seed
        Seed of the random numbers.

    Returns
    -------
    ViolationProbability
        The share of samples that violate with its bounds, quantiles of the metric, its ``values (n,)``, the worst
        sample, and the influence of the parameters.

    Raises
    ------
    UsageError, InputError, NoTrustworthyNumber
        As in `worst_case`; a limit that is no number, shares that are none, a model without uncertainty.

    Examples
    --------
    >>> from robustlab import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> lag = UncertainModel(M, [RealScalar("pole")])
    >>> found = violation_probability(lag, "hinf", 1.2, n=4000)  # 1 / (1 + 0.2 delta) > 1.2: delta < -5/6
    >>> found.lower < 1 / 12 < found.upper
    True
    """
    from scipy.stats import binomtest

    where = "violation_probability"
    seed = checks.whole("seed", seed)
    judge = make_metric(uncertain, metric, output, input, t, u, hold, band)
    if not uncertain.blocks:
        raise InputError(where, "a model without uncertainty", "blocks to sample", "every sample would be the nominal")
    for name, share in [("confidence", confidence), *(("quantile", q) for q in quantiles)]:
        checks.number(name, share, "a number between 0 and 1", above=0, below=1)
    needed = None
    if probability is not None:
        checks.number("probability", probability, "a number between 0 and 1", above=SMALLEST_SHARE, below=1)
        # Without a violation n samples show p at confidence c where (1 - p)^n <= 1 - c.
        needed = max(1, math.ceil(math.log1p(-confidence) / math.log1p(-probability) * (1 - 1e-12)))
    expected = "a finite number, or one with its unit such as '0.5 rad'"
    value = checks.number(f"{where}: limit", amount(f"{where}: limit", limit, judge.unit), expected)
    count = checks.whole("n", needed or DEFAULT_SAMPLES if n is None else n, 1, MOST_SAMPLES)
    deltas = Deltas(uncertain.blocks, count, seed)
    values = values_at(judge, deltas)
    scores = judge.sense * values
    violations, worst = int((scores > judge.sense * value).sum()), int(scores.argmax())
    delta = dict(deltas[worst])
    again = judge.evaluate(delta)
    low, high = clopper_pearson(violations, count, confidence)
    at_most = float(binomtest(violations, count, alternative="less").proportion_ci(confidence, "exact").high)
    real = judge.set.all_real and count >= FEWEST_SAMPLES
    return ViolationProbability(
        metric=name_of(metric),
        unit=judge.unit,
        limit=value,
        sense=judge.sense,
        n=count,
        violations=violations,
        unbounded=int(np.isposinf(scores).sum()),
        probability=violations / count,
        lower=low,
        upper=high,
        at_most=at_most,
        confidence=confidence,
        wanted=probability,
        shown=None if probability is None else at_most <= probability,
        samples_needed=needed,
        quantiles=tuple(quantile_bounds(values, q, confidence) for q in quantiles),
        worst_value=again.value,
        worst_index=worst,
        worst_delta=delta,
        values=values,
        influence=influence_of(judge, deltas.numbers(slice(0, count)), values, worst) if real else None,
        seed=seed,
        status=Status.CONVERGED
        if again.accurate and judge.agrees(float(values[worst]), again.value)
        else Status.INACCURATE,
    )
