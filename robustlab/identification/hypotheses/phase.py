"""When a record began, as an effect over time tells it: of two records of a ripple each has a phase of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Problem
from robustlab.identification.hypotheses.noise import held_out_fit
from robustlab.identification.hypotheses.prepared_record import PreparedRecord

__all__ = ["in_phase"]

PHASES = 8  # looked at before the best one is made finer
PRICE = float(np.log(2 * PHASES))  # in log evidence, of a phase that was looked for in data to be judged on


def in_phase(problem: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> tuple[Problem, float]:
    """The problem with each record begun where the fit's effects over time leave least, and what that costs.

    The parameters stay; of several such effects the first tells the phase. Records that are ``known`` (the fit was told
    by them) stay as they are.
    """
    factors = [c.values(z)[c.effect.timed] for c, z in _parts(problem, fit) if c.effect.timed]
    new = [k for k, r in enumerate(problem.records) if not any(r is other for other in known)]
    if not factors or not new:
        return problem, 0.0
    records = list(problem.records)
    for k in new:
        records[k] = replace(records[k], begun=_begun(problem, fit, k, 1.0 / factors[0]))
    return problem.on(records, problem.chosen), PRICE * len(new)


def _begun(problem: Problem, fit: Fit, k: int, period: float) -> float:
    """Best time within a period for one record, by the cost of its windows."""
    from scipy.optimize import minimize_scalar

    def cost(later: float) -> float:
        alone = problem.on([replace(problem.records[k], begun=later)], [problem.chosen[k]])
        return held_out_fit(alone, fit, fit.noise).cost

    step = period / PHASES
    best = step * min(range(PHASES), key=lambda n: cost(step * n))
    finer: Any = minimize_scalar(
        cost, bounds=(best - step, best + step), method="bounded", options={"xatol": 0.01 * period}
    )
    return float(finer.x) % period


def _parts(problem: Problem, fit: Fit) -> Iterator[tuple[Candidate, Array]]:
    """Each effect of a fit with its standardised parameters."""
    at = len(problem.nuisances)
    for c in fit.hypothesis.candidates:
        yield c, fit.z[at : at + len(c.parameters)]
        at += len(c.parameters)
