r"""How probable each set of effects is, and what that allows to be said.

.. math:: P(S) = e^{E(S) / T} \Big/ \sum_{S'} e^{E(S') / T}

over the sets that the search judged and that may be the answer, with E the log evidence and T the temperature. Of two
sets that differ in one effect and whose refit distance d for these very records is below 3, no test on the records can
tell one from the other: what log evidence they differ by beyond :math:`d^2/2` and their priors is an accident of the
fits, and is not counted.

A set whose error on held-out data is larger than that of the nominal model refitted within its tolerances is no answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, refit_distance
from robustlab.identification.hypotheses.noise import held_out_fit, rms_percent, white
from robustlab.identification.naming.search import Found, Key, Visited

__all__ = ["Alternative", "Posterior", "Weighed", "weigh"]


@dataclass(frozen=True, eq=False)
class Weighed:
    """A set with its probability, and its refit distance from the most probable one (NaN where not asked for)."""

    visited: Visited
    probability: float
    distance: float

    @property
    def fit(self) -> Fit:
        """Of the set."""
        return self.visited.fit

    @property
    def key(self) -> Key:
        """Keys of its effects."""
        return self.visited.key


@dataclass(frozen=True, eq=False)
class Alternative:
    """An effect of another set of the answer, in the place of one of the best set (None: beside all of them)."""

    candidate: Candidate
    instead_of: Candidate | None
    weighed: Weighed
    evidence: float


@dataclass(frozen=True, eq=False)
class Posterior:
    """Sets of effects, the most probable first.

    ``collection`` is the smallest of them with the probability that an answer needs, and whatever no test tells from
    the best. ``generalises`` is False where every more probable set than the empty one fails on held-out data.
    """

    sets: tuple[Weighed, ...]
    collection: tuple[Weighed, ...]
    generalises: bool

    @property
    def best(self) -> Weighed:
        """The most probable set."""
        return self.sets[0]

    def of_effect(self, key: str) -> float:
        """Probability of all sets that contain the effect."""
        return float(min(1.0, sum(w.probability for w in self.sets if key in w.key)))

    def alternatives(self) -> list[Alternative]:
        """What the other sets of the collection have and the best has not, each effect once."""
        here = {c.key: c for c in self.best.fit.hypothesis.candidates}
        found: dict[str, Alternative] = {}
        for other in self.collection[1:]:
            missing = [c for key, c in here.items() if key not in other.key]
            behind = other.visited.evidence - self.best.visited.evidence
            for candidate in other.fit.hypothesis.candidates:
                if candidate.key not in here and candidate.key not in found:
                    place = next((m for m in missing if m.site == candidate.site), missing[0] if missing else None)
                    found[candidate.key] = Alternative(candidate, place, other, behind)
        return list(found.values())


def weigh(found: Found) -> Posterior:
    """The posterior of what the search found."""
    problem, tuning = found.problem, found.problem.tuning
    ordered, generalises = _generalising(found)
    best = ordered[0]
    evidence = {v.key: v.evidence for v in ordered}
    distance = {best.key: 0.0}
    for other in _exchanged(best, ordered[1:], tuning.far_behind)[: tuning.most_rivals]:
        d = distance[other.key] = refit_distance(problem, best.fit, other.fit)
        if d < tuning.cannot_tell:
            least = best.evidence - best.prior - 0.5 * d**2 + other.prior
            evidence[other.key] = max(evidence[other.key], least)
    log = np.array([evidence[v.key] for v in ordered]) / tuning.temperature
    share = np.exp(log - log.max())
    share /= share.sum()
    weighed = [Weighed(v, float(p), distance.get(v.key, np.nan)) for v, p in zip(ordered, share, strict=True)]
    # The best fit stays first: a twin whose prior is larger is told beside it.
    sets = [weighed[0], *sorted(weighed[1:], key=lambda w: -w.probability)]
    twins = {key for key, d in distance.items() if d < tuning.cannot_tell}
    return Posterior(tuple(sets), tuple(_collected(sets, tuning.sure, twins)), generalises)


def _generalising(found: Found) -> tuple[list[Visited], bool]:
    """The sets that may be the answer; those at its head that fail on held-out data are left out."""
    plain = white(found.noise)

    def error(visited: Visited) -> float:
        return rms_percent(found.held, held_out_fit(found.held, visited.fit, plain))

    most = error(found.empty)
    left = [v for v in found.sets if v.allowed]
    failed = False
    while left[0].key and error(left[0]) > most:
        left, failed = left[1:], True
    return left, not (failed and not left[0].key)


def _exchanged(best: Visited, others: Iterable[Visited], far: float) -> list[Visited]:
    """Sets with one effect in the place of another, where not both are gains, which tolerances alone tell apart."""
    found = []
    for other in others:
        gone = [c for c in best.fit.hypothesis.candidates if c.key not in other.key]
        come = [c for c in other.fit.hypothesis.candidates if c.key not in best.key]
        if len(gone) != 1 or len(come) != 1 or best.evidence - other.evidence > far:
            continue
        refined = come[0].effect.refines == gone[0].effect.id and come[0].site == gone[0].site
        if not refined and not (gone[0].effect.gain_like and come[0].effect.gain_like):
            found.append(other)
    return found


def _collected(sets: Sequence[Weighed], sure: float, twins: set[Key]) -> list[Weighed]:
    """The smallest collection with this probability, and the twins of the best."""
    total, found = 0.0, []
    for entry in sets:
        if total < sure or entry.key in twins:
            found.append(entry)
        total += entry.probability
    return found
