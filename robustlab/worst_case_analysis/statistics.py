r"""Statistics of samples: Clopper-Pearson bounds of a probability, how many samples show it, quantiles.

They hold for parameters uniform in their ranges and independent, and say nothing about the worst case (Clopper, Pearson
1934; Tempo, Bai, Dabbene 1997; David, Nagaraja, *Order Statistics*, 2003, 7.1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import InputError, UnitMismatch, told_as
from robustlab.result import Status
from robustlab.shown import Facts, Part, Shown, listed, member, number
from robustlab.statespace import StateSpaceModel
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.influence import Influence, influence_of
from robustlab.worst_case_analysis.members import is_count
from robustlab.worst_case_analysis.metrics import MetricBatch, MetricRequest

# Shares that are shown by more samples than 10^15 are not asked for.
SMALLEST_SHARE = 1e-14
FEWEST_SAMPLES = 32


LABEL = "sampled: of deltas that are uniform and independent in their ranges; no statement on the worst case"
DEFAULT_SAMPLES = 1000


def clopper_pearson(violations: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Both bounds of a probability of which ``violations`` of n samples are known; see the module.

    Examples
    --------
    >>> low, high = clopper_pearson(0, 29, 0.90)
    >>> low, round(high, 6) == round(1 - 0.05 ** (1 / 29), 6)
    (0.0, True)
    """
    _check_share("confidence", confidence)
    _check_count(violations, n)
    rest = (1.0 - confidence) / 2.0
    return _beta(rest, violations, n - violations + 1), _beta(1.0 - rest, violations + 1, n - violations)


def upper_bound(violations: int, n: int, confidence: float = 0.95) -> float:
    """One-sided Clopper-Pearson bound: with this confidence the probability is at most so large."""
    _check_share("confidence", confidence)
    _check_count(violations, n)
    return _beta(confidence, violations + 1, n - violations)


@told_as("sample_size")
def sample_size(probability: float, confidence: float = 0.95, violations: int = 0) -> int:
    r"""Smallest number of samples that shows ``P(violation) <= probability`` where at most ``violations`` occur.

    .. math:: n = \left\lceil \frac{\log(1 - c)}{\log(1 - p)} \right\rceil \text{ for none}, \qquad
              \sum_{i=0}^{k} \binom{n}{i} p^i (1 - p)^{n - i} \le 1 - c \text{ for } k

    Parameters
    ----------
    probability
        p, what is to be shown; between 0 and 1.
    confidence
        c, with which it is to be shown; between 0 and 1.
    violations
        k, how many of the samples may violate.

    Returns
    -------
    int
        n.

    Raises
    ------
    InputError
        Shares that do not lie between 0 and 1, a negative number of violations.

    Examples
    --------
    >>> sample_size(0.05, 0.95), sample_size(0.01, 0.99), sample_size(0.05, 0.95, violations=1)
    (59, 459, 93)
    """
    from scipy.stats import nbinom

    _check_share("probability", probability)
    _check_share("confidence", confidence)
    if not is_count(violations, 0):
        raise InputError("sample_size", f"violations is {violations!r}", "a whole number, not negative")
    if probability < SMALLEST_SHARE:
        raise InputError("sample_size: probability", f"{probability:g}", f"at least {SMALLEST_SHARE:g}")
    if violations == 0:
        return max(1, math.ceil(math.log1p(-confidence) / math.log1p(-probability) * (1 - 1e-12)))
    # At most k violations among n samples: the violation k + 1 comes after more than n - k - 1 samples that hold.
    return int(violations) + 1 + int(nbinom.isf(1.0 - confidence, violations + 1, probability))


class Quantile(NamedTuple):
    """Value below which a share of the samples lies, and bounds of the distribution's quantile at the confidence.

    The bounds are order statistics, whatever the distribution; infinite where there are too few samples.
    """

    share: float
    value: float
    lower: float
    upper: float


def quantile_bounds(values: ArrayLike, share: float, confidence: float = 0.95) -> Quantile:
    """Distribution-free bounds of a quantile from independent samples (n,), infinite values included.

    Examples
    --------
    >>> quantile_bounds(range(1, 101), 0.5, 0.95)
    Quantile(share=0.5, value=50.0, lower=40.0, upper=61.0)
    """
    from scipy.stats import binom

    _check_share("quantile", share)
    _check_share("confidence", confidence)
    ordered = np.sort(np.asarray(values, dtype=float))
    n = len(ordered)
    if n == 0 or np.isnan(ordered).any():
        raise InputError("quantile", "no values" if n == 0 else "NaN among the values", "numbers")
    rest = (1.0 - confidence) / 2.0
    # P(X_(l) > quantile) = P(fewer than l below it) = cdf(l - 1): the largest l with at most ``rest`` of that.
    counts = binom.cdf(np.arange(n), n, share)
    low = int(np.searchsorted(counts, rest, side="right"))
    high = int(np.searchsorted(counts, 1.0 - rest, side="left")) + 1
    value = float(ordered[max(0, math.ceil(share * n) - 1)])
    lower = float(ordered[low - 1]) if low > 0 else -math.inf
    return Quantile(share, value, lower, float(ordered[high - 1]) if high <= n else math.inf)


