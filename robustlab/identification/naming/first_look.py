"""Which effects are worth a full fit on top of a set: two short fits of every one, on few windows and then on some.

Where there are many effects their gain g^T h^-1 g is computed first from a few simulations: h = G^T P G, g = G^T P r
with the change G of the residuals r by an effect, and P the projection off all that the set refits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, FitPlan, Hypothesis, Linearised, Problem

FIRST = 4
FIRST_WINDOWS = 12  # that the first round looks at, and the second: more judge better and take more time
SECOND_WINDOWS = 18
MOST_SCORED = 30  # effects of a nonlinear plant that enter the first round: more find what no score shows
KEPT_SECOND = 10  # hypotheses that enter the second round, and the last
KEPT_GAINS = 2  # wrong gains beside them: at the same cost the prior may prefer one
MOST_STRETCHED = 0.5  # log factor; friction coefficients stretch further and say nothing of a gain
STARTS = 2  # of an effect, the best by what they promise, from which it is fitted where there are many effects
LATE = 2.0  # standard deviations of a clock, beyond which it may stand for a delay
NEGLIGIBLE = 1e-9  # of a column's own square: what the set refits makes all of it


@dataclass(frozen=True, eq=False)
class Start:
    """An effect on top of a set, the parameters where a fit of both begins, and its window starts."""

    candidate: Candidate
    hypothesis: Hypothesis
    z: Array
    starts: Sequence[Array] | None = None


def best_scored(
    problem: Problem, base: Fit, starts: Sequence[Start], most: int, workers: Executor, said: Callable[[int, int], None]
) -> list[Start]:
    """The best starts of at most so many effects, those that promise most; all where there are no more."""
    if len({s.candidate.key for s in starts}) <= most:
        return list(starts)
    residual = problem.whitened(problem.errors(base.hypothesis, base.z, base.starts), base.noise)
    own = problem.derivatives(base)
    gains: list[float] = []
    for done, gain in enumerate(workers.map(lambda s: _gain(problem, base, residual, own, s), starts), start=1):
        gains.append(gain)
        said(done, len(starts))
    order = sorted(range(len(starts)), key=lambda k: -gains[k])
    kept: dict[str, list[int]] = {}
    for k in order:
        key = starts[k].candidate.key
        if key in kept or len(kept) < most:
            kept.setdefault(key, []).append(k)
    return [starts[k] for k in sorted(k for own in kept.values() for k in own[:STARTS])]


def _columns(parts: Sequence[Sequence[Array]], k: int, like: Array) -> Array:
    return np.stack([p[k] for p in parts], axis=2) if parts else np.zeros((*like.shape, 0))


def effect_columns(
    problem: Problem, base: Fit, residual: Sequence[Array], start: Start
) -> tuple[list[Array], list[list[Array]]]:
    """The change of a set's residuals by an effect where its fit begins, and its linear derivatives."""
    simulators = problem.simulators(start.hypothesis)

    def there(z: Array) -> list[Array]:
        return problem.whitened(problem.errors(start.hypothesis, z, base.starts, simulators), base.noise)

    at, step = there(start.z), tuning.STEP
    first = len(start.z) - len(start.candidate.parameters)
    slopes = []
    for i, p in enumerate(start.candidate.parameters):
        if p.prior.kind == "linear":
            moved = there(start.z + step * np.eye(len(start.z))[first + i])
            slopes.append([(m - a) / step for m, a in zip(moved, at, strict=True)])
    return [a - r for a, r in zip(at, residual, strict=True)], slopes


