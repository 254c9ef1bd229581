"""Search over sets of effects: log p(S | y) = Laplace evidence of the fitted windows + likelihood of the held-out
windows given them + a prior for each effect. All sets are evaluated under the noise and clock of the best one.

The score of an addition is the fall g^T h^-1 g of V in the linearised problem, h = G^T P G and g = G^T P r with the
change G of the residuals r at the start of its fit and the projection P off all refitted parameters; or the fall at
that start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.catalogue import KIND_OF
from robustlab.identification import constants
from robustlab.identification.greybox import noise as noises
from robustlab.identification.greybox.candidates import FINEST_LINES
from robustlab.identification.greybox.effect_fit import (
    Candidate,
    Fit,
    FitPlan,
    Hypothesis,
    Linearised,
    NoiseModel,
    Nuisance,
    Problem,
    refit_distance,
)
from robustlab.identification.greybox.residual_force import SINGULAR, UnnamedEvidence, fitted_windows, unnamed_force

BEAM = 4  # sets kept for a new noise model, and expanded
ROUGH = 6  # iterations before the noise is known, to find the best set only
PROMISING = 3.0  # least gain in log-likelihood by an addition
CLOCK_SHARE = 0.25  # of a sample: standard deviation of an input's shift
MOST_STEPS = 4  # per sample: more would resolve stiffer contacts and take more time
STEP_ERROR = 0.1  # of the noise: largest change of a residual by halved steps
MOST_EFFECTS = 4
CORRELATED = 3.0  # scatter of the windows over that of independent errors, from which an effect is missing
MOST_EXPANSIONS = 12  # limit of expanded sets
MOST_WORK = 240_000_000  # limit of simulation steps
PRIOR_EFFECT = 0.02  # of an effect at a place
PRIOR_REFINEMENT = 0.1  # of a refinement, over that of the refined effect
KEPT = 5  # effects fitted in full on top of a set
KEPT_GAINS = 2  # further gain effects: at the same cost the prior may prefer one
MOST_FALL = 2.5  # times its score: the largest expected fall of V
ALIKE, AS_GOOD = 0.99, 0.5  # share of the best start's score: above, a start is the same; below, it is dropped
MOST_STRETCHED = 0.5  # log factor; friction coefficients change more, without information on a gain
LATE = 2.0  # standard deviations of a clock, beyond which it may imitate a delay
NEGLIGIBLE = 1e-9  # of a column's own square: the column is a combination of refitted parameters

Key = frozenset[str]
Allowed = Callable[[Problem, Fit], bool]
Progress = Callable[[int, int, str], None]  # done, expected, text
Start = tuple[Hypothesis, Array]  # a set with an effect added last, and the initial parameters of their fit


def clock_nuisances(inputs: tuple[str, ...], dt: float) -> tuple[Nuisance, ...]:
    """Return a shift of each input against the outputs by a part of a sample."""
    return tuple(Nuisance(f"clock of {name}", (), CLOCK_SHARE * dt, input=name) for name in inputs)


def held_inputs(problem: Problem, fit: Fit) -> tuple[Fit, Problem]:
    """Return the fit and its problem with the hold of each input, zero-order or smooth, that fits best."""
    hold = list(problem.clock.hold or ["zoh"] * len(problem.plant.inputs))
    for k in range(len(hold)):
        other = hold.copy()
        other[k] = "smooth" if hold[k] == "zoh" else "zoh"
        there = problem.under(replace(problem.clock, hold=tuple(other)))
        again = there.fit(fit.hypothesis, fit.noise, fit.z, fit.starts, FitPlan(constants.LAST))
        if again.cost < fit.cost - 2.0 * PROMISING:
            hold, fit, problem = other, again, there
    return fit, problem


def short_steps(problem: Problem, fit: Fit) -> Problem:
    """Shorten the steps until halving them changes no residual by more than a tenth of the noise."""

    def residual(problem: Problem) -> Array:
        errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
        return np.concatenate([fit.noise.whitened(e).ravel() for e in errors])

    while (sub := problem.clock.sub or 1) < MOST_STEPS:
        halved = problem.under(replace(problem.clock, sub=2 * sub))
        if np.quantile(np.abs(residual(problem) - residual(halved)), 0.99) <= STEP_ERROR:
            break
        problem = halved
    return problem


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted set of effects."""

    fit: Fit  # under the noise model of the search
    held_out: float  # log-likelihood of the held-out windows given the fitted ones, up to a constant common to all sets
    allowed: bool  # False for a parameter effect within its tolerance, or a ripple with too few periods

    @cached_property
    def key(self) -> Key:
        return key_of(self.fit.hypothesis)

    @cached_property
    def prior(self) -> float:
        """Return the log prior of the set."""
        total = 0.0
        for candidate in self.fit.hypothesis.candidates:
            total += math.log(PRIOR_EFFECT)
            if candidate.effect.refines:
                total += math.log(PRIOR_REFINEMENT)
            # A line was chosen among all that could have been seen: over the position or, up to 0.4 / dt, over time.
            scales = candidate.scales
            if candidate.effect.spatial and scales.orders:
                total -= math.log(FINEST_LINES)
            if candidate.effect.timed and scales.lines:
                total -= math.log(max(1.0, 0.4 * scales.duration / scales.dt))
        return total

    @cached_property
    def evidence(self) -> float:
        """Return the log of the posterior probability, up to a constant common to all sets."""
        return self.fit.evidence + self.held_out + self.prior


