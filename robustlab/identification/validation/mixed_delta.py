r"""Constants and dynamic blocks together: a search over the constants, and a relaxation from below.

For fixed constants the dynamic blocks are found by their own methods, so

.. math:: \gamma^* = \min_\delta \max(|\delta|_\infty, \gamma_{dyn}(\delta))

is searched from above (pattern search). From below every constant is allowed to be a time-varying system of the same
size, a larger set, whose multipliers disprove a gamma.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import sampled
from robustlab.identification.validation.time_varying import smallest_contractions

if TYPE_CHECKING:
    from robustlab.identification.validation.smallest_delta import _Found, _Job

__all__ = ["smallest_mixed"]

SHARE = 0.4  # of the budget for the search over the constants
FINEST = 0.02
LONGEST_RELAXED = 4000  # samples at the beginning of the record from which the lower bound comes


def smallest_mixed(job: _Job, scaled: NDArray[np.bool_]) -> _Found:
    """Bounds for real and dynamic blocks together."""
    blocks = job.recorded.uncertain.blocks
    real = np.array([b.interval is not None for b in blocks], dtype=bool)
    names = [b.name for b in blocks if b.interval]
    free, kept = scaled[real], scaled[~real]
    problem = sampled(job.recorded.part(0, LONGEST_RELAXED), job.recorded.uncertain.M, blocks)
    relaxed = smallest_contractions(problem, scaled, job.precision, job.budget)
    if np.isinf(relaxed.lower):
        return _unexplained(job, relaxed, problem)
    part = replace(job, budget=job.budget.share(SHARE))

    def size_at(delta: Any) -> float:
        if (np.abs(delta[~free]) > 1).any():
            return np.inf
        try:
            found = part.dynamic(dict(zip(names, map(float, delta), strict=True)), kept, quick=True)
        except NoTrustworthyNumber:
            return np.inf
        return max(found.upper, float(np.abs(delta[free]).max(initial=0.0)))

    delta = np.zeros(len(names))
    best, step = size_at(delta), 0.5
    if len(job.recorded.t) > LONGEST_RELAXED:
        step = 0.0  # nothing explains a record of which only the beginning is judged
    while step > FINEST * max(best if np.isfinite(best) else 1.0, 0.05) and not part.budget.over:
        better = False
        for k in range(len(names)):
            for sign in (1.0, -1.0):
                trial = delta.copy()
                trial[k] += sign * step
                size = size_at(trial)
                if size < best * (1 - 1e-4) or (np.isinf(best) and np.isfinite(size)):
                    delta, best, better = trial, size, True
                    break
        step = step if better else step / 2
    values = dict(zip(names, map(float, delta), strict=True))
    found = job.dynamic(values, kept)
    upper = max(found.upper, float(np.abs(delta[free]).max(initial=0.0)))
    label = "constants and systems; lower bound with all blocks time-varying (relaxation), upper bound by search"
    evidence = {"energy": relaxed.multipliers.D, "noise": relaxed.multipliers.noise}
    return replace(
        found,
        lower=relaxed.lower,
        upper=upper,
        label=label,
        multipliers=evidence,
        recheck=None,
        certified=False,
    )


def _unexplained(job: _Job, relaxed: Any, problem: Any) -> _Found:
    found = job._varying(problem, relaxed, np.ones(len(problem.blocks), dtype=bool), {})
    return replace(found, sizes={})