def _gain(
    problem: Problem, base: Fit, residual: Sequence[Array], own: Sequence[tuple[Array, Array]], start: Start
) -> float:
    """Fall of V that the effect promises; 0 where it would have to be of negative strength."""
    with np.errstate(all="ignore"):
        change, slopes = effect_columns(problem, base, residual, start)
        changes, linear = [change, *slopes], bool(slopes)
        n = len(base.z)
        hessian, gradient = np.zeros((n + len(changes),) * 2), np.zeros(n + len(changes))
        for k, (over_z, over_x) in enumerate(own):
            columns = np.concatenate([over_z, _columns(changes, k, residual[k])], axis=2)
            part = Linearised.of(residual[k], columns, over_x, base.starts[k]).reduced(0.0)
            hessian, gradient = hessian + part.hessian, gradient + part.gradient
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return 0.0
    hessian[:n, :n] += np.eye(n)
    gradient[:n] += base.z
    size = np.diag(hessian)[n:].copy()
    solved = np.linalg.solve(hessian[:n, :n], hessian[:n, n:])
    h = hessian[n:, n:] - hessian[n:, :n] @ solved + np.diag(NEGLIGIBLE * size + np.finfo(float).tiny)
    g = gradient[n:] - solved.T @ gradient[:n]
    strength = np.linalg.solve(h, g)
    return 0.0 if not linear and strength[0] > 0.0 else float(g @ strength)


def stretched(problem: Problem, base: Fit, pool: Sequence[Candidate]) -> list[Start]:
    """Parameters that a set's refit took beyond their tolerances as effects, and delays in the place of its clocks."""
    # Their fits begin with the errors of the set, exactly: no look at a few windows decides about them.
    found = [start for candidate in pool for start in _handed_over(problem, base, candidate)]
    for nuisance, z in zip(problem.nuisances, base.z, strict=False):
        low, high = nuisance.ends
        if low <= z <= high:
            continue
        for candidate in pool:
            if candidate.site.kind == "parameter" and candidate.site.name == nuisance.label:
                for start in _as_refitted(problem, base, candidate):
                    hypothesis, there = extended(problem, base.hypothesis, base.z, candidate, start)
                    found.append(Start(candidate, hypothesis, there))
    return found


def _handed_over(problem: Problem, base: Fit, candidate: Candidate) -> list[Start]:
    """For a delay: the lateness that the set has given to an input's clock, and that clock back at its own time."""
    if not candidate.effect.delay:
        return []
    clocks = [(k, n) for k, n in enumerate(problem.nuisances) if n.input and base.z[k] > LATE]
    if candidate.site.kind == "input":
        clocks = [(k, n) for k, n in clocks if n.input == candidate.site.name]
    found = []
    for k, clock in clocks:
        start = {candidate.effect.delay: clock.spread * float(base.z[k])}
        hypothesis, z = extended(problem, base.hypothesis, base.z, candidate, start)
        z[k] = 0.0
        found.append(Start(candidate, hypothesis, z))
    return found


def akin(a: Candidate, b: Candidate) -> bool:
    """Whether they are one effect at one place, or one refines the other or what the other refines."""
    ids = [{c.effect.id, c.effect.refines} - {"", None} for c in (a, b)]
    return a.site == b.site and bool(ids[0] & ids[1])


def may_follow(candidate: Candidate, base: Hypothesis) -> bool:
    """An effect already there, the parent of a refinement that is there, or a second coupling, is not looked for."""
    for there in base.candidates:
        refined = candidate.effect.refines == there.effect.id
        if akin(candidate, there) and not refined:
            return False
        if candidate.effect.structural and there.effect.structural:
            return False
    return True


def without(problem: Problem, fit: Fit, k: int) -> tuple[Hypothesis, Array]:
    """The hypothesis without its k-th effect, and its standardised parameters."""
    candidates = fit.hypothesis.candidates
    gone = problem.slices(fit.hypothesis)[k][1]
    return Hypothesis(candidates[:k] + candidates[k + 1 :]), np.delete(fit.z, gone)


