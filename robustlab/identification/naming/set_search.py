"""The search over sets of effects: log p(S | y) = Laplace's evidence of the fitted windows + the likelihood of those
held out given them + a prior for each effect. All sets are judged under the noise and the clock of the best one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import (
    Candidate,
    Clock,
    Fit,
    FitPlan,
    Hypothesis,
    NoiseModel,
    Nuisance,
    Problem,
    refit_distance,
)
from robustlab.identification.hypotheses.noise import (
    as_fitted,
    careful,
    first_noise,
    in_phase,
    least_squares,
    noise_ratio,
    predictive,
    whitening,
)
from robustlab.identification.hypotheses.unnamed_force import UNTOLD, UnnamedEvidence, fitted_windows, unnamed_force
from robustlab.identification.naming.first_look import Start, akin, extended, may_follow, promising, stretched, without
from robustlab.identification.naming.held_out import strained

WORKERS = 2
ROUGH_FITS = 4  # full fits before the noise is known, of fewer iterations: they only have to find a leader
ROUGH_FULL = 6
CLOCK_SHARE = 0.25  # of a sample: standard deviation of an input's shift
MOST_STEPS = 4  # a sample: more follow stiffer contacts and take more time
STEP_ERROR = 0.1  # of the noise, by which half as long steps may change a residual
MOST_EFFECTS = 4
BEGINNINGS = 3  # single effects from which sets are built where something is missing
IN_ONE_PIECE = 3.0  # scatter of the windows, over that of independent errors, from which something is
MOST_EXPANSIONS = 12  # sets to which effects are added before the search is called unfinished
MOST_WORK = 240_000_000  # steps of simulation, after which no further set is expanded
PRIOR_EFFECT = 0.02  # of an effect at a place
PRIOR_REFINEMENT = 0.1  # of a refinement, over that of the effect it refines
LOOKED_ELSEWHERE = 200.0  # periods among which the one of a ripple was found
OUT_OF_SIGHT = 100.0  # times the V that would come near a set that leaves only noise, after two looks


def clock_nuisances(inputs: tuple[str, ...], dt: float) -> tuple[Nuisance, ...]:
    """A shift of each input against the outputs, a part of a sample: clocks are not told more exactly than that."""
    return tuple(Nuisance(f"clock of {name}", (), CLOCK_SHARE * dt, input=name) for name in inputs)


def held_inputs(problem: Problem, fit: Fit) -> tuple[Fit, Problem]:
    """The fit and its problem under the hold of each input that explains the records best: held, or smooth."""
    hold = list(problem.clock.hold or ["zoh"] * len(problem.plant.inputs))
    for k in range(len(hold)):
        other = hold.copy()
        other[k] = "smooth" if hold[k] == "zoh" else "zoh"
        there = problem.under(replace(problem.clock, hold=tuple(other)))
        again = there.fit(fit.hypothesis, fit.noise, fit.z, fit.starts, FitPlan(tuning.LAST))
        if again.cost < fit.cost - 2.0 * tuning.PROMISING:
            hold, fit, problem = other, again, there
    return fit, problem


def step_error(problem: Problem, fit: Fit) -> float:
    """Change of residuals, in standard deviations of the noise, when every step is halved: 99 in 100 change by less."""
    halved = problem.under(Clock(2 * (problem.clock.sub or 1), problem.clock.hold))
    pairs = zip(
        problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise),
        halved.whitened(halved.errors(fit.hypothesis, fit.z, fit.starts), fit.noise),
        strict=True,
    )
    return float(np.quantile(np.concatenate([np.abs(a - b).ravel() for a, b in pairs]), 0.99))


def short_steps(problem: Problem, fit: Fit) -> Problem:
    """The problem with steps so short that halving them changes no residual by more than a tenth of the noise."""
    while (problem.clock.sub or 1) < MOST_STEPS and step_error(problem, fit) > STEP_ERROR:
        problem = problem.under(replace(problem.clock, sub=2 * (problem.clock.sub or 1)))
    return problem


Key = frozenset[str]
Allowed = Callable[[Problem, Fit], bool]
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Visited:
    """A set of effects as it was fitted."""

    fit: Fit  # under the noise model of the search
    prior: float  # log prior of the set
    held_out: float  # log-likelihood of the held-out windows given the fitted ones, up to a constant common to all sets
    # false where it may not be the answer: a parameter within its tolerance, a ripple of which too little is seen
    allowed: bool

    @property
    def key(self) -> Key:
        """Keys of its effects."""
        return key_of(self.fit.hypothesis)

    @property
    def evidence(self) -> float:
        """Log of the posterior probability, up to a constant common to all sets."""
        return self.fit.evidence + self.held_out + self.prior


@dataclass(frozen=True, eq=False)
class Found:
    """What the search ended with."""

    sets: tuple[Visited, ...]  # all that were judged, the most probable first
    empty: Visited  # the set without any effect, the nominal model within its tolerances
    noise: NoiseModel  # the noise model under which all were judged
    expanded: int  # number of sets that were expanded; ``settled`` is False where the budget of them ended the search
    settled: bool
    interrupted: bool  # true where the user ended it
    # problem, held: as they were given, with the clock under which all was simulated
    problem: Problem
    held: Problem

    @property
    def best(self) -> Visited:
        """The most probable set."""
        return self.sets[0]


def key_of(hypothesis: Hypothesis) -> Key:
    """Keys of the effects of a set, in no order."""
    return frozenset(c.key for c in hypothesis.candidates)


def log_prior(hypothesis: Hypothesis) -> float:
    """Log prior of a set."""
    total = 0.0
    for candidate in hypothesis.candidates:
        total += math.log(PRIOR_EFFECT)
        if candidate.effect.refines:
            total += math.log(PRIOR_REFINEMENT)
        if candidate.effect.spatial and candidate.scales.orders:
            total -= math.log(LOOKED_ELSEWHERE)
    return total


def _at_line(candidate: Candidate, line: UnnamedEvidence) -> Candidate:
    """An effect that makes a line, begun at that line; of a wave with its phase, too."""
    # Where the motion follows the wave a fit that begins without any comes to another period.
    effect = candidate.effect
    at = {"orders": (2.0 * np.pi / line.period,)} if effect.spatial else {"lines": (1.0 / line.period,)}
    scales = replace(candidate.scales, **at)
    starts = effect.starts(scales)
    if {"Ac", "As"} <= set(starts[0]):
        starts = (*starts, {**starts[0], "Ac": line.wave[0], "As": line.wave[1]})
    return Candidate(effect, candidate.site, effect.parameters(scales), starts, scales)


def search_sets(
    problem: Problem, held: Problem, pool: Sequence[Candidate], allowed: Allowed, progress: Progress
) -> Found:
    """Search the sets of effects of ``pool``; ``allowed``: whether a fitted set may be the answer."""
    with ThreadPoolExecutor(WORKERS) as workers:
        return _Search(problem, held, pool, allowed, progress, workers).run()


@dataclass(eq=False)
class _Search:
    """State of a search: sets visited under the present noise, and which of them were expanded under it."""

    problem: Problem
    held: Problem
    pool: Sequence[Candidate]
    allowed: Allowed
    progress: Progress
    workers: Executor
    visited: dict[Key, Visited] = field(default_factory=dict)
    expanded: set[Key] = field(default_factory=set)
    looked: dict[Key, dict[str, Fit]] = field(default_factory=dict)
    asked: set[Key] = field(default_factory=set)
    again: set[Key] = field(default_factory=set)
    alone: bool = False  # whether every single effect was fitted in full
    distances: dict[tuple[Fit, Fit], float] = field(default_factory=dict)
    explained: dict[Fit, bool] = field(default_factory=dict)
    expansions: int = 0
    noise: NoiseModel = field(init=False)
    sharpened: bool = False
    near: bool = False  # whether the leader leaves little beyond the sensors' noise

    def run(self) -> Found:
        self.noise = first_noise(self.problem)
        z = np.zeros(len(self.problem.nuisances))
        empty = self.problem.fit(Hypothesis(()), self.noise, z, plan=FitPlan(tuning.BASE))
        self._visit(empty)
        interrupted = settled = False
        try:
            self._expand(Key())
            self._sharpen()
            while not self._used_up():
                best = self._told().key
                if self._stretched() and self._singles():
                    self._sharpen()
                    continue
                key = self._next()
                if self._told().key != best:  # a smaller set that had to be fitted first
                    self._sharpen()
                    continue
                if key is None and (self._lines() or (len(self._whole().key) > 1 and self._singles())):
                    key = self._next()
                if key is None:
                    settled = True
                    break
                self._expand(key)
                if self._told().key != best:
                    self._sharpen()
        except KeyboardInterrupt:
            interrupted = True
        order = tuple(sorted(self.visited.values(), key=lambda v: (v.allowed, v.evidence), reverse=True))
        empty = self.visited[Key()]
        return Found(order, empty, self.noise, self.expansions, settled, interrupted, self.problem, self.held)

    def _used_up(self) -> bool:
        """Whether the search ends here; a set that leaves only noise is still asked whether all of it is needed."""
        work, most = sum(self.problem.work), MOST_WORK
        if self.expansions >= MOST_EXPANSIONS or work >= 2 * most:
            return True
        return work >= most and not self._explains(self._told())

    @property
    def best(self) -> Visited:
        return max((v for v in self.visited.values() if v.allowed), key=lambda v: v.evidence)

    def _told(self) -> Visited:
        """The best set, without effects that these records do not tell from none: nothing is built on those."""
        told = self.best
        while self.sharpened:
            less = [v for k, v in self.visited.items() if k < told.key and len(k) == len(told.key) - 1 and v.allowed]
            less = [v for v in less if told.evidence - v.evidence < tuning.FAR_BEHIND and not self._tells(told, v)]
            if not less:
                break
            told = max(less, key=lambda v: v.evidence)
        return told

    def _whole(self) -> Visited:
        """The set around which the search goes on: the one to build on, or one effect of it that leaves only noise."""
        told = self._told()
        alone = [v for k, v in self.visited.items() if len(k) == 1 and k < told.key and v.allowed]
        enough = [v for v in alone if self._explains(v)]
        return max(enough, key=lambda v: v.evidence, default=told)

    def _tells(self, one: Visited, other: Visited) -> bool:
        """Whether the records tell a set from a smaller one by more than the smaller one's prior is ahead."""
        if one.evidence < other.evidence:
            return False
        pair = one.fit, other.fit
        if pair not in self.distances:
            self.distances[pair] = refit_distance(self.problem, *pair)
        d = self.distances[pair]
        return d >= tuning.CANNOT_TELL or 0.5 * d**2 > other.prior - one.prior

    def _next(self) -> Key | None:
        """The set to expand next: the best one, else what remains of it without one or two of its effects."""
        # Where the errors hang together which effect came first has little weight: the next single effects are
        # expanded, too, until two of them lead to the best set.
        told = self._told().key
        whole = self._whole()
        best = whole.key
        begun = [k for k in self.expanded if len(k) == 1]
        wanted = bool(begun) and len(begun) < BEGINNINGS and self.noise.excess > IN_ONE_PIECE
        if wanted and sum(k <= best for k in begun) < 2 and not self._explains(whole):
            done = [c for k in begun for c in self.visited[k].fit.hypothesis.candidates]
            others = [
                v for k, v in self.visited.items() if len(k) == 1 and k not in begun and v.allowed
                and not any(akin(v.fit.hypothesis.candidates[0], c) for c in done)
            ]  # fmt: skip
            if others:
                return max(others, key=lambda v: v.evidence).key
        if isinstance(self.problem.plant, NonlinearPlant):  # dear to look beyond a set: is all of it needed?
            for key in (best - {one} for one in sorted(best) if len(best) > 1):
                if key not in self.visited:
                    self._without(whole.fit, key)
            if self._told().key != told:
                return self._next()
        if len(best) < MOST_EFFECTS and best not in self.expanded:
            return best
        sizes = [len(best) - away for away in (1, 2) if away <= len(best) <= 3 or away == 1 <= len(best)]
        smaller = [Key(part) for size in sizes for part in itertools.combinations(sorted(best), size)]
        self._unrefined(whole.fit)
        for key in smaller:
            if key not in self.visited:
                self._without(whole.fit, key)
        if self._told().key != told:
            return self._next()
        left = [k for k in smaller if k not in self.expanded]
        return max(left, key=lambda k: self.visited[k].evidence, default=None)

    def _explains(self, told: Visited) -> bool:
        """Whether a set leaves no more than noise: then no other beginning can lead further."""
        # Not with parameters beyond their tolerances: those stand for something that is missing.
        return self._as_noise(told) and not strained(self.problem, told.fit)

    def _as_noise(self, told: Visited) -> bool:
        """Whether a set leaves no more than noise."""
        if not self.sharpened:
            return False
        if told.fit not in self.explained:
            try:
                with np.errstate(all="ignore"):
                    self.explained[told.fit] = fitted_windows(self.problem, told.fit)[0][0].as_noise
            except UNTOLD:
                self.explained[told.fit] = False
        return self.explained[told.fit]

    def _lines(self) -> bool:
        """Whether the best set leaves lines; effects that make such lines are then tried there."""
        # Beside what is far stronger a line does not show in the force that the nominal model lacks.
        best = self.best
        if best.key in self.asked:
            return False
        self.asked.add(best.key)
        try:
            with np.errstate(all="ignore"):
                left = [unnamed_force(*there) for there in fitted_windows(self.problem, best.fit)]
        except UNTOLD:
            return False
        told = {(f.port, f.over, f.period): f for u in left for f in u.forces if f.wins and np.isfinite(f.period)}
        found = {}
        for (port, over, period), force in told.items():
            for c in self.pool:
                if c.site.name == port and (c.effect.spatial if over == "line over position" else c.effect.timed):
                    found[c.key, period] = _at_line(c, force)
        if found:
            self.pool = [*self.pool, *found.values()]
            self.looked, self.expanded = {}, self.expanded - {best.key}
        return bool(found)

    def _stretched(self) -> bool:
        """Whether the best set leaves only noise, but with parameters beyond their tolerances."""
        return self._as_noise(self._told()) and not self._explains(self._told())

    def _singles(self) -> bool:
        """Fit every single effect in full under the present noise, once; whether that changes the best set."""
        # A short look may miss one effect that explains by itself what two or three others share.
        told, empty = self._told().key, self.visited[Key()].fit
        if self.alone or isinstance(self.problem.plant, NonlinearPlant):
            return False
        self.alone = True
        pool = [c for c in self.pool if may_follow(c, empty.hypothesis)]

        def said(done: int, expected: int) -> None:
            self.progress(done, expected, "every single effect in full")

        for fit in single_fits(self.problem, self._told().fit, pool, self._ceiling(empty), self.workers, said):
            self._visit(fit)
        return self._told().key != told

    def _unrefined(self, fit: Fit) -> None:
        """Fit a set with what a refinement refines in its place: the simpler name must have been tried."""
        # If that lies far behind, once more from where the refinement is: a fit may rest in a poor minimum.
        for k, refined in enumerate(fit.hypothesis.candidates):
            plain = next(
                (c for c in self.pool if c.effect.id == refined.effect.refines and c.site == refined.site), None
            )
            if plain is None:
                continue
            simpler = key_of(fit.hypothesis) - {refined.key} | {plain.key}
            there = self.visited.get(simpler)
            if there and (simpler in self.again or fit.evidence - there.fit.evidence < tuning.FAR_BEHIND):
                continue
            self.again.add(simpler)
            rest, z = without(self.problem, fit, k)
            _, values = self.problem.split(fit.hypothesis, fit.z)
            start = refined.effect.unrefined(values[k])
            start = {**plain.starts[0], **{n: v for n, v in start.items() if n in plain.starts[0]}}
            hypothesis, z = extended(self.problem, rest, z, plain, start)
            self._visit(self.problem.fit(hypothesis, self.noise, z, fit.starts, FitPlan(tuning.FULL)))

    def _without(self, fit: Fit, key: Key) -> None:
        """Fit a set again with only the effects of ``key``."""
        while len(fit.hypothesis.candidates) > len(key):
            k = next(k for k, c in enumerate(fit.hypothesis.candidates) if c.key not in key)
            hypothesis, z = without(self.problem, fit, k)
            fit = self.problem.fit(hypothesis, self.noise, z, fit.starts, FitPlan(tuning.LAST))
        self._visit(fit)

    def _expand(self, key: Key) -> None:
        """Fit the most promising effects on top of a set."""
        base = self.visited[key].fit
        open_ones = [c for c in self.pool if may_follow(c, base.hypothesis)]
        text = " + ".join(sorted(key)) or "the nominal model"

        def said(done: int, expected: int) -> None:
            self.progress(done, expected + tuning.KEPT_LAST, f"what could be added to {text}")

        known = self.looked.setdefault(key, {})
        best = self.best.fit
        # Of a set that something else is missing from, the parameters stand for that, and are no finding.
        wrong = stretched(self.problem, base, open_ones) if self.sharpened and key == self._told().key else []
        asked = {start.candidate.key for start in wrong}
        open_ones = [c for c in open_ones if c.key not in asked]
        # Where something else leaves only noise, what is far from that after two looks would not come near it.
        far = OUT_OF_SIGHT if key != self._told().key and self._explains(self._told()) else np.inf
        starts = [*wrong, *promising(self.problem, base, best, open_ones, known, self.workers, said, far)]
        if not self.sharpened:
            starts = starts[:ROUGH_FITS]
        ceiling = self._ceiling(base)

        def full(start: Start) -> Fit:
            gain = start.candidate.effect.gain_like
            rounds = tuning.FULL if self.sharpened else ROUGH_FULL
            plan = FitPlan(rounds, 0.05, ceiling=np.inf if gain else ceiling)
            return self.problem.fit(start.hypothesis, self.noise, start.z, start.starts or base.starts, plan)

        self.progress(0, len(starts), f"full fits of what could be added to {text}")
        for done, fit in enumerate(self.workers.map(full, starts), 1):
            self._visit(fit)
            self.progress(done, len(starts), f"full fits of what could be added to {text}")
        self.expanded.add(key)
        self.expansions += 1
        self._from_children(key)
        self._within_tolerance()

    def _ceiling(self, base: Fit) -> float:
        """V that what is added to a set must come to, or it is neither promising nor near the best set."""
        return min(base.cost - 2.0 * tuning.PROMISING, self.best.fit.cost + 2.0 * tuning.FAR_BEHIND)

    def _within_tolerance(self) -> None:
        """Fit promising sets that may not be the answer without the parameter that is within its tolerance."""
        # Beside dry friction a misjudged viscous one that stood for it goes back to its nominal value.
        for there in [v for v in self.visited.values() if not v.allowed and v.evidence > self.best.evidence]:
            for candidate in there.fit.hypothesis.candidates:
                less = there.key - {candidate.key}
                if candidate.site.kind == "parameter" and less not in self.visited:
                    self._without(there.fit, less)

    def _from_children(self, key: Key) -> None:
        """Fit a set once more from where its best extension is."""
        # A fit may rest in a local minimum; an effect that only leads out of it would seem to explain something.
        base = self.visited[key].fit
        leader = min((v.fit for v in self.visited.values()), key=lambda f: f.cost)
        kept = base.hypothesis.candidates
        if leader.hypothesis.candidates[: len(kept)] != kept or leader is base:
            return
        again = self.problem.fit(
            base.hypothesis, self.noise, leader.z[: len(base.z)], leader.starts, FitPlan(tuning.SECOND)
        )
        if again.cost < base.cost:
            self._visit(again)

    def _visit(self, fit: Fit) -> None:
        """Judge a fit, and keep it where it is the better one of its set."""
        # One set covers ripples of several periods: one that may be the answer is not lost to one that may not.
        key = key_of(fit.hypothesis)
        there = self.visited.get(key)
        if there is not None and there.allowed and fit.evidence <= there.fit.evidence:
            return
        judged = self._judged(fit)
        same = there is None or set(there.fit.hypothesis.candidates) == set(fit.hypothesis.candidates)
        if there is None or (same or judged.allowed, fit.evidence) > (same or there.allowed, there.fit.evidence):
            self.visited[key] = judged

    def _judged(self, fit: Fit) -> Visited:
        """What a set is worth; of a model that is far off nothing is granted for how well its fit says it knows."""
        held, price = in_phase(self.held, fit, self.problem.records)
        seen = predictive(held, fit, self.noise) if self.near else as_fitted(held, fit, self.noise)
        allowed = self.allowed(self.problem, fit)
        return Visited(fit, log_prior(fit.hypothesis), seen - price, allowed)

    def _white(self, fit: Fit) -> bool:
        """Whether a fit's errors are as large as its noise model says."""
        points = sum(e[np.isfinite(e)].size for e in self.problem.errors(fit.hypothesis, fit.z, fit.starts))
        return 0.8 < fit.cost * fit.noise.excess / points < 1.25

    def _sharpen(self) -> None:
        """Take the noise from the best set, fit again all that may still matter under it, and forget the rest."""
        leader = self._freed(self._told().fit)
        if self.sharpened and leader is self._told().fit and self._white(leader):
            return
        self.progress(0, 0, "the noise that the best set leaves, and the sets that may matter under it")
        self.sharpened = True
        self.noise = self._noise_of(leader)
        leader = self._clocked(self._again(leader))
        self.noise = self._noise_of(leader)
        ordered = sorted(self.visited.values(), key=lambda v: (v.allowed, v.evidence), reverse=True)
        ordered = ordered[:ROUGH_FITS]
        kept = {v.key: v.fit for v in ordered} | {Key(): self.visited[Key()].fit}
        kept[key_of(leader.hypothesis)] = leader
        again = self.workers.map(self._again, kept.values())
        # At once, for the user may end the search at any time.
        self.visited, self.expanded = {key_of(fit.hypothesis): self._judged(fit) for fit in again}, set()

    def _freed(self, fit: Fit) -> Fit:
        """The fit, or the least-squares fit from there if the errors are beyond noise and that leaves less."""
        # Coloured noise that was taken from a wrong minimum holds a fit there.
        if noise_ratio(self.problem, fit) < tuning.MOST_NOISE:
            return fit
        plain = least_squares(self.problem, fit, self.noise, FitPlan(tuning.FULL, 0.05))
        return min((fit, plain), key=lambda f: float(np.log(whitening(self.problem, f).std).sum()))

    def _noise_of(self, fit: Fit) -> NoiseModel:
        """What makes a fit's errors white; of first order only where they are far beyond the sensors' noise."""
        self.near = noise_ratio(self.problem, fit) < tuning.BEYOND_NOISE
        return careful(self.problem, fit, whitening(self.problem, fit, tuning.AR_ORDER if self.near else 1))

    def _again(self, fit: Fit) -> Fit:
        """The set fitted under the present noise and clock, from where it is."""
        # Parameters beyond their tolerances may be held there by this noise: a second fit begins with nominal ones.
        plan = FitPlan(tuning.FULL, 0.05)
        stands = self.problem.fit(fit.hypothesis, self.noise, fit.z, fit.starts, plan)
        if not strained(self.problem, stands):
            return stands
        nominal = stands.z.copy()
        nominal[: len(self.problem.nuisances)] = 0.0
        anew = self.problem.fit(fit.hypothesis, self.noise, nominal, plan=plan)
        return min(stands, anew, key=lambda f: f.cost)

    def _clocked(self, fit: Fit) -> Fit:
        """The best set under the input holds that suit it and steps that are short enough for it."""
        fit, self.problem = held_inputs(self.problem, fit)
        self.problem = short_steps(self.problem, fit)
        self.held = self.held.under(self.problem.clock)
        return self._again(fit)