@dataclass(frozen=True, eq=False)
class Found:
    """Result of the search."""

    sets: tuple[Scored, ...]  # all evaluated ones, the most probable first
    empty: Scored  # the set without effects: the nominal model within its tolerances
    noise: NoiseModel  # of the best set
    expanded: int  # number of expanded sets
    settled: bool  # False if the work limit ended the search
    interrupted: bool  # by the user
    # problem, held: as given, with the clock of the best set
    problem: Problem
    held: Problem


def key_of(hypothesis: Hypothesis) -> Key:
    return frozenset(c.key for c in hypothesis.candidates)


@dataclass(eq=False)
class Search:
    """State of a search: sets evaluated under the present noise, and which of them were expanded under it."""

    problem: Problem
    held: Problem
    pool: Sequence[Candidate]
    allowed: Allowed  # whether a fitted set may be the answer
    progress: Progress
    visited: dict[Key, Scored] = field(default_factory=dict)
    expanded: set[Key] = field(default_factory=set)
    reduced: set[Fit] = field(default_factory=set)  # fits from which smaller sets were fitted
    examined: set[Key] = field(default_factory=set)  # sets whose residual was searched for lines
    distances: dict[tuple[Fit, Fit], float] = field(default_factory=dict)
    expansions: int = 0
    noise: NoiseModel = field(init=False)
    noise_known: bool = False
    near: bool = False  # whether the best set leaves little beyond the sensor noise

    def run(self) -> Found:
        """Search until no set near the best one is left to expand, or the work limit is reached."""
        self.noise = noises.first_noise(self.problem)
        z = np.zeros(len(self.problem.nuisances))
        self._keep(self.problem.fit(Hypothesis(()), self.noise, z, plan=FitPlan(constants.BASE)))
        interrupted = settled = False
        try:
            self._expand(Key())
            self._update_noise()
            while not settled and self.expansions < MOST_EXPANSIONS and sum(self.problem.work) < MOST_WORK:
                best = self._confirmed()
                self._reduce(best.fit)
                if self._confirmed().key == best.key:
                    key = self._next()
                    settled = key is None
                    if key is not None:
                        self._expand(key)
                if self._confirmed().key != best.key:
                    self._update_noise()
        except KeyboardInterrupt:
            interrupted = True
        empty, order = self.visited[Key()], tuple(self._ranked())
        return Found(order, empty, self.noise, self.expansions, settled, interrupted, self.problem, self.held)

    @property
    def best(self) -> Scored:
        return max((v for v in self.visited.values() if v.allowed), key=lambda v: v.evidence)

    def _ranked(self) -> list[Scored]:
        return sorted(self.visited.values(), key=lambda v: (v.allowed, v.evidence), reverse=True)

    def _confirmed(self) -> Scored:
        """Return the best set without effects whose presence the records cannot confirm."""
        best = self.best
        while self.noise_known:
            less = [v for k, v in self.visited.items() if k < best.key and len(k) == len(best.key) - 1 and v.allowed]
            less = [
                v for v in less if best.evidence - v.evidence < constants.FAR_BEHIND and not self._distinct(best, v)
            ]
            if not less:
                break
            best = max(less, key=lambda v: v.evidence)
        return best

    def _distinct(self, one: Scored, other: Scored) -> bool:
        """Return whether the records distinguish a set from a smaller one, or outweigh the smaller one's prior."""
        if one.evidence < other.evidence:
            return False
        pair = one.fit, other.fit
        if pair not in self.distances:
            self.distances[pair] = refit_distance(self.problem, *pair)
        d = self.distances[pair]
        return d >= constants.CANNOT_TELL or 0.5 * d**2 > other.prior - one.prior

    def _next(self) -> Key | None:
        """Return the set to expand next: the best one, it without one or two of its effects, or one near it."""
        best = self._confirmed()
        while True:
            # Smaller sets are expanded before a set of several effects.
            order = self._ordered(k for k in self.visited if k < best.key and len(best.key) - len(k) <= 2)
            order.insert(len(order) if len(best.key) > 1 else 0, best.key)
            # If the errors are correlated, an effect is missing and the order of the sets has little weight.
            if self.noise.excess > CORRELATED:
                near = (k for k, v in self.visited.items() if v.allowed and len(k) <= len(best.key))
                order += self._ordered(near)[:BEAM]
            key = next((k for k in order if k not in self.expanded and len(k) < MOST_EFFECTS), None)
            if key is not None or not self._lines():
                return key

    def _ordered(self, keys: Iterable[Key]) -> list[Key]:
        return sorted(keys, key=lambda k: -self.visited[k].evidence)

    def _lines(self) -> bool:
        """Add effects at the lines in the residual of the best set to the pool; return whether there are any."""
        # In the residual of the nominal model far stronger effects can hide a line.
        best = self.best
        if best.key in self.examined:
            return False
        self.examined.add(best.key)
        try:
            with np.errstate(all="ignore"):
                left = [unnamed_force(*there) for there in fitted_windows(self.problem, best.fit)]
        except SINGULAR:
            return False
        lines = {(f.port, f.over, f.period): f for u in left for f in u.forces if f.wins and np.isfinite(f.period)}
        found = {}
        for (port, over, period), force in lines.items():
            for c in self.pool:
                if c.site.name == port and (c.effect.spatial if over == "line over position" else c.effect.timed):
                    found[c.key, period] = _at_line(c, force)
        if found:
            self.pool = [*self.pool, *found.values()]
            self.expanded = self.expanded - {best.key}
        return bool(found)

    def _reduce(self, fit: Fit) -> None:
        """Fit, from a set's parameters, the sets without one of its effects or with the effect that it refines."""
        # A fit may be in a poor minimum: an effect that only leads out of it would seem to explain something.
        if fit in self.reduced:
            return
        self.reduced.add(fit)
        _, values = self.problem.split(fit.hypothesis, fit.z)
        for k, (there, own) in enumerate(zip(fit.hypothesis.candidates, values, strict=True)):
            rest, z = without(self.problem, fit, k)
            less = self._fit(rest, z, fit, FitPlan(constants.LAST))
            self._swap(fit, less, there)
            for plain in self.pool:
                if plain.effect.id == there.effect.refines and plain.site == there.site:
                    start = {**plain.starts[0], **there.effect.unrefined(own)}
                    start = {name: start[name] for name in plain.starts[0]}
                    self._fit(*extended(self.problem, rest, z, plain, start), fit, FitPlan(constants.FULL))

    def _swap(self, fit: Fit, less: Fit, there: Candidate) -> None:
        """Fit the other effects of an effect's class in its place; ``less``: the set without it."""
        # All of them explain much of the same, so that the score of an addition does not choose between them.
        kind, key = KIND_OF.get(there.effect.id), key_of(less.hypothesis)
        pool = [c for c in self.pool if KIND_OF.get(c.effect.id) == kind and c.site == there.site and c != there]
        pool = [c for c in pool if may_be_added(c, less.hypothesis) and key | {c.key} not in self.visited]
        for hypothesis, z in promising(self.problem, less, pool, 0.0):
            self._fit(hypothesis, z, fit, FitPlan(constants.FULL))

    def _expand(self, key: Key) -> None:
        """Fit the most promising effects on top of a set."""
        base, best = self.visited[key].fit, self.best.fit
        text = f"what could be added to {' + '.join(sorted(key)) or 'the nominal model'}"
        # A set with a larger V is neither promising nor near the best set.
        ceiling = min(base.cost - 2.0 * PROMISING, best.cost + 2.0 * constants.FAR_BEHIND)
        pool = [c for c in self.pool if may_be_added(c, base.hypothesis)]
        starts = promising(
            self.problem, base, pool, base.cost - ceiling, lambda done, count: self.progress(done, count + KEPT, text)
        )
        for done, (hypothesis, z) in enumerate(starts, 1):
            most = np.inf if hypothesis.candidates[-1].effect.gain_like else ceiling
            self._fit(hypothesis, z, base, FitPlan(constants.FULL if self.noise_known else ROUGH, ceiling=most))
            self.progress(done, len(starts), f"full fits of {text}")
        self.expanded.add(key)
        self.expansions += 1
        # With dry friction in the model, a misjudged viscous friction that imitated it returns to its nominal value.
        for there in [v for v in self.visited.values() if not v.allowed and v.evidence > self.best.evidence]:
            self._reduce(there.fit)

    def _fit(self, hypothesis: Hypothesis, z: Array, near: Fit, plan: FitPlan) -> Fit:
        """Fit a set from z and the initial states of a similar fit, and keep it if it is the best one of its set."""
        fit = self.problem.fit(hypothesis, self.noise, z, near.starts, plan)
        self._keep(fit)
        return fit

    def _keep(self, fit: Fit) -> None:
        """Evaluate a fit, and keep it if it is the better one of its set."""
        # One set covers ripples of several periods: an allowed one takes precedence.
        key = key_of(fit.hypothesis)
        there = self.visited.get(key)
        if there is not None and there.allowed and fit.evidence <= there.fit.evidence:
            return
        scored = self._scored(fit)
        same = there is None or set(there.fit.hypothesis.candidates) == set(fit.hypothesis.candidates)
        if there is None or (same or scored.allowed, fit.evidence) > (same or there.allowed, there.fit.evidence):
            self.visited[key] = scored

    def _scored(self, fit: Fit) -> Scored:
        held, price = noises.in_phase(self.held, fit, self.problem.records)
        likelihood = noises.predictive if self.near else noises.as_fitted
        return Scored(fit, likelihood(held, fit, self.noise) - price, self.allowed(self.problem, fit))

    def _white(self, fit: Fit) -> bool:
        """Return whether a fit's errors are as large as its noise model predicts."""
        points = sum(e[np.isfinite(e)].size for e in self.problem.errors(fit.hypothesis, fit.z, fit.starts))
        return 0.8 < fit.cost * fit.noise.excess / points < 1.25

    def _update_noise(self) -> None:
        """Take the noise from the best set, refit the best sets under it, and drop the rest."""
        confirmed = self._confirmed().fit
        leader = self._out_of_minimum(confirmed)
        if self.noise_known and leader is confirmed and self._white(leader):
            return
        self.progress(0, 0, "the noise that the best set leaves, and the sets that may matter under it")
        self.noise_known = True
        self._take_noise(leader)
        leader, self.problem = held_inputs(self.problem, self._refitted(leader))
        self.problem = short_steps(self.problem, leader)
        self.held = self.held.under(self.problem.clock)
        leader = self._refitted(leader)
        self._take_noise(leader)
        kept = {v.key: v.fit for v in self._ranked()[:BEAM]}
        kept |= {Key(): self.visited[Key()].fit, key_of(leader.hypothesis): leader}
        # In one assignment, since the user may interrupt the search at any time.
        self.visited = {key: self._scored(self._refitted(fit)) for key, fit in kept.items()}
        self.expanded = set()

    def _out_of_minimum(self, fit: Fit) -> Fit:
        """Return the fit, or the least-squares fit from there if the errors exceed noise and it reduces them."""
        # Coloured noise from a wrong minimum keeps a fit there.
        if noises.noise_ratio(self.problem, fit) < constants.MOST_NOISE:
            return fit
        plain = noises.least_squares(self.problem, fit, self.noise, FitPlan(constants.FULL))
        return min((fit, plain), key=lambda f: float(np.log(noises.whitening(self.problem, f).std).sum()))

    def _take_noise(self, fit: Fit) -> None:
        """Take the noise model that whitens a fit's errors, of first order if they are far beyond sensor noise."""
        self.near = noises.noise_ratio(self.problem, fit) < constants.BEYOND_NOISE
        order = constants.AR_ORDER if self.near else 1
        self.noise = noises.widened(self.problem, fit, noises.whitening(self.problem, fit, order))

    def _refitted(self, fit: Fit) -> Fit:
        return self.problem.fit(fit.hypothesis, self.noise, fit.z, fit.starts, FitPlan(constants.FULL))


