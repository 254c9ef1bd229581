"""Additions to and removals from a set of effects, and the score of each addition.

The score is the fall g^T h^-1 g of V in the linearised problem, h = G^T P G and g = G^T P r with the change G of the
residuals r at the start of its fit and the projection P off all refitted parameters; or the fall at that start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.identification import tuning
from robustlab.identification.greybox.effect_fit import Candidate, Fit, Hypothesis, Linearised, Problem

KEPT = 5  # effects fitted in full on top of a set
KEPT_GAINS = 2  # further gain effects: at the same cost the prior may prefer one
MOST_FALL = 2.5  # times its score: the largest expected fall of V
ALIKE, AS_GOOD = 0.99, 0.5  # share of the best start's score: above, a start is the same; below, it is dropped
MOST_STRETCHED = 0.5  # log factor; friction coefficients change more, without information on a gain
LATE = 2.0  # standard deviations of a clock, beyond which it may imitate a delay
NEGLIGIBLE = 1e-9  # of a column's own square: the column is a combination of refitted parameters


@dataclass(frozen=True, eq=False)
class Start:
    """An effect on top of a set, and the initial parameters of their fit."""

    candidate: Candidate
    hypothesis: Hypothesis
    z: Array
    score: float = 0.0


def promising(
    problem: Problem, base: Fit, pool: Sequence[Candidate], wanted: float, report: Callable[[int, int], None]
) -> list[Start]:
    """Return the starts of the effects with the highest scores on top of a set, if V may fall by ``wanted``."""
    quick = problem.under(replace(problem.clock, rough=True))
    residual = quick.whitened(quick.errors(base.hypothesis, base.z, base.starts), base.noise)
    own = quick.derivatives(base)
    jobs, scores = [start for candidate in pool for start in _starts(problem, base, candidate)], list[float]()
    for done, start in enumerate(jobs, start=1):
        scores.append(_score(quick, base, residual, own, start))
        report(done, len(jobs))
    order = sorted(range(len(jobs)), key=lambda k: -scores[k])
    first = list(dict.fromkeys(jobs[k].candidate.key for k in order if MOST_FALL * scores[k] > wanted))[:KEPT]
    gains = [jobs[k].candidate for k in order if jobs[k].candidate.effect.gain_like]
    further = list(dict.fromkeys(c.key for c in gains if c.key not in first))[:KEPT_GAINS]
    found = []
    for key in (*first, *further):
        own = [k for k in order if jobs[k].candidate.key == key]
        second = [k for k in own if AS_GOOD * scores[own[0]] < scores[k] < ALIKE * scores[own[0]]]
        found += [replace(jobs[k], score=scores[k]) for k in (own[0], *second[:1])]
    return found


def _score(
    problem: Problem, base: Fit, residual: Sequence[Array], own: Sequence[tuple[Array, Array]], start: Start
) -> float:
    """Return the expected fall of V by an addition; a single negative strength does not count."""
    simulators, step, n = problem.simulators(start.hypothesis), tuning.STEP, len(base.z)

    def there(z: Array) -> list[Array]:
        return problem.whitened(problem.errors(start.hypothesis, z, base.starts, simulators), base.noise)

    with np.errstate(all="ignore"):
        at = there(start.z)
        fall = sum(float(r.ravel() @ r.ravel() - a.ravel() @ a.ravel()) for r, a in zip(residual, at, strict=True))
        fall += float(base.z @ base.z - start.z @ start.z)
        columns = [[a - r for a, r in zip(at, residual, strict=True)]]
        first = len(start.z) - len(start.candidate.parameters)
        for i, p in enumerate(start.candidate.parameters):
            if p.prior.kind == "linear":
                moved = there(start.z + step * np.eye(len(start.z))[first + i])
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
    for there in base.candidates:
        refined = candidate.effect.refines == there.effect.id
        if related(candidate, there) and not refined:
            return False
        if candidate.effect.structural and there.effect.structural:
            return False
    return True


def without(problem: Problem, fit: Fit, k: int) -> tuple[Hypothesis, Array]:
    """Return the hypothesis without its k-th effect, and its standardised parameters."""
    candidates = fit.hypothesis.candidates
    removed = problem.slices(fit.hypothesis)[k][1]
    return Hypothesis(candidates[:k] + candidates[k + 1 :]), np.delete(fit.z, removed)


def extended(
    problem: Problem, base: Hypothesis, base_z: Array, candidate: Candidate, start: Mapping[str, float]
) -> tuple[Hypothesis, Array]:
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


def _starts(problem: Problem, base: Fit, candidate: Candidate) -> list[Start]:
    """Return the starts of the effect: its own, or those that the set's parameters and clocks imitate."""
    effect, site, count = candidate.effect, candidate.site, len(problem.nuisances)

    def at(start: Mapping[str, float]) -> Start:
        return Start(candidate, *extended(problem, base.hypothesis, base.z, candidate, start))

    found = [at(start) for start in candidate.starts]
    pairs = list(zip(problem.nuisances, base.z[:count].tolist(), strict=True))
    if site.kind == "parameter" and effect.scale:  # the refitted factor
        name = candidate.parameters[0].name
        found += [at({name: n.factor(z)}) for n, z in pairs if n.label == site.name]
    elif effect.gain_like and site.kind != "joint":  # the factor of the most changed parameter; all at their values
        stretch = [n.spread * z for n, z in pairs if n.names and not n.additive]
        likely = max(stretch, key=lambda s: abs(s) if abs(s) < MOST_STRETCHED else 0.0, default=0.0)
        for sign in (1.0, -1.0) if pairs else ():
            found.append(at({candidate.parameters[0].name: float(np.exp(sign * likely))}))
            found[-1].z[:count] = 0.0
    if effect.delay:  # the shift of an input's clock, which is reset
        for k, (clock, z) in enumerate(pairs):
            if clock.input and z > LATE and (site.kind != "input" or clock.input == site.name):
                found.append(at({effect.delay: clock.spread * z}))
                found[-1].z[k] = 0.0
    return found