TIMES = 10.0  # the V of the best set under the sensors' noise, which a single effect that explains as much comes near
Said = Callable[[int, int], None]
Begin = tuple[Hypothesis, Array, Sequence[Array]]  # what is fitted, its standardised parameters, the windows' starts


def single_fits(
    problem: Problem, best: Fit, pool: Sequence[Candidate], ceiling: float, workers: Executor, said: Said
) -> Iterator[Fit]:
    """Fits of single effects of ``pool`` under the noise of the ``best`` set, those that may come below ``ceiling``."""
    # Under small coloured noise the cost is rugged: each is fitted under the sensors' white noise first.
    wide, nominal = first_noise(problem), np.zeros(len(problem.nuisances))
    jobs = [(c, start) for c in pool for start in c.starts]
    near = problem.fit(best.hypothesis, wide, best.z, best.starts, FitPlan(ROUGH_FULL, tuning.ROUGH)).cost
    most = TIMES * near + 2.0 * tuning.FAR_BEHIND

    def smooth(job: tuple[Candidate, Mapping[str, float]]) -> Fit:
        candidate, start = job
        z = np.append(nominal, candidate.standardised(start))
        return problem.fit(Hypothesis((candidate,)), wide, z, plan=FitPlan(ROUGH_FULL, tuning.ROUGH, ceiling=most))

    lowest: dict[str, Fit] = {}
    for done, fit in enumerate(workers.map(smooth, jobs), 1):
        key = fit.hypothesis.candidates[0].key
        if key not in lowest or fit.cost < lowest[key].cost:
            lowest[key] = fit
        said(done, len(jobs) + tuning.KEPT_LAST)
    first = sorted((f for f in lowest.values() if f.cost < most), key=lambda f: f.cost)[: tuning.KEPT_LAST]

    def full(begin: Begin) -> Fit:
        hypothesis, z, starts = begin
        whole = problem.fit(hypothesis, wide, z, starts, FitPlan(tuning.FULL, 0.05))
        return problem.fit(hypothesis, best.noise, whole.z, whole.starts, FitPlan(tuning.FULL, 0.05, ceiling=ceiling))

    plain = list(workers.map(full, ((f.hypothesis, f.z, f.starts) for f in first)))
    yield from plain
    yield from workers.map(full, _refined_fits(problem, plain, pool))


def _refined_fits(problem: Problem, fits: Sequence[Fit], pool: Sequence[Candidate]) -> Iterator[Begin]:
    """Where what refines the effects of these fits begins: where they are."""
    for fit in fits:
        (there,) = fit.hypothesis.candidates
        for candidate in pool:
            if candidate.effect.refines == there.effect.id and candidate.site == there.site:
                for start in candidate.starts:
                    yield *extended(problem, fit.hypothesis, fit.z, candidate, start), fit.starts