# --- additions and removals ------------------------------------------------------------------------------------------


def promising(
    problem: Problem, base: Fit, pool: Sequence[Candidate], wanted: float,
    report: Callable[[int, int], None] = lambda done, count: None,
) -> list[Start]:  # fmt: skip
    """Return the starts of the effects with the highest scores on top of a set, if V may fall by ``wanted``."""
    quick = problem.under(replace(problem.clock, rough=True))
    residual = quick.whitened(quick.errors(base.hypothesis, base.z, base.starts), base.noise)
    own = quick.derivatives(base)
    jobs, scores = [start for candidate in pool for start in _starts(problem, base, candidate)], list[float]()
    for done, start in enumerate(jobs, start=1):
        scores.append(_score(quick, base, residual, own, start))
        report(done, len(jobs))
    order = sorted(range(len(jobs)), key=lambda k: -scores[k])
    by_effect: dict[str, list[int]] = {}
    for k in order:
        by_effect.setdefault(jobs[k][0].candidates[-1].key, []).append(k)
    first = [key for key, own in by_effect.items() if MOST_FALL * scores[own[0]] > wanted][:KEPT]
    gain_like = {key for key, own in by_effect.items() if jobs[own[0]][0].candidates[-1].effect.gain_like}
    gains = [key for key in by_effect if key in gain_like and key not in first][:KEPT_GAINS]
    found = []
    for best, *others in (by_effect[key] for key in (*first, *gains)):
        second = [k for k in others if AS_GOOD * scores[best] < scores[k] < ALIKE * scores[best]]
        found += [jobs[k] for k in (best, *second[:1])]
    return found