@dataclass(frozen=True)
class ViolationProbability(Tabular, Shown):
    """How probable it is that a sampled member violates a limit.

    Attributes
    ----------
    metric, unit
        What is limited.
    limit, sense
        Values above (sense 1) or below (sense -1) it violate.
    n, violations
        Samples, and those that violate; a member without a bounded value does (``unbounded`` of them).
    probability
        Their share.
    lower, upper
        Two-sided Clopper-Pearson bounds at ``confidence``.
    at_most
        One-sided bound at ``confidence``.
    wanted, shown
        The probability that was to be shown, and whether ``at_most`` shows it; None where none was stated.
    samples_needed
        Samples that would show it without a violation; None where none was stated.
    quantiles
        Of the metric, with distribution-free bounds.
    worst_value, worst_index, worst_delta
        Of the worst sample, re-evaluated by another path.
    values
        The metric of each sample, (n,).
    influence
        Which parameters matter; None for fewer than 32 samples or blocks that are not real scalars.
    seed
        Sample i was drawn from ``SeedSequence(seed, spawn_key=(i,))``.
    status
        CONVERGED, or INACCURATE where the worst sample's re-evaluation disagrees.
    notes
        What the reader must know.
    label
        What the probability is of, and is not.
    """

    metric: str
    unit: str
    limit: float
    sense: float
    n: int
    violations: int
    unbounded: int
    probability: float
    lower: float
    upper: float
    at_most: float
    confidence: float
    wanted: float | None
    shown: bool | None
    samples_needed: int | None
    quantiles: tuple[Quantile, ...]
    worst_value: float
    worst_index: int
    worst_delta: Mapping[str, Any]
    values: Array
    influence: Influence | None
    seed: int
    status: Status
    notes: tuple[str, ...] = ()
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
        """Whether it was shown that the probability is as small as wanted; None where nothing was wanted."""
        return self.shown

    def headline(self) -> str:
        """What violates the limit how often."""
        beyond = "above" if self.sense > 0 else "below"
        limit = number(self.limit, self.unit)
        return f"{self.metric} {beyond} {limit} in {self.violations} of {self.n} random members"

    def details(self) -> list[Part]:
        """Quantiles with their bounds, and the parameters that matter."""
        value = f"value [{self.unit}]" if self.unit else "value"
        header = ("quantile", value, f"bounds at {100 * self.confidence:g} %")
        rows = [(f"{100 * q.share:g} %", f"{q.value:.6g}", f"{q.lower:.6g} .. {q.upper:.6g}") for q in self.quantiles]
        matter = [] if self.influence is None else self.influence.rows()
        header_of_rows = ("what matters", "of the spread", "metric", "worst sample with it nominal")
        return [Part("", header, rows), Part("", header_of_rows, matter)]

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        beyond = "above" if self.sense > 0 else "below"
        sure = f"{100 * self.confidence:g} %"
        span = f"{number(self.lower)} .. {number(self.upper)} at {sure} confidence (Clopper-Pearson)"
        word = "shown" if self.shown else "not shown"
        need = f"({self.samples_needed} samples without a violation would do)"
        return [
            ("probability", f"{span}; {self.violations} of {self.n} samples"),
            ("one-sided", f"at most {number(self.at_most)} at {sure} confidence"),
            ("of", f"{self.metric} {beyond} {number(self.limit, self.unit)}"),
            ("wanted", "" if self.wanted is None else f"at most {self.wanted:g}: {word} at {sure} {need}"),
            ("without a bounded value", f"{self.unbounded} (unstable, or not settled)" if self.unbounded else ""),
            (
                "worst sample",
                f"number {self.worst_index}: {number(self.worst_value, self.unit)}: {member(self.worst_delta)}",
            ),
            ("quantiles", listed(f"{q.share:g}: {number(q.value, self.unit)}" for q in self.quantiles)),
            *(("note", note) for note in self.notes),
            ("said", self.label),
        ]

    def table(self) -> Table:
        """The metric of every sample."""
        return Table(("sample", np.arange(self.n)), {self.metric: self.values}, {self.metric: self.unit})

    def to_json(self) -> dict[str, object]:
        """All fields but the single values, which follow from the seed; quantiles as mappings."""
        data = {key: value for key, value in vars(self).items() if key != "values"}
        data["quantiles"] = [q._asdict() for q in self.quantiles]
        return data