def promising(
    problem: Problem, base: Fit, best: Fit, pool: Sequence[Candidate], known: dict[str, Fit], workers: Executor,
    said: Callable[[int, int], None], far: float = np.inf,
) -> list[Start]:  # fmt: skip
    """The effects of the pool that lower V most on top of ``base``, best first, each with where its full fit begins."""
    # known: key of an effect -> fit that an earlier look ended with. far: times the V near ``best`` beyond which
    # nothing is kept.
    noise = base.noise
    jobs = [start for candidate in pool for start in _starts(problem, base, candidate, known)]
    few, few_base, few_far = _look(problem, base, best, FIRST_WINDOWS)
    some, some_base, some_far = _look(problem, base, best, SECOND_WINDOWS)
    if isinstance(problem.plant, NonlinearPlant):  # many joints, and every moved parameter costs its matrices anew
        jobs = best_scored(few, few_base, jobs, MOST_SCORED, workers, said)
    borrowed = few.derivatives(few_base, len(problem.nuisances))
    # A few windows show a small part of what all of them may bring.
    rough_fall, least = tuning.ROUGH / noise.excess, tuning.PROMISING / noise.excess
    ends = min(few_far, few_base.cost - 2.0 * least), min(some_far, some_base.cost - 2.0 * least)

    def first(job: Start) -> tuple[Start, Fit]:
        plan = FitPlan(FIRST, rough_fall, draft=True, ceiling=ends[0])
        return job, few.fit(job.hypothesis, noise, job.z, few_base.starts, plan, borrowed)

    def second(entry: tuple[Start, Fit]) -> tuple[Start, Fit]:
        job, fit = entry
        plan = FitPlan(tuning.SECOND, rough_fall, draft=True, ceiling=ends[1])
        return job, some.fit(fit.hypothesis, noise, fit.z, _carried(fit, few, some, some_base), plan)

    looked = []
    for done, entry in enumerate(workers.map(first, jobs), start=1):
        looked.append(entry)
        said(done, len(jobs) + KEPT_SECOND)
    nearest = _best_of_each(looked)
    known.update({job.candidate.key: fit for job, fit in nearest})
    kept = _kept(nearest, few_base.cost, least, KEPT_SECOND, KEPT_GAINS)
    nearer = _best_of_each(workers.map(second, kept))
    known.update({job.candidate.key: fit for job, fit in nearer})
    kept = _kept(nearer, some_base.cost, 0.0, tuning.KEPT_LAST, KEPT_GAINS)
    kept = [(job, fit) for job, fit in kept if fit.cost <= far * some_far]
    return [Start(job.candidate, fit.hypothesis, fit.z, _carried(fit, some, problem, base)) for job, fit in kept]


def _carried(fit: Fit, looked: Problem, there: Problem, base: Fit) -> list[Array]:
    """The starts of a problem's windows: of those that were looked at as fitted, of the others those of the base."""
    # Behind a gap the load rests at another place in each window.
    found = []
    for own, seen, chosen, rest in zip(fit.starts, looked.chosen, there.chosen, base.starts, strict=True):
        starts = rest.copy()
        _, i, j = np.intersect1d(seen, chosen, return_indices=True)
        starts[j] = own[i]
        found.append(starts)
    return found


def _kept(
    entries: Sequence[tuple[Start, Fit]], cost: float, least: float, most: int, gains: int
) -> list[tuple[Start, Fit]]:
    """The best by the fall of V, and beside them the best of the gains, which the prior may prefer at the same V."""
    ordered = sorted(entries, key=lambda e: e[1].cost)
    chosen = [e for e in ordered if cost - e[1].cost > 2.0 * least][:most]
    wrong = [e for e in ordered if e[0].candidate.effect.gain_like and e not in chosen]
    return chosen + wrong[:gains]


def _best_of_each(fits: Iterable[tuple[Start, Fit]]) -> list[tuple[Start, Fit]]:
    """The cheapest fit of each effect and site over its starts."""
    best: dict[str, tuple[Start, Fit]] = {}
    for job, fit in fits:
        key = job.candidate.key
        if key not in best or fit.cost < best[key][1].cost:
            best[key] = (job, fit)
    return list(best.values())


