"""Ranking of effects on one record set: fits, evidence, bootstrap, hierarchy.

A step of the naming asks what single effect, added to those already named, explains the records best, and which others
do as well. All hypotheses are fitted with the nominal parameters free within their tolerances, so that a friction level
is not bought with a wrong resistance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, FitPlan, Hypothesis, NoiseModel, Problem
from robustlab.identification.tuning import NamingTuning

__all__ = ["Ranked", "Ranking", "bootstrap_wins", "first_noise", "noise_ratio", "rank", "whitening"]


@dataclass(frozen=True, eq=False)
class Ranked:
    """One hypothesis of a step.

    Attributes
    ----------
    candidate
        The effect that was added; None for the base, with nothing added.
    fit
        Its fit under the step's final noise model.
    evidence
        Log evidence, relative to the best of the step.
    wins
        Share of bootstrap samples of the windows in which its evidence is the largest.
    """

    candidate: Candidate | None
    fit: Fit
    evidence: float
    wins: float

    @property
    def id(self) -> str:
        """Effect id, ``"none"`` for the base."""
        return self.candidate.effect.id if self.candidate else "none"


@dataclass(frozen=True, eq=False)
class Ranking:
    """Hypotheses of one step, best first, with the base among them; and the noise model they were judged with."""

    ranked: tuple[Ranked, ...]
    noise: NoiseModel

    @property
    def best(self) -> Ranked:
        """The hypothesis with the largest evidence."""
        return self.ranked[0]

    @property
    def base(self) -> Ranked:
        """The hypothesis with nothing added."""
        return next(r for r in self.ranked if r.candidate is None)


def first_noise(problem: Problem) -> NoiseModel:
    """White noise of the size the smoother and the resolution of the sensors tell, averaged."""
    std = []
    for record in problem.records:
        single = np.maximum(record.smoothed.noise_std, record.resolution / np.sqrt(12.0))
        std.append(2.0 * single / np.sqrt(record.thin))
    return NoiseModel(np.max(std, axis=0), np.zeros((0, std[0].shape[0])))


def whitening(problem: Problem, fit: Fit, order: int | None = None) -> NoiseModel:
    """Autoregression (of the usual order where left out) and innovation size of a fit's errors, output by output."""
    order = problem.tuning.ar_order if order is None else order
    errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
    n_y = errors[0].shape[2]
    ar, std = np.zeros((order, n_y)), np.ones(n_y)
    for j in range(n_y):
        past = np.concatenate([_past(e[:, :, j], order) for e in errors])
        now = np.concatenate([e[:, order:, j].ravel() for e in errors])
        known = np.isfinite(past).all(axis=1) & np.isfinite(now)
        past, now = past[known], now[known]
        ar[:, j] = np.linalg.lstsq(past, now, rcond=None)[0]
        rest = now - past @ ar[:, j]
        std[j] = max(float(np.sqrt(np.mean(rest**2))), 1e-12 * float(np.abs(now).max(initial=1e-300)))
    return NoiseModel(std, ar)


def noise_ratio(problem: Problem, fit: Fit) -> float:
    """Error of the fitted windows over what the sensors' noise makes of it; the largest over the outputs."""
    errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
    size = np.sqrt(np.nanmean(np.concatenate([e.reshape(-1, e.shape[2]) for e in errors]) ** 2, axis=0))
    single = np.max(
        [np.maximum(r.smoothed.noise_std, r.resolution / np.sqrt(12.0)) / np.sqrt(r.thin) for r in problem.records],
        axis=0,
    )
    return float(np.max(size / single))


def _past(errors: Array, order: int) -> Array:
    """The ``order`` points before each point of a window, (n, order), latest first."""
    length = errors.shape[1]
    lagged = [errors[:, order - lag - 1 : length - lag - 1] for lag in range(order)]
    return np.stack(lagged, axis=2).reshape(-1, order)