@told_as("violation_probability")
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
    workers: int = 1,
) -> ViolationProbability:
    """Probability that a metric violates a limit, from seeded samples, with Clopper-Pearson bounds.

    Parameters
    ----------
    uncertain
        The set; its parameters are taken as uniform in their ranges and independent.
    metric, output, input, t, u, hold, band
        As in `worst_case`.
    limit
        A number in the metric's unit, or a text with its unit such as ``"0.5 rad"``.
    probability
        What is to be shown: P(violation) at most so large.
    confidence
        Between 0 and 1.
    n
        Samples; left out: as many as show ``probability`` without a violation, or 1000.
    quantiles
        Shares of the metric's quantiles, between 0 and 1.
    seed
        Same seed, same answer.
    workers
        Threads; the answer does not depend on their number.

    Returns
    -------
    ViolationProbability
        The share of samples that violate with its bounds, quantiles of the metric, its ``values (n,)``, the worst
        sample, and which parameters matter.

    Raises
    ------
    UnitMismatch
        The limit has another unit than the metric.
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
    where = "violation_probability"
    batch = MetricBatch(uncertain, MetricRequest(metric, output, input, t, u, hold, band), seed)
    judge = batch.judge
    if not uncertain.blocks:
        raise InputError(where, "a model without uncertainty", "blocks to sample", "every sample would be the nominal")
    _check_share("confidence", confidence)
    needed = None if probability is None else sample_size(probability, confidence)
    number, notes = _limit(limit, judge.unit, where)
    values = batch.all_values(n if n is not None else needed or DEFAULT_SAMPLES, workers)
    scores = judge.sense * values
    violations = int((scores > judge.sense * number).sum())
    worst = int(scores.argmax())
    delta = batch.delta(worst)
    again = judge.evaluate(delta)
    low, high = clopper_pearson(violations, len(values), confidence)
    at_most = upper_bound(violations, len(values), confidence)
    real = judge.set.all_real and len(values) >= FEWEST_SAMPLES
    return ViolationProbability(
        batch.request.name,
        judge.unit,
        number,
        judge.sense,
        len(values),
        violations,
        int(np.isposinf(scores).sum()),
        violations / len(values),
        low,
        high,
        at_most,
        confidence,
        probability,
        None if probability is None else at_most <= probability,
        needed,
        tuple(quantile_bounds(values, q, confidence) for q in quantiles),
        again.value,
        worst,
        delta,
        values,
        influence_of(batch, values, worst) if real else None,
        int(seed),
        Status.CONVERGED if judge.agrees(float(values[worst]), again.value) and again.accurate else Status.INACCURATE,
        notes,
    )


def _limit(limit: float | str, unit: str, where: str) -> tuple[float, tuple[str, ...]]:
    """The limit's number, and a note where it came without the unit that the metric has."""
    text, given = (str(limit), "") if not isinstance(limit, str) else _split(limit)
    try:
        number = float(text) if isinstance(limit, str) else float(limit)
    except (TypeError, ValueError):
        expected = "a number, or one with its unit such as '0.5 rad'"
        raise InputError(f"{where}: limit", f"{limit!r}", expected) from None
    if not math.isfinite(number) or isinstance(limit, bool):
        raise InputError(f"{where}: limit", f"{limit!r}", "a finite number")
    if given and given != unit:
        raise UnitMismatch(f"{where}: limit", f"in {given}", f"{unit or 'no unit'}: that of the metric")
    return number, (f"the limit {number:g} came without a unit and was taken in {unit}",) if unit and not given else ()


def _split(text: str) -> tuple[str, str]:
    match = re.fullmatch(r"\s*(\S+)\s*(.*?)\s*", text)
    return (match.group(1), match.group(2)) if match else (text, "")


def _beta(share: float, a: int, b: int) -> float:
    from scipy.stats import beta

    if a == 0:
        return 0.0
    return float(beta.ppf(share, a, b)) if b > 0 else 1.0


def _check_share(name: str, value: float) -> None:
    checks.number(name, value, "a number between 0 and 1", above=0, below=1)


def _check_count(violations: int, n: int) -> None:
    for name, count, least in (("n", n, 1), ("violations", violations, 0)):
        if not is_count(count, least):
            raise InputError("clopper_pearson", f"{name} is {count!r}", f"a whole number, at least {least}")
    if violations > n:
        raise InputError("clopper_pearson", f"{violations} violations of {n} samples", "at most as many as samples")
