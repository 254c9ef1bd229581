"""Intervals that records close on one side only: of a gap whose other flank the load never reaches, the least width.

The curvature at the best fit says nothing of that: it rests where the gap begins to be wide enough, and rises on one
side. So a value that is clearly larger is asked for, with everything else fitted again; where it explains the records
as well, what bounds the parameter above is its prior alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Prior, Problem
from robustlab.identification.naming.named_effects import INTERVAL, EffectValue

WIDER = 1.25  # times the fitted value, at which the records are asked
HELD = 1e8  # precision that holds a standardised parameter
ROUNDS = 8


def opened_above(problem: Problem, fit: Fit, k: int, values: Sequence[EffectValue]) -> tuple[EffectValue, ...]:
    """The values of the k-th effect, with the upper end of its prior where a larger one does as well."""
    candidate = fit.hypothesis.candidates[k]
    name = candidate.effect.told_from_below
    if not name:
        return tuple(values)
    own = [p.name for p in candidate.parameters].index(name)
    at = len(problem.nuisances) + sum(len(c.parameters) for c in fit.hypothesis.candidates[:k]) + own
    prior = candidate.parameters[own].prior
    z = fit.z.copy()
    z[at] = prior.standardised(WIDER * values[own].value)
    mean, precision = np.zeros(len(z)), np.eye(len(z))
    mean[at], precision[at, at] = z[at], HELD
    there = problem.fit(fit.hypothesis, fit.noise, z, fit.starts, FitPlan(ROUNDS), prior=Prior(mean, precision))
    if there.cost + there.z[at] ** 2 - fit.cost >= tuning.CANNOT_TELL**2:
        return tuple(values)
    upper = max(values[own].upper, prior.value(INTERVAL))
    return tuple(replace(v, upper=upper) if v.name == name else v for v in values)