def _score(
    problem: Problem, base: Fit, residual: Sequence[Array], own: Sequence[tuple[Array, Array]], start: Start
) -> float:
    """Return the expected fall of V by an addition; a single negative strength does not count."""
    hypothesis, begun = start
    simulators, step, n = problem.simulators(hypothesis), constants.STEP, len(base.z)
    parameters = hypothesis.candidates[-1].parameters

    def there(z: Array) -> list[Array]:
        return problem.whitened(problem.errors(hypothesis, z, base.starts, simulators), base.noise)

    with np.errstate(all="ignore"):
        at = there(begun)
        fall = sum(float(r.ravel() @ r.ravel() - a.ravel() @ a.ravel()) for r, a in zip(residual, at, strict=True))
        fall += float(base.z @ base.z - begun @ begun)
        columns = [[a - r for a, r in zip(at, residual, strict=True)]]
        first = len(begun) - len(parameters)
        for i, p in enumerate(parameters):
            if p.prior.kind == "linear":
                moved = there(begun + step * np.eye(len(begun))[first + i])
                columns.append([(m - a) / step for m, a in zip(moved, at, strict=True)])
        hessian, gradient = np.zeros((n + len(columns),) * 2), np.zeros(n + len(columns))
        for k, (over_z, over_x) in enumerate(own):
            changes = np.concatenate([over_z, np.stack([c[k] for c in columns], axis=2)], axis=2)
            part = Linearised.of(residual[k], changes, over_x, base.starts[k]).reduced(0.0)
            hessian, gradient = hessian + part.hessian, gradient + part.gradient
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return fall
    hessian[:n, :n] += np.eye(n)
    gradient[:n] += base.z
    size = np.diag(hessian)[n:].copy()
    solved = np.linalg.solve(hessian[:n, :n], hessian[:n, n:])
    h = hessian[n:, n:] - hessian[n:, :n] @ solved + np.diag(NEGLIGIBLE * size + np.finfo(float).tiny)
    g = gradient[n:] - solved.T @ gradient[:n]
    strength = np.linalg.solve(h, g)
    return max(fall, 0.0 if len(columns) == 1 and strength[0] > 0.0 else float(g @ strength))


