r"""After an alarm: which of the possible changes it was, since when, and by how much in each piece.

The test's own alternatives say when it began and which changes come into question. These are then fitted in full, by
windowed simulation, to the last pieces: the model as it was before, known as well as the pieces before the change tell
it, with one change free. Their evidence gives each change and each kind of changes its probability; where even the best
one leaves more than the noise, evidence counts in units of what is left (as in `discover`). The values piece by piece
are fits of the most probable change to each piece alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.kinds import KINDS
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel, Prior
from robustlab.identification.monitoring.change_test import Alternatives, ChangeTest, log_sum, told_by
from robustlab.identification.monitoring.changes import Change, ColumnPlan
from robustlab.identification.monitoring.watch_result import Growth
from robustlab.identification.naming.first_look import Start
from robustlab.identification.naming.named_effects import INTERVAL, SURE, EffectValue, KindMember, wave_amplitude
from robustlab.identification.naming.named_kinds import Place, Places
from robustlab.identification.naming.set_search import log_prior
from robustlab.identification.tuning import NamingTuning

LEAST = 1e-6  # mean square of errors, over the noise: none leaves less
CHANCE = 3.0  # standard deviations of a sum of squares beyond which it is more than noise


@dataclass(frozen=True, eq=False)
class Before:
    """The model as it was: its effects, all standardised parameters with their covariance, and the mean square of the
    errors that it left, over the noise.
    """

    hypothesis: Hypothesis
    z: Array
    covariance: Array
    left: float


class Onset(NamedTuple):
    """Pieces at which the change began: most probable, and 95 % interval; probability that it grew."""

    piece: int
    lower: int
    upper: int
    growing: float


class Fitted(NamedTuple):
    """A change as fitted to one piece: its index (-1 of none), the fit, its log evidence, its free parameters."""

    change: int
    fit: Fit
    evidence: float
    free: int


@dataclass(frozen=True, eq=False)
class Fits:
    """The model as it was, and each change, fitted to pieces one by one, the last one first; their points."""

    none: tuple[Fitted, ...]
    each: tuple[tuple[Fitted, ...], ...]  # of each piece, in the same order of changes
    points: int

    def and_of(self, none: Fitted, each: Sequence[Fitted], points: int) -> Fits:
        """With one more piece."""
        return Fits((*self.none, none), (*self.each, tuple(each)), self.points + points)

    @property
    def evidence(self) -> Array:
        """Log evidence of each change over none, without their priors.

        The strength is free in each piece, for what grows has another one in each. How wide its prior is counts once,
        in the last piece; in every other one a free parameter costs what it gains by chance.
        """
        total = np.array([f.evidence for f in self.each[0]]) - self.none[0].evidence
        for none, row in zip(self.none[1:], self.each[1:], strict=True):
            total += [0.5 * (none.fit.cost - f.fit.cost - f.free) for f in row]
        return np.asarray(total)

    @property
    def gain(self) -> float:
        """That of the best change."""
        return float(self.evidence.max())


def onset(found: Alternatives, of: Sequence[int], plan: ColumnPlan) -> Onset:
    """When the change began, by the columns of these changes and what is unnamed."""
    columns = np.flatnonzero(np.isin(plan.of, of))
    shapes = log_sum(found.named[:, :, columns], axis=2)
    each = np.logaddexp(log_sum(shapes, axis=1), found.unnamed)
    share = np.exp(each - log_sum(each))
    order = np.argsort(found.since)
    at, below = found.since[order], np.cumsum(share[order])
    lower, upper = (int(at[min(np.searchsorted(below, q), len(at) - 1)]) for q in (0.025, 0.975))
    growing = float(np.exp(log_sum(shapes[:, 1]) - np.maximum(log_sum(shapes), np.finfo(float).min)))
    return Onset(int(found.since[np.argmax(share)]), lower, upper, growing)


def shortlist(found: Alternatives, plan: ColumnPlan, most: int) -> list[int]:
    """Indices of the changes that the test finds most probable, best first."""
    each = log_sum(found.named, axis=(0, 1))
    total: dict[int, float] = defaultdict(lambda: -math.inf)
    for k, log in zip(plan.of.tolist(), each, strict=True):
        if k >= 0:
            total[k] = float(np.logaddexp(total[k], log))
    return sorted(total, key=lambda k: -total[k])[:most]


def before_change(test: ChangeTest, hypothesis: Hypothesis, z: Array, piece: int) -> Before:
    """The model as the pieces before the change tell it; as learned where there is none."""
    if not piece:
        return Before(hypothesis, z, np.eye(len(z)), 1.0)
    step, covariance, left = told_by(test.pieces[:piece], len(z))
    return Before(hypothesis, z + step, covariance, max(left, LEAST))


def fitted(problem: Problem, before: Before, changes: Sequence[Change], k: int, noise: NoiseModel) -> Fitted:
    """A change fitted to a piece, from its best start."""
    change = changes[k]
    trials = [_trial(problem, before, change, start) for start in change.starts or (None,)]
    found = []
    for hypothesis, z, prior in trials:
        fit = problem.fit(hypothesis, noise, z, plan=FitPlan(problem.tuning.full), prior=prior)
        free = 1 if change.at is not None else len(hypothesis.candidates[-1].parameters)
        found.append(Fitted(k, fit, _evidence(fit, prior), free))
    return max(found, key=lambda f: f.evidence)


def _log_prior(change: Change, fit: Fit, tuning: NamingTuning) -> float:
    """An effect that comes in is as rare as in `discover`; that a parameter moves is taken for granted."""
    return 0.0 if change.at is not None else log_prior(Hypothesis(fit.hypothesis.candidates[-1:]), tuning)


def unchanged(problem: Problem, before: Before, noise: NoiseModel) -> Fitted:
    """The model as it was, in a piece."""
    prior = Prior(before.z, np.linalg.inv(before.covariance))
    fit = problem.fit(before.hypothesis, noise, before.z, plan=FitPlan(problem.tuning.full), prior=prior)
    return Fitted(-1, fit, _evidence(fit, prior), 0)


def _evidence(fit: Fit, prior: Prior) -> float:
    return fit.evidence + 0.5 * float(np.linalg.slogdet(prior.precision)[1])


def _trial(problem: Problem, before: Before, change: Change, start: Start | None) -> tuple[Hypothesis, Array, Prior]:
    """Hypothesis, first parameters and prior of the model with one change free."""
    if start is None:
        assert change.at is not None
        covariance = before.covariance.copy()
        covariance[change.at, change.at] += change.size**2
        return before.hypothesis, before.z, Prior(before.z, np.linalg.inv(covariance))
    kept, at, refined = list(range(len(problem.nuisances))), len(problem.nuisances), dict[str, float]()
    for there in before.hypothesis.candidates:
        own = range(at, at + len(there.parameters))
        at += len(there.parameters)
        if any(there is c for c in start.hypothesis.candidates):
            kept += own
        else:
            stds = np.sqrt(np.diag(before.covariance)[list(own)])
            refined = {p.name: p.prior.spread * std for p, std in zip(there.parameters, stds, strict=True)}
    new = start.candidate.parameters
    # What the effect has in common with the one that it refines stays as well known as it was: that is another change.
    told = [refined[p.name] / p.prior.spread if p.name in refined else 1.0 for p in new]
    common = np.array([p.name in refined for p in new])
    mean = np.append(before.z[kept], np.where(common, start.z[-len(new) :], 0.0))
    precision = np.diag(np.append(np.zeros(len(kept)), np.array(told) ** -2.0))
    precision[: len(kept), : len(kept)] = np.linalg.inv(before.covariance[np.ix_(kept, kept)])
    return start.hypothesis, np.append(before.z[kept], start.z[len(kept) :]), Prior(mean, precision)


class Named(NamedTuple):
    """What the fits say: the growth, None where nothing explains the change; the index of the best change."""

    growth: Growth | None
    sure: bool
    best: int


def named(
    problem: Problem, before: Before, changes: Sequence[Change], fits: Fits, places: Places, growing: float
) -> Named:
    """The narrowest kind that is sure, over all fitted changes, and how much of what lacks it explains."""
    logs, tuning = fits.evidence, problem.tuning
    first = fits.each[0]  # the piece at the end
    logs = logs + [_log_prior(changes[f.change], f.fit, tuning) for f in first]
    at = int(np.argmax(logs))
    best, floor = first[at], fits.points * before.left
    cost = sum(row[at].fit.cost for row in fits.each)
    left, lacking = cost - floor, sum(f.fit.cost for f in fits.none) - floor
    complete = left <= CHANCE * math.sqrt(2.0 * fits.points) * before.left
    explained = min(1.0, max(0.0, 1.0 - max(left, 0.0) / lacking)) if lacking > 0.0 else 0.0
    if logs[at] <= 0.0 or (not complete and explained < tuning.explained):
        return Named(None, False, best.change)
    coarse = max(1.0, cost / floor)
    shares = np.exp(logs / coarse - log_sum(logs / coarse))
    kinds: dict[Place, float] = defaultdict(float)
    for f, share in zip(first, shares, strict=True):
        for node in changes[f.change].above(places):
            kinds[node] += float(share)
    node = next((n for n in changes[best.change].above(places) if kinds[n] >= SURE and _says_something(n)), None)
    within = [
        (changes[f.change], float(s)) for f, s in zip(first, shares, strict=True)
        if node is None or node in changes[f.change].above(places)
    ]  # fmt: skip
    whole = sum(s for _, s in within)
    members = tuple(
        KindMember(c.effect or c.parameter, c.title, c.site.name, s / whole)
        for c, s in sorted(within, key=lambda m: -m[1])
    )
    change = changes[best.change]
    kind, place = node or ("", change.site.name)
    title = KINDS[kind].title if kind in KINDS else change.title
    now, was = value_fitted(problem, best.fit, change, coarse), None
    if change.at is not None:
        was = value_of(problem, before.hypothesis, before.z, before.covariance, change)
    growth = Growth(kind, title, place, members, change.effect, was, now, growing, explained, complete)
    return Named(growth, node is not None, best.change)


def _says_something(node: Place) -> bool:
    """False of the widest kinds, which are no name, where they have narrower ones: "a force"."""
    return node[0] != "force"


def value_of(problem: Problem, hypothesis: Hypothesis, z: Array, covariance: Array, change: Change) -> EffectValue:
    """The parameter that the change is told by, with its 95 % interval by the delta method."""
    name, unit, meaning = _told_by(problem, hypothesis, change)
    value, step = _value(problem, hypothesis, z, change), problem.tuning.step
    moved = [_value(problem, hypothesis, z + step * unit_z, change) for unit_z in np.eye(len(z))]
    slope = (np.array(moved) - value) / step
    spread = INTERVAL * math.sqrt(max(0.0, float(slope @ covariance @ slope)))
    return EffectValue(name, value, unit, value - spread, value + spread, meaning)


def value_fitted(problem: Problem, fit: Fit, change: Change, coarse: float) -> EffectValue:
    """The same of a fit that leaves ``coarse`` times the mean square of the noise."""
    return value_of(problem, fit.hypothesis, fit.z, coarse * np.linalg.pinv(fit.hessian), change)


def _told_by(problem: Problem, hypothesis: Hypothesis, change: Change) -> tuple[str, str, str]:
    """Name, unit and meaning of that parameter."""
    if change.at is not None and change.at < len(problem.nuisances):
        p = problem.plant.parameters[problem.nuisances[change.at].names[0]]
        return p.name, p.unit, p.meaning
    candidate = next(c for c in hypothesis.candidates if (c.effect.id, c.site) == (change.effect, change.site))
    p = next((p for p in candidate.parameters if p.name == change.parameter), candidate.parameters[0])
    wave = change.at is None and wave_amplitude({p.name: 0.0 for p in candidate.parameters}) is not None
    return ("amplitude", p.unit, "amplitude") if wave else (p.name, p.unit, p.meaning)


def _value(problem: Problem, hypothesis: Hypothesis, z: Array, change: Change) -> float:
    if change.at is not None and change.at < len(problem.nuisances):
        nuisance = problem.nuisances[change.at]
        return problem.plant.parameters[nuisance.names[0]].reference * nuisance.factor(float(z[change.at]))
    sets = problem.split(hypothesis, z)[1]
    own = [(c.effect.id, c.site) for c in hypothesis.candidates]
    values = sets[own.index((change.effect, change.site))]
    if change.parameter:
        return values[change.parameter]
    size = wave_amplitude(values)
    return next(iter(values.values())) if size is None else size