def rank(
    problem: Problem,
    base: Hypothesis,
    base_z: Array,
    candidates: Sequence[Candidate],
    noise: NoiseModel,
    progress: Callable[[str], None] | None = None,
) -> Ranking:
    """Fit the base and the base plus each candidate, and rank them by evidence.

    Parameters
    ----------
    base, base_z
        Effects already named, and the standardised parameters they were fitted with.
    candidates
        Each is added alone. A refinement takes the place of its parent in the base.
    noise
        Noise model of the first rounds; the final one is estimated from the best hypothesis.
    """
    tuning = problem.tuning
    base_fit = problem.fit(base, noise, base_z, plan=FitPlan(tuning.base))
    jobs = [
        (candidate, *_extended(problem, base, base_fit.z, candidate, start))
        for candidate in candidates
        for start in (*candidate.starts, *_as_refitted(problem, base_fit, candidate))
    ]
    jobs += [job for candidate in candidates for job in _unstretched(problem, base_fit, candidate)]

    few, few_starts = _thinned(problem, base_fit, tuning.first_windows)
    some, some_starts = _thinned(problem, base_fit, tuning.second_windows)
    few_base = few.fit(base, noise, base_fit.z, few_starts, FitPlan(1))
    some_base = some.fit(base, noise, base_fit.z, some_starts, FitPlan(1))
    borrowed = few.derivatives(few_base)

    def first(job: tuple[Candidate, Hypothesis, Array]) -> tuple[Candidate, Fit]:
        plan = FitPlan(tuning.first, tuning.rough, draft=True, ceiling=few_base.cost - 2.0 * tuning.promising)
        return job[0], few.fit(job[1], noise, job[2], few_base.starts, plan, borrowed)

    def second_of(entry: tuple[Candidate, Fit]) -> tuple[Candidate | None, Fit]:
        plan = FitPlan(tuning.second, tuning.rough, draft=True, ceiling=some_base.cost - 2.0 * tuning.promising)
        return entry[0], some.fit(entry[1].hypothesis, noise, entry[1].z, some_base.starts, plan)

    def placed(entry: tuple[Candidate | None, Fit]) -> tuple[Candidate | None, Fit]:
        return entry[0], problem.fit(entry[1].hypothesis, noise, entry[1].z, base_fit.starts, FitPlan(2, draft=True))

    def finally_(entry: tuple[Candidate, Fit]) -> tuple[Candidate, Fit]:
        candidate, fit = entry
        gain = candidate.effect.gain_like
        z, starts = _better_start(problem, final_base, candidate, fit) if gain else (fit.z, fit.starts)
        ceiling = np.inf if gain else final_base.cost - 2.0 * tuning.promising
        return candidate, problem.fit(
            fit.hypothesis, final_noise, z, starts, FitPlan(tuning.base if gain else tuning.last, 0.02, ceiling=ceiling)
        )

    with ThreadPoolExecutor(tuning.workers) as pool:
        fitted = _best_of_each(pool.map(first, jobs))
        if progress:
            progress(f"{len(jobs)} starts of {len(fitted)} effects tried")
        gain = {key: few_base.cost - fit.cost for key, (_, fit) in fitted.items()}
        kept = [key for key in sorted(gain, key=gain.__getitem__, reverse=True) if gain[key] > 2.0 * tuning.promising]
        second = list(pool.map(second_of, [fitted[key] for key in kept[: tuning.kept_second]]))
        second.sort(key=lambda c: c[1].cost)
        gaining = [c for c in second if c[1].cost < some_base.cost][: tuning.kept_last]
        second = list(pool.map(placed, gaining)) if some is not problem else gaining
        leader = min([base_fit, *(fit for _, fit in second)], key=lambda f: f.cost)
        base_fit = _from_leader(problem, base_fit, leader)
        order = tuning.ar_order if noise_ratio(problem, leader) < tuning.beyond_noise else 1
        final_noise = whitening(problem, leader, order)
        # A wrong parameter and a stretched tolerance leave the same errors; what separates them is the prior alone.
        reached = {c.key for c, _ in second[: tuning.kept_last] if c is not None}
        wrong = [fitted[key] for key in fitted if key not in reached and fitted[key][0].effect.gain_like]
        final_base = problem.fit(base, final_noise, base_fit.z, base_fit.starts, FitPlan(tuning.base, 0.02))
        last = [*second[: tuning.kept_last], *((c, replace(fit, starts=base_fit.starts)) for c, fit in wrong)]
        final = list(pool.map(finally_, last))
    return _ranked([(None, final_base), *final], final_noise, tuning)


def _better_start(problem: Problem, base: Fit, candidate: Candidate, fit: Fit) -> tuple[Array, Sequence[Array]]:
    """Where the fit of a wrong gain goes on: where it is or, if V is lower there, at the base, which it contains."""
    if candidate.site.kind == "joint":  # friction or a spring that the base has not
        return fit.z, fit.starts
    same = _as_refitted(problem, base, candidate) or ({candidate.parameters[0].name: 1.0},)
    _, z = _extended(problem, base.hypothesis, base.z, candidate, same[0])
    for k, nuisance in enumerate(problem.nuisances):
        if candidate.site.kind == "parameter" and nuisance.label == candidate.site.name:
            z[k] = 0.0  # the effect's own factor is the whole factor
    points = [(fit.z, fit.starts), (z, base.starts)]
    return min(points, key=lambda point: problem.cost(fit.hypothesis, base.noise, *point))


def _from_leader(problem: Problem, base: Fit, leader: Fit) -> Fit:
    """The base fitted once more from where the best extension of it stands, kept where that is better.

    A fit may rest in a minimum that is not the lowest (contacts make many); an effect that only leads out of it would
    seem to explain what the base explains as well.
    """
    kept = base.hypothesis.candidates
    if leader is base or leader.hypothesis.candidates[: len(kept)] != kept:
        return base
    again = problem.fit(
        base.hypothesis, base.noise, leader.z[: len(base.z)], leader.starts, FitPlan(problem.tuning.second)
    )
    return again if again.cost < base.cost else base