def _starts(problem: Problem, base: Fit, candidate: Candidate, known: Mapping[str, Fit]) -> list[Start]:
    """From where a fit of the effect begins: its own starts, or where an earlier look left it."""
    if candidate.key in known:
        hypothesis, z = extended(problem, base.hypothesis, base.z, candidate, candidate.starts[0])
        earlier = known[candidate.key]  # of another period, or effects in another order, it begins anew
        return [Start(candidate, hypothesis, earlier.z if earlier.hypothesis == hypothesis else z)]
    own = [*candidate.starts, *_as_refitted(problem, base, candidate)]
    found = [Start(candidate, *extended(problem, base.hypothesis, base.z, candidate, start)) for start in own]
    return found + _unstretched(problem, base, candidate)


def _as_refitted(problem: Problem, base: Fit, candidate: Candidate) -> tuple[dict[str, float], ...]:
    """For a wrong parameter: the factor that the refit has already stretched it to."""
    if candidate.site.kind != "parameter" or not candidate.effect.scale:
        return ()
    for nuisance, z in zip(problem.nuisances, base.z, strict=False):
        if nuisance.label == candidate.site.name:
            return ({candidate.parameters[0].name: nuisance.factor(float(z))},)
    return ()


def _unstretched(problem: Problem, base: Fit, candidate: Candidate) -> list[Start]:
    """For a wrong gain: nominal parameters back at their values, and the gain at what the most stretched one had."""
    if not candidate.effect.gain_like or candidate.site.kind in ("parameter", "joint") or not problem.nuisances:
        return []
    scaled = [n.names and not n.additive for n in problem.nuisances]
    stretch = [n.spread * z for n, z, own in zip(problem.nuisances, base.z, scaled, strict=False) if own]
    likely = max(stretch, key=lambda s: abs(s) if abs(s) < MOST_STRETCHED else 0.0, default=0.0)
    found = []
    for sign in (1.0, -1.0):
        start = {candidate.parameters[0].name: float(np.exp(sign * likely))}
        hypothesis, z = extended(problem, base.hypothesis, base.z, candidate, start)
        z[: len(problem.nuisances)] = 0.0
        found.append(Start(candidate, hypothesis, z))
    return found


def extended(
    problem: Problem, base: Hypothesis, base_z: Array, candidate: Candidate, start: Mapping[str, Any]
) -> tuple[Hypothesis, Array]:
    """The base with the candidate, and the point from which its fit starts; a refinement replaces its parent."""
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


def _look(problem: Problem, base: Fit, best: Fit, wanted: int) -> tuple[Problem, Fit, float]:
    """Windows for a short look, the set fitted there, and a V beyond which nothing there can come near the best."""
    # Half are those that the fit explains worst, since an effect may act in few windows (a stop); half lie evenly.
    count, far = sum(len(c) for c in problem.chosen), 2.0 * tuning.FAR_BEHIND
    look, starts, cost = problem, list(base.starts), best.cost
    if count >= 2 * wanted:
        taken = np.zeros(count, dtype=bool)
        taken[:: round(2 * count / wanted)] = True
        worst = [k for k in np.argsort(-base.window_cost) if not taken[k]]
        taken[worst[: max(1, wanted - int(taken.sum()))]] = True
        masks = np.split(taken, np.cumsum([len(c) for c in problem.chosen])[:-1])
        look = problem.on(problem.records, [c[m] for c, m in zip(problem.chosen, masks, strict=True)])
        starts = [x[m] for x, m in zip(base.starts, masks, strict=True)]
        cost = float(best.window_cost[taken].sum() + best.z @ best.z)
    look = look.under(replace(look.clock, rough=True))
    return look, look.fit(base.hypothesis, base.noise, base.z, starts, FitPlan(1)), cost + far
