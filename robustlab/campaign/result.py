"""What a store says about its campaign: counts, the worst sample, quantiles, what was lost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robustlab.campaign.evaluation import Evaluator
from robustlab.campaign.rows import decode_delta
from robustlab.campaign.statistics import (
    Quantile,
    Violation,
    probability_bounds,
    quantiles,
    share_beyond,
)
from robustlab.campaign.store import Sample, Store
from robustlab.errors import InputError
from robustlab.result import Status

__all__ = ["CampaignResult", "LostSample", "result_of"]

LABEL = "sampled: a lower bound of the true worst case"
LABEL_SMALLEST = "sampled: an upper bound of the true worst case, which is the smallest value"
SHOWN_LOST = 100


@dataclass(frozen=True)
class LostSample:
    """A sample without a value: its index, why, and its Delta."""

    index: int
    reason: str
    delta: Mapping[str, Any]


@dataclass(frozen=True)
class CampaignResult:
    """A campaign as its store has it.

    Attributes
    ----------
    status
        CONVERGED: all samples are there, and the worst one was confirmed through a second path. INACCURATE: it was
        not. INCONCLUSIVE: samples are missing yet.
    store
        The file.
    kind, metric, unit
        What was computed.
    n, done, lost
        Samples asked for, with a value, and without one.
    unbounded
        Samples whose value is infinite (unstable members).
    sense
        1 where the largest value is the worst, -1 where the smallest is.
    worst, worst_index, delta, physical
        Worst value, the sample that has it, its normalised Delta, and its parameters as (value, unit).
    at, location
        Where the worst value is attained, from the second path.
    again
        The worst value through the second path.
    nominal
        The metric at Delta = 0.
    quantiles
        See `robustlab.campaign.statistics.quantiles`; for samples only, and only where all of them are there.
    unseen
        Largest probability, at 95 % confidence, of a member worse than the worst sample; NaN where not sampled.
    violation
        How often the metric was worse than a limit, where one was given.
    lost_samples
        The first hundred of them.
    digest
        SHA-256 over all rows; equal for equal results, however often the run was interrupted.
    seconds
        Time of all samples together.
    seed
        Seed of the random numbers.
    label
        What the worst value is, and is not.
    """

    status: Status
    store: str
    kind: str
    metric: str
    unit: str
    n: int
    done: int
    lost: int
    unbounded: int
    sense: int
    worst: float
    worst_index: int
    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    at: float
    location: str
    again: float
    nominal: float
    quantiles: tuple[Quantile, ...]
    unseen: float
    violation: Violation | None
    lost_samples: tuple[LostSample, ...]
    digest: str
    seconds: float
    seed: int
    label: str

    def to_json(self) -> dict[str, Any]:
        """All fields as plain types."""
        data = vars(self).copy()
        data["quantiles"] = [vars(q).copy() for q in self.quantiles]
        data["violation"] = vars(self.violation).copy() if self.violation else None
        data["lost_samples"] = [vars(sample).copy() for sample in self.lost_samples]
        return data


def result_of(store: Store, evaluator: Evaluator, limit: float | None = None) -> CampaignResult:
    """Read a store once through.

    Parameters
    ----------
    limit
        Count how often the metric is worse than it.

    Raises
    ------
    InputError
        The rows of a finished campaign are not what they were when it ended.
    """
    settings, blocks = evaluator.settings, evaluator.uncertain.blocks
    counts, facts, worst = store.counts(), store.facts(), store.worst(evaluator.sense)
    complete = counts.done + counts.lost >= settings.n
    digest = store.digest()
    if facts and complete and facts["digest"] != digest:
        raise InputError(store.where, "its rows were changed after the campaign ended (the digest differs)")
    delta = decode_delta(blocks, worst.numbers) if worst else {}
    sampled = settings.kind == "samples" and counts.done > 0
    unseen = probability_bounds(counts.lost, counts.done + counts.lost)[1] if sampled else math.nan
    return CampaignResult(
        _status(complete, facts, worst is not None),
        store.where,
        settings.kind,
        settings.metric,
        evaluator.unit,
        settings.n,
        counts.done,
        counts.lost,
        store.unbounded(),
        evaluator.sense,
        worst.value if worst else math.nan,
        worst.index if worst else -1,
        delta,
        evaluator.uncertain.physical(delta) if worst else {},
        float(facts.get("at", math.nan)),
        evaluator.location,
        float(facts.get("again", math.nan)),
        float(facts.get("nominal", math.nan)),
        quantiles(store, evaluator.sense, counts.done, counts.lost) if sampled and complete else (),
        unseen,
        share_beyond(store, evaluator.sense, limit, counts.done, counts.lost)
        if limit is not None and counts.done
        else None,
        tuple(LostSample(row.index, row.reason, decode_delta(blocks, row.numbers)) for row in store.lost(SHOWN_LOST)),
        digest,
        store.seconds(),
        settings.seed,
        _label(worst, evaluator.sense),
    )


def _label(worst: Sample | None, sense: int) -> str:
    if worst is not None and not math.isfinite(worst.value):
        return "attained: this member has no bounded value"
    return LABEL if sense > 0 else LABEL_SMALLEST


def _status(complete: bool, facts: Mapping[str, Any], any_value: bool) -> Status:
    if not complete or not facts:
        return Status.INCONCLUSIVE
    return Status.CONVERGED if any_value and facts["agrees"] else Status.INACCURATE