def _as_refitted(problem: Problem, base: Fit, candidate: Candidate) -> tuple[dict[str, float], ...]:
    """For a wrong parameter: the factor that the refit within the tolerances has already stretched it to."""
    if candidate.site.kind != "parameter":
        return ()
    for nuisance, z in zip(problem.nuisances, base.z, strict=False):
        if nuisance.label == candidate.site.name:
            return ({candidate.parameters[0].name: nuisance.factor(float(z))},)
    return ()


def _unstretched(problem: Problem, base: Fit, candidate: Candidate) -> list[tuple[Candidate, Hypothesis, Array]]:
    """For a wrong gain: nominal parameters back at their values, and the gain at what the most stretched one had."""
    if not candidate.effect.gain_like or candidate.site.kind in ("parameter", "joint") or not problem.nuisances:
        return []
    stretch = [n.spread * z for n, z in zip(problem.nuisances, base.z, strict=False) if not n.additive]
    likely = max(stretch, key=lambda s: abs(s) if abs(s) < problem.tuning.most_stretched else 0.0, default=0.0)
    found = []
    for sign in (1.0, -1.0):
        start = {candidate.parameters[0].name: float(np.exp(sign * likely))}
        hypothesis, z = _extended(problem, base.hypothesis, base.z, candidate, start)
        z[: len(problem.nuisances)] = 0.0
        found.append((candidate, hypothesis, z))
    return found


def _thinned(problem: Problem, fit: Fit, wanted: int) -> tuple[Problem, list[Array]]:
    """Windows for a first look, and their fitted starts: half of them those that the fit explains worst.

    An effect may act in few windows (a stop, a saturation); the other half lie evenly over the records, so that what
    explains the worst does not spoil the rest.
    """
    count = sum(len(c) for c in problem.chosen)
    if count < 2 * wanted:
        return problem, list(fit.starts)
    taken = np.zeros(count, dtype=bool)
    taken[:: round(2 * count / wanted)] = True
    worst = [k for k in np.argsort(-fit.window_cost) if not taken[k]]
    taken[worst[: max(1, wanted - int(taken.sum()))]] = True
    ends = np.cumsum([len(c) for c in problem.chosen])[:-1]
    masks = np.split(taken, ends)
    chosen = [c[m] for c, m in zip(problem.chosen, masks, strict=True)]
    return problem.on(problem.records, chosen), [x[m] for x, m in zip(fit.starts, masks, strict=True)]


def _extended(
    problem: Problem, base: Hypothesis, base_z: Array, candidate: Candidate, start: object
) -> tuple[Hypothesis, Array]:
    """The base with the candidate, and the point from which its fit starts."""
    kept, z = [], list(base_z[: len(problem.nuisances)])
    at = len(problem.nuisances)
    for there in base.candidates:
        own = base_z[at : at + len(there.parameters)]
        at += len(there.parameters)
        if candidate.effect.refines == there.effect.id and candidate.site == there.site:
            values = there.values(own)
            start = {**start, **{k: v for k, v in values.items() if k in start}}  # type: ignore[dict-item,operator]
            continue
        kept.append(there)
        z.extend(own)
    hypothesis = Hypothesis((*kept, candidate))
    return hypothesis, np.array([*z, *candidate.standardised(start)])  # type: ignore[arg-type]


def _best_of_each(fits: object) -> dict[str, tuple[Candidate, Fit]]:
    """The cheapest fit of each effect and site over its starts."""
    best: dict[str, tuple[Candidate, Fit]] = {}
    for candidate, fit in fits:  # type: ignore[attr-defined]
        if candidate.key not in best or fit.cost < best[candidate.key][1].cost:
            best[candidate.key] = (candidate, fit)
    return best


def bootstrap_wins(fits: Sequence[Fit], tuning: NamingTuning) -> Array:
    """Share of bootstrap samples of the windows in which each fit has the largest evidence."""
    window = np.array([fit.window_cost for fit in fits])
    offset = np.array([fit.evidence for fit in fits]) + 0.5 * window.sum(axis=1)
    rng = np.random.default_rng(tuning.seed)
    n = window.shape[1]
    counts = rng.multinomial(n, np.full(n, 1.0 / n), size=tuning.bootstraps)
    winners = np.argmax(offset[:, None] - 0.5 * window @ counts.T, axis=0)
    return np.bincount(winners, minlength=len(fits)) / tuning.bootstraps


def _ranked(final: Sequence[tuple[Candidate | None, Fit]], noise: NoiseModel, tuning: NamingTuning) -> Ranking:
    evidence = np.array([fit.evidence for _, fit in final])
    wins = bootstrap_wins([fit for _, fit in final], tuning)
    order = np.argsort(-evidence)
    best = evidence[order[0]]
    return Ranking(
        tuple(Ranked(final[k][0], final[k][1], float(evidence[k] - best), float(wins[k])) for k in order), noise
    )
