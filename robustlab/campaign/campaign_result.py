"""Summary of a campaign's store; lost samples count as the worst."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.campaign.evaluation import Evaluator
from robustlab.campaign.store import Store
from robustlab.display import AllFields, Displayable, Facts, Part, member, member_rows, number
from robustlab.errors import InputError
from robustlab.result import Status, Table, Tabular
from robustlab.worst_case_analysis.members import decoded
from robustlab.worst_case_analysis.statistics import clopper_pearson, quantile_bounds
from robustlab.worst_case_analysis.worst_case_search import LABEL, LABEL_SMALLEST, UNBOUNDED

CONFIDENCE = 0.95  # of each bound of a probability
TWO_SIDED = 2.0 * CONFIDENCE - 1.0  # of both together
SHARES = (0.5, 0.9, 0.99, 0.999)
SHOWN_LOST = 100
LISTED_LOST = 10  # of these in a text
_COUNTED = {"samples": ("sample", "samples"), "vertices": ("vertex", "vertices"), "search": ("search", "searches")}


@dataclass(frozen=True)
class Quantile(AllFields):
    """A share, the sample quantile, and a bound of the set's quantile at CONFIDENCE."""

    share: float
    value: float  # the order statistic with number `ceil(share n)`, counted from the best
    bound: float  # infinite where there are too few samples


@dataclass(frozen=True)
class Violation(AllFields):
    """Number of samples worse than a limit, lost ones counted, and Clopper-Pearson bounds, each at CONFIDENCE."""

    limit: float
    count: int
    of: int
    lower: float
    upper: float


@dataclass(frozen=True)
class LostSample(AllFields):
    """A sample without a value: its index, the reason, and its Delta."""

    index: int
    reason: str
    delta: Mapping[str, Any]


def _quantiles(store: Store, sense: int, lost: int) -> tuple[Quantile, ...]:
    """Return the quantiles that the number of samples allows; lost samples count as worst."""
    scores = np.append(sense * np.fromiter(store.values(), dtype=float), np.full(lost, np.inf))
    # Where fewer than one sample is expected above a share, the worst sample has the same information.
    shares = [share for share in SHARES if len(scores) * (1.0 - share) >= 1.0 or share <= 0.5]
    found = [quantile_bounds(scores, share, TWO_SIDED) for share in shares]
    return tuple(Quantile(q.share, sense * q.value, sense * q.upper) for q in found)