def related(a: Candidate, b: Candidate) -> bool:
    """Return whether both are at one site and are, or refine, the same effect."""
    ids = [{c.effect.id, c.effect.refines} - {"", None} for c in (a, b)]
    return a.site == b.site and bool(ids[0] & ids[1])


def may_be_added(candidate: Candidate, base: Hypothesis) -> bool:
    """Exclude effects of the base, parents of its refinements, and a second coupling."""
    return not any(
        (related(candidate, there) and candidate.effect.refines != there.effect.id)
        or (candidate.effect.structural and there.effect.structural)
        for there in base.candidates
    )


def without(problem: Problem, fit: Fit, k: int) -> Start:
    """Return the hypothesis without its k-th effect, and its standardised parameters."""
    candidates, removed = fit.hypothesis.candidates, problem.slices(fit.hypothesis)[k][1]
    return Hypothesis(candidates[:k] + candidates[k + 1 :]), np.delete(fit.z, removed)


def extended(
    problem: Problem, base: Hypothesis, base_z: Array, candidate: Candidate, start: Mapping[str, float]
) -> Start:
    """Return the base with the candidate, and the initial point of its fit; a refinement replaces its parent."""
    kept, z = [], list(base_z[: len(problem.nuisances)])
    for there, own in problem.slices(base):
        if candidate.effect.refines == there.effect.id and candidate.site == there.site:
            start = {**start, **{k: v for k, v in there.values(base_z[own]).items() if k in start}}
            continue
        kept.append(there)
        z.extend(base_z[own])
    hypothesis = Hypothesis((*kept, candidate))
    z[: len(problem.nuisances)] = z[: len(problem.nuisances)] * np.array(problem.moving(hypothesis))
    return hypothesis, np.array([*z, *candidate.standardised(start)])


