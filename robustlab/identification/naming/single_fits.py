r"""Every single effect in full, under the noise that the best set leaves: what a short look at each may have missed.

Under noise that is small and coloured the cost is rugged: an edge of the input that comes a hundredth of a step late
costs thousands, and a fit that begins at a guess rests in the next valley, with parameters far beyond their tolerances.
Under white noise of the sensors' size the same cost is smooth. So each effect is fitted there first, from each of its
starts and nominal parameters, as long as it may come near the best set there; the lowest ones go on under the noise of
the search, from where they stand. A refinement also begins where the effect that it refines came to, at each of its own
scales.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from robustlab.arrays import Array
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.noise import first_noise

TIMES = 10.0  # the V of the best set under the sensors' noise, which a single effect that explains as much comes near
Said = Callable[[int, int], None]
Begin = tuple[Hypothesis, Array, Sequence[Array]]  # what is fitted, its standardised parameters, the windows' starts


def single_fits(
    problem: Problem, best: Fit, pool: Sequence[Candidate], ceiling: float, workers: Executor, said: Said
) -> Iterator[Fit]:
    """Fits of single effects of ``pool`` under the noise of the ``best`` set, those that may come below ``ceiling``.

    ``said``: called with the number of fits done and to do.
    """
    wide, nominal = first_noise(problem), np.zeros(len(problem.nuisances))
    jobs = [(c, start) for c in pool for start in c.starts]
    near = problem.fit(best.hypothesis, wide, best.z, best.starts, FitPlan(tuning.ROUGH_FULL, tuning.ROUGH)).cost
    most = TIMES * near + 2.0 * tuning.FAR_BEHIND

    def smooth(job: tuple[Candidate, Mapping[str, float]]) -> Fit:
        candidate, start = job
        z = np.append(nominal, candidate.standardised(start))
        return problem.fit(
            Hypothesis((candidate,)), wide, z, plan=FitPlan(tuning.ROUGH_FULL, tuning.ROUGH, ceiling=most)
        )

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
    yield from workers.map(full, _refined(problem, plain, pool))


def _refined(problem: Problem, fits: Sequence[Fit], pool: Sequence[Candidate]) -> Iterator[Begin]:
    """Where what refines the effects of these fits begins: where they stand."""
    n = len(problem.nuisances)
    for fit in fits:
        (there,) = fit.hypothesis.candidates
        (values,) = problem.split(fit.hypothesis, fit.z)[1]
        for candidate in pool:
            if candidate.effect.refines == there.effect.id and candidate.site == there.site:
                for start in candidate.starts:
                    kept = {**start, **{name: x for name, x in values.items() if name in start}}
                    z = np.append(fit.z[:n], candidate.standardised(kept))
                    yield Hypothesis((candidate,)), z, fit.starts