@dataclass(frozen=True)
class CampaignResult(Tabular, Displayable, AllFields):
    """The results of a campaign's store."""

    # CONVERGED: all samples are stored, and the worst one is confirmed by a second method. INACCURATE: it is not.
    # INCONCLUSIVE: samples are missing.
    status: Status
    store: str  # the file
    kind: str  # of samples
    metric: str
    unit: str
    # n, done, lost: samples requested, with a value, and without one
    n: int
    done: int
    lost: int
    unbounded: int  # samples whose value is infinite (unstable members)
    sense: int  # 1 where the largest value is the worst, -1 where the smallest is
    # worst, worst_index, delta, physical: worst value, the sample that has it, its normalised Delta, and its parameters
    # as (value, unit)
    worst: float
    worst_index: int
    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    # at, location, again: where the worst value is attained, and its value, by the second method
    at: float
    location: str
    again: float
    nominal: float  # the metric at Delta = 0
    quantiles: tuple[Quantile, ...]  # for samples only, once all are stored
    # Largest probability, at 95 % confidence, of a member worse than the worst sample; NaN where not sampled.
    unseen: float
    violation: Violation | None  # number of samples worse than a limit, where one was given
    lost_samples: tuple[LostSample, ...]  # the first hundred of them
    digest: str  # SHA-256 over all rows; equal for equal results, independent of interruptions
    seconds: float  # time of all samples together
    seed: int  # of the random numbers
    label: str  # meaning of the worst value

    def facts(self) -> Facts:
        one, many = _COUNTED[self.kind]
        worst = f"{number(self.worst, self.unit, 9)} in {one} {self.worst_index}"
        what, _, unit = self.location.partition(" ")
        if what and not math.isnan(self.at):
            worst += f", at {what} = {number(self.at, unit.strip('[]'), 6)}"
        missing = self.n - self.done - self.lost
        words = ((self.lost, "lost"), (missing, "missing yet"), (self.unbounded, "without a bounded value"))
        counts = [f"{self.done} of {self.n} {many}", *(f"{c} {word}" for c, word in words if c)]
        limit, v = "", self.violation
        if v is not None:
            bounds = f"probability {v.lower:.4g} .. {v.upper:.4g}, each side with 95 % confidence"
            limit = f"{number(v.limit, self.unit, 9)}: {v.count} of {v.of} (lost ones counted); {bounds}"
        unseen = f"at most {self.unseen:.3g} of the set, with 95 % confidence"
        return [
            (f"worst {self.metric}", worst if self.done else ""),
            ("through the second path", number(self.again, self.unit, 9)),
            ("nominal", number(self.nominal, self.unit, 9)),
            ("worst member", member(self.delta, self.physical)),
            (many, ", ".join([*counts, f"seed {self.seed}"])),
            ("members worse than all of these", "" if math.isnan(self.unseen) else unseen),
            ("worse than", limit),
            ("meaning", self.label),
            ("store", self.store),
            ("digest", self.digest),
            ("time of all samples", number(self.seconds, "s")),
        ]

    def details(self) -> list[Part]:
        rows = [(f"{100 * q.share:g} %", f"{q.value:.9g}", f"{q.bound:.9g}") for q in self.quantiles]
        lost = [(str(sample.index), sample.reason) for sample in self.lost_samples[:LISTED_LOST]]
        return [
            Part("", ("share", "not worse than", "with 95 % confidence"), rows),
            member_rows(self.delta, self.physical)._replace(title="worst member:"),
            Part("", ("lost", "reason"), lost),
        ]

    def table(self) -> Table:
        """The metric and the normalised Delta of every sample, read from the store."""
        with closing(Store.open(Path(self.store))) as store:
            rows = list(store.samples())
        deltas = np.array([row.numbers for row in rows]).reshape(len(rows), -1)
        columns = {self.metric: np.array([row.value for row in rows])}
        if deltas.shape[1] == len(self.delta):
            columns |= {name: deltas[:, k] for k, name in enumerate(self.delta)}
        return Table(("sample", [row.index for row in rows]), columns, {self.metric: self.unit})


def result_of(store: Store, evaluator: Evaluator, limit: float | None = None) -> CampaignResult:
    """Read a store. Raises InputError: the rows of a finished campaign were changed."""
    settings, blocks, sense = evaluator.settings, evaluator.uncertain.blocks, evaluator.sense
    (done, lost), facts, worst = store.counts(), store.facts(), store.worst(sense)
    n, (unbounded, above, seconds) = done + lost, store.totals(sense, limit)
    complete, digest = n >= settings.n, store.digest()
    if facts and complete and facts["digest"] != digest:
        raise InputError(store.where, "its rows were changed after the campaign ended (the digest differs)")
    status = Status.INCONCLUSIVE
    if complete and facts:
        status = Status.CONVERGED if worst is not None and facts["agrees"] else Status.INACCURATE
    delta = decoded(blocks, worst.numbers) if worst else {}
    sampled, violation = settings.kind == "samples" and done > 0, None
    if limit is not None and done:
        lower, _ = clopper_pearson(above, n, TWO_SIDED)
        _, upper = clopper_pearson(above + lost, n, TWO_SIDED)
        violation = Violation(limit, above + lost, n, lower, upper)
    label = LABEL if sense > 0 else LABEL_SMALLEST
    return CampaignResult(
        status=status,
        store=store.where,
        kind=settings.kind,
        metric=settings.metric,
        unit=evaluator.metric.unit,
        n=settings.n,
        done=done,
        lost=lost,
        unbounded=unbounded,
        sense=sense,
        worst=worst.value if worst else math.nan,
        worst_index=worst.index if worst else -1,
        delta=delta,
        physical=evaluator.uncertain.physical(delta) if worst else {},
        at=float(facts.get("at", math.nan)),
        location=evaluator.metric.location,
        again=float(facts.get("again", math.nan)),
        nominal=float(facts.get("nominal", math.nan)),
        quantiles=_quantiles(store, sense, lost) if sampled and complete else (),
        unseen=clopper_pearson(lost, n, TWO_SIDED)[1] if sampled else math.nan,
        violation=violation,
        lost_samples=tuple(
            LostSample(row.index, row.reason, decoded(blocks, row.numbers)) for row in store.lost(SHOWN_LOST)
        ),
        digest=digest,
        seconds=seconds,
        seed=settings.seed,
        label=UNBOUNDED if worst and not math.isfinite(worst.value) else label,
    )