def _at_line(candidate: Candidate, line: UnnamedEvidence) -> Candidate:
    """Return an effect that can make a line, with starts at that line and, of a wave, at its phase."""
    # If the motion follows the wave, a fit from zero amplitude would converge to another period.
    effect = candidate.effect
    at = {"orders": (2.0 * np.pi / line.period,)} if effect.spatial else {"lines": (1.0 / line.period,)}
    scales = replace(candidate.scales, **at)
    starts = effect.starts(scales)
    if {"Ac", "As"} <= set(starts[0]):
        starts = (*starts, {**starts[0], "Ac": line.wave[0], "As": line.wave[1]})
    return Candidate(effect, candidate.site, effect.parameters(scales), starts, scales)


def _starts(problem: Problem, base: Fit, candidate: Candidate) -> list[Start]:
    """Return the starts of the effect: its own, or those that the set's parameters and clocks imitate."""
    effect, site, count = candidate.effect, candidate.site, len(problem.nuisances)

    def at(start: Mapping[str, float]) -> Start:
        return extended(problem, base.hypothesis, base.z, candidate, start)

    found = [at(start) for start in candidate.starts]
    pairs = list(zip(problem.nuisances, base.z[:count].tolist(), strict=True))
    name = candidate.parameters[0].name
    if site.kind == "parameter" and effect.scale:  # the refitted factor
        found += [at({name: n.factor(z)}) for n, z in pairs if n.label == site.name]
    elif effect.gain_like and site.kind != "joint":  # the factor of the most changed parameter; all at their values
        stretch = [n.spread * z for n, z in pairs if n.names and not n.additive]
        likely = max(stretch, key=lambda s: abs(s) if abs(s) < MOST_STRETCHED else 0.0, default=0.0)
        for sign in (1.0, -1.0) if pairs else ():
            found.append(at({name: float(np.exp(sign * likely))}))
            found[-1][1][:count] = 0.0
    if effect.delay:  # the shift of an input's clock, which is reset
        for k, (clock, z) in enumerate(pairs):
            if clock.input and z > LATE and (site.kind != "input" or clock.input == site.name):
                found.append(at({effect.delay: clock.spread * z}))
                found[-1][1][k] = 0.0
    return found
