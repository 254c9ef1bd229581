"""Posterior of the sets of effects: P(S) ~ exp(E(S) / T) with the log evidence E under sensor noise and a random
force.

T is 1, or more if a residual force of the best set has evidence (coarsened posterior: Miller, Dunson, JASA 114, 2019).
Evidence of an effect that the refit distance does not support (below 3) does not count.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Site
from robustlab.identification import tuning
from robustlab.identification.greybox.effect_fit import Candidate, Fit, NoiseModel, Problem, refit_distance
from robustlab.identification.greybox.noise import (
    clearly_larger,
    held_out_fit,
    in_phase,
    noise_ratio,
    window_errors,
)
from robustlab.identification.greybox.random_force import FittedWindows
from robustlab.identification.greybox.unnamed_force import (
    PRIOR,
    SINGULAR,
    Unnamed,
    UnnamedEvidence,
    fitted_windows,
    unnamed_force,
)
from robustlab.identification.missing_effects.set_search import Found, Key, Scored, related

TEMPERATURE = 1.0  # smallest divisor of log evidence: above 1, less sure
MOST_WEIGHED = 5  # sets evaluated under a random force
MOST_RIVALS = 5  # examined for each named effect
NO_EVIDENCE = 2.0  # log Bayes factor without significance
IRRELEVANT = 0.005  # probability below which a set does not change the verdict


@dataclass(frozen=True, eq=False)
class Weighted:
    """A set with probability, log evidence, refit distance from the best (NaN: not computed), and residual force."""

    visited: Scored
    probability: float
    evidence: float
    distance: float
    unnamed: UnnamedEvidence | None = None

    @property
    def fit(self) -> Fit:
        return self.visited.fit

    @property
    def key(self) -> Key:
        return self.visited.key


def place_of(candidate: Candidate) -> str:
    """Return the effect with its site: ``coulomb-friction@omega``."""
    return f"{candidate.effect.id}@{candidate.site.name}"


@dataclass(frozen=True, eq=False)
class Posterior:
    """Sets of effects, the most probable first."""

    sets: tuple[Weighted, ...]
    collection: tuple[Weighted, ...]  # the smallest that is sure, and sets indistinguishable from the best
    generalises: bool  # False if every more probable set than the empty one fails on held-out data
    weight: Weight | None  # of the best set
    coarse: bool  # whether log evidence is divided because of a residual force

    @property
    def left(self) -> tuple[Unnamed, ...]:
        """Return the residual force of the best set by place; nothing if it is unknown."""
        return self.weight.left if self.weight else ()

    @property
    def noise_ratio(self) -> float:
        """Return the error of the best set over noise and random force, the largest over the places; NaN if unknown."""
        return max((u.noise_ratio for u in self.left), default=np.nan)

    @property
    def best(self) -> Weighted:
        return self.sets[0]

    def alternatives(self) -> list[tuple[Candidate, Candidate | None, Weighted]]:
        """Return each effect of the collection that the best set lacks, the effect of that set which it replaces (None:
        added to it), and its set.
        """
        here = {c.key: c for c in self.best.fit.hypothesis.candidates}
        found: dict[str, tuple[Candidate, Candidate | None, Weighted]] = {}
        for other in self.collection[1:]:
            missing = [c for key, c in here.items() if key not in other.key]
            for candidate in other.fit.hypothesis.candidates:
                if candidate.key not in here and candidate.key not in found:
                    place = next((m for m in missing if m.site == candidate.site), missing[0] if missing else None)
                    found[candidate.key] = candidate, place, other
        return list(found.values())


@dataclass(frozen=True, eq=False)
class Weight:
    """A set over all windows under a random force at each possible place; ``price``: log cost of fitted phases."""

    places: tuple[tuple[FittedWindows, Site], ...]
    price: float

    @property
    def log_likelihood(self) -> float:
        """Return the log likelihood at the most probable place of the random force."""
        return max(windows.log_likelihood for windows, _ in self.places) - self.price

    @property
    def random_share(self) -> float:
        """Return the random force over the force that moves the port, the largest over the places."""
        return max(windows.alone.size for windows, _ in self.places)

    @cached_property
    def left(self) -> tuple[Unnamed, ...]:
        """Return the residual force by place; nothing if its equations are singular."""
        try:
            with np.errstate(all="ignore"):
                return tuple(unnamed_force(windows, place) for windows, place in self.places)
        except SINGULAR:
            return ()

    @property
    def force(self) -> UnnamedEvidence | None:
        """Return the most probable of the significant residual forces."""
        return max((f for u in self.left for f in u.forces if f.wins), key=_gain, default=None)


def weigh(found: Found) -> Posterior:
    problem = found.problem
    ordered, generalises = _generalising(found)
    # If the error is far beyond the sensor noise, a random force predicts the next sample better than any law: then the
    # simulated windows determine the evidence, and the force only shows whether something remains.
    near = noise_ratio(problem, ordered[0].fit) < tuning.BEYOND_NOISE
    close = [v for v in ordered if ordered[0].evidence - v.evidence < tuning.FAR_BEHIND][:MOST_WEIGHED]
    close += [v for v in ordered if not v.key and v not in close]
    weights = _weights(found, ordered, close) if near else {}
    evidence = {v.key: v.evidence for v in ordered}
    if ordered[0].key in weights:
        level = max(v.evidence for v in ordered if v.key in weights)
        again = max(w.log_likelihood + v.prior for v in ordered if (w := weights.get(v.key)) is not None)
        # Sets too far behind for a second evaluation keep their distance.
        evidence = {
            v.key: w.log_likelihood + v.prior if (w := weights.get(v.key)) else v.evidence - level + again
            for v in ordered
        }
    evidence = {v.key: evidence[v.key] + _within(problem, v.fit) for v in ordered}
    forces = _forces(ordered, evidence, weights)
    if near:
        evidence = {key: value + _gain(forces.get(key)) for key, value in evidence.items()}
    ordered.sort(key=lambda v: -evidence[v.key])
    distance = _lift(problem, ordered, evidence)
    temperature = _temperature(ordered[0], weights)
    log = np.array([evidence[v.key] for v in ordered]) / temperature
    share = np.exp(log - log.max())
    share /= share.sum()
    weighed = [
        Weighted(v, float(p), evidence[v.key], distance.get(v.key, np.nan), forces.get(v.key))
        for v, p in zip(ordered, share, strict=True)
    ]
    sets = sorted(_without_undecided(problem, weighed, evidence, temperature), key=lambda w: -w.probability)
    if sets[0].key not in weights and (weight := weight_of(found, sets[0].fit)) is not None:
        weights[sets[0].key] = weight
        sets[0] = replace(sets[0], unnamed=weight.force)
    # The smallest collection that is sure, and the sets indistinguishable from the best.
    before = np.cumsum([0.0, *(w.probability for w in sets)])
    collection = tuple(
        w for w, total in zip(sets, before.tolist(), strict=False)
        if total < tuning.SURE or distance.get(w.key, np.inf) < tuning.CANNOT_TELL
    )  # fmt: skip
    return Posterior(tuple(sets), collection, generalises, weights.get(sets[0].key), temperature > TEMPERATURE)


def _within(problem: Problem, fit: Fit) -> float:
    """Return the log probability that the parameters which a fit moved beyond their tolerances lie within them."""
    # Such a parameter may also be a parameter effect: both sets predict the same, and the tolerance decides.
    each = zip(problem.nuisances, fit.z.tolist(), fit.std.tolist(), strict=False)
    return sum(n.log_within(z, std) for n, z, std in each if not n.ends[0] <= z <= n.ends[1])


def _temperature(best: Scored, weights: Mapping[Key, Weight]) -> float:
    """Return the divisor of log evidence: that of the residual force over that of a sure effect."""
    # A line over position or time does not count: it cannot come from a wrong form of another effect.
    left = weights[best.key].left if best.key in weights else ()
    smooth = (_gain(f) for u in left for f in u.forces if f.wins and not np.isfinite(f.period))
    gain = max(smooth, default=0.0)
    return max(TEMPERATURE, gain / float(np.log(tuning.SURE / (1.0 - tuning.SURE))))


def _weights(found: Found, ordered: Sequence[Scored], close: Sequence[Scored]) -> dict[Key, Weight]:
    """Evaluate the sets ``close`` to the best, and the smaller sets of the one that is best under a random force."""
    # The noise of the search has no random force, whose path an effect with a free period can follow: then the smaller
    # set is far behind in the search.
    weights: dict[Key, Weight] = {}
    plausible, tried = weights, set[Key]()
    while close:
        tried |= {v.key for v in close}
        weights |= {v.key: weight for v in close if (weight := weight_of(found, v.fit)) is not None}
        # A larger random force is not noise: it replaces a missing effect, and predicts the next sample better than any
        # law.
        plausible = {k: w for k, w in weights.items() if w.random_share < tuning.MOST_RANDOM} or weights
        rated = [(plausible[v.key].log_likelihood + v.prior, v) for v in ordered if v.key in plausible]
        best = max(rated, key=lambda r: r[0])[1] if rated else None
        close = [v for v in _one_apart(best, ordered)[0] if v.key not in tried] if best else []
    return plausible


def _lift(problem: Problem, ordered: Sequence[Scored], evidence: dict[Key, float]) -> dict[Key, float]:
    """Raise the evidence of sets indistinguishable from the best one; return refit distances from the best."""

    def raised(best: Scored, others: Sequence[Scored]) -> dict[Key, float]:
        distance = {other.key: refit_distance(problem, best.fit, other.fit) for other in others}
        for other in others:
            d = distance[other.key]
            if d < tuning.CANNOT_TELL:
                change = other.prior + _within(problem, other.fit) - best.prior - _within(problem, best.fit)
                evidence[other.key] = max(evidence[other.key], evidence[best.key] - 0.5 * d**2 + change)
        return distance

    # A set with one effect less that becomes more probable replaces the best one.
    best = ordered[0]
    while True:
        near = [v for v in ordered if v is not best and best.evidence - v.evidence <= tuning.FAR_BEHIND]
        less, exchanged = _one_apart(best, near)
        distance = {best.key: 0.0} | raised(best, less)
        ahead = max([best, *less], key=lambda v: evidence[v.key])
        if ahead is best:
            return distance | raised(best, exchanged[:MOST_RIVALS])
        best = ahead


def _without_undecided(
    problem: Problem, weighed: Sequence[Weighted], evidence: Mapping[Key, float], temperature: float
) -> list[Weighted]:
    """Drop sets with a further effect for which the records have no evidence either way."""
    # Judged by the evidence without priors, or by the refit distance; the smaller set gets their probability.
    kept: list[Weighted] = []
    for entry in sorted(weighed, key=lambda w: len(w.key)):
        plain = evidence[entry.key] - entry.visited.prior

        def silent(less: Weighted, entry: Weighted = entry, plain: float = plain) -> bool:
            if not less.key < entry.key:
                return False
            if plain - (evidence[less.key] - less.visited.prior) < NO_EVIDENCE * temperature:
                return True
            relevant = entry.probability > IRRELEVANT and less.probability > entry.probability
            return relevant and refit_distance(problem, entry.fit, less.fit) < tuning.CANNOT_TELL

        within = [k for k, w in enumerate(kept) if silent(w)]
        if within:
            k = max(within, key=lambda k: kept[k].probability)
            kept[k] = replace(kept[k], probability=kept[k].probability + entry.probability)
        else:
            kept.append(entry)
    order = {w.key: k for k, w in enumerate(weighed)}
    return sorted(kept, key=lambda w: order[w.key])


def weight_of(found: Found, fit: Fit) -> Weight | None:
    """Evaluate a set on all windows under a random force; None with too little motion."""
    problem = found.problem
    held, price = in_phase(found.held, fit, problem.records)
    # Fitted and held-out windows of a record are joined in order of time.
    records, chosen, starts = list(problem.records), list(problem.chosen), list(fit.starts)
    placed = held_out_fit(held, fit, found.noise).starts
    for record, more, theirs in zip(held.records, held.chosen, placed, strict=True):
        k = next((k for k, r in enumerate(records) if r is record), len(records))
        own, at = (chosen[k], starts[k]) if k < len(records) else (more[:0], theirs[:0])
        order = np.argsort(every := np.append(own, more))
        records[k : k + 1], chosen[k : k + 1] = [record], [every[order]]
        starts[k : k + 1] = [np.concatenate([at, theirs])[order]]
    try:
        with np.errstate(all="ignore"):
            whole = fitted_windows(problem.on(records, chosen), replace(fit, starts=tuple(starts)))
            weight = Weight(whole, price)
    except SINGULAR:
        return None
    return weight if np.isfinite(weight.log_likelihood) else None


def _forces(
    ordered: Sequence[Scored], evidence: Mapping[Key, float], weights: Mapping[Key, Weight]
) -> dict[Key, UnnamedEvidence]:
    """Return the residual force of each set; if the best set has none, only that of the empty one."""
    best = max((v.key for v in ordered), key=evidence.__getitem__)
    keys = weights if best in weights and weights[best].force is not None else {Key(), best} & weights.keys()
    return {key: force for key in keys if (force := weights[key].force) is not None}


def _gain(force: UnnamedEvidence | None) -> float:
    """Return its gain in log evidence including the prior, by the smaller of evidence and cross-validation."""
    if force is None:
        return 0.0
    return float(np.logaddexp(np.log1p(-PRIOR), np.log(PRIOR) + min(force.evidence, force.cross_validated)))


def _generalising(found: Found) -> tuple[list[Scored], bool]:
    """Return the allowed sets that do not fail on held-out data, and whether the best set does not fail."""
    plain = NoiseModel(found.noise.std, found.noise.ar[:0])

    def errors(visited: Scored) -> Array:
        phased, _ = in_phase(found.held, visited.fit, found.problem.records)
        return window_errors(phased, held_out_fit(phased, visited.fit, plain))

    refitted, left, failed = errors(found.empty), list[Scored](), list[Scored]()
    for visited in (v for v in found.sets if v.allowed):
        judged = visited.key and len(left) < MOST_WEIGHED
        (failed if judged and clearly_larger(errors(visited), refitted) else left).append(visited)
    return left, bool(left[0].key) or not any(v.evidence > found.empty.evidence for v in failed)


def _one_apart(best: Scored, others: Iterable[Scored]) -> tuple[list[Scored], list[Scored]]:
    """Return sets with one effect less or refined by one of the best set, and sets with one effect exchanged."""
    less, exchanged = [], []
    for other in others:
        out = [c for c in best.fit.hypothesis.candidates if c.key not in other.key]
        new = [c for c in other.fit.hypothesis.candidates if c.key not in best.key]
        if len(out) != 1 or len(new) > 1:
            continue
        if all(c.site == out[0].site and c.effect.id == out[0].effect.refines for c in new):
            less.append(other)
        elif not related(new[0], out[0]):
            exchanged.append(other)
    return less, exchanged
