r"""What each name brings: the error on held-out data with all names but it, refitted, against that with it.

With the held-out errors e of the whole set and e' without one effect, the effect is material where for some output, in
windows or whole runs, :math:`\operatorname{rms} e' - \operatorname{rms} e \ge s \operatorname{rms} e` and
:math:`\operatorname{rms}(e' - e) \ge \Delta / 2` with the sensor's step :math:`\Delta`; where its force is a share s of
the one that moves the joint; and where only parameters beyond their tolerances or a clock far off can take its place.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from robustlab.arrays import Array
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Problem, simulated_outputs
from robustlab.identification.hypotheses.noise import in_phase, restarted, spans
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.naming.first_look import without
from robustlab.identification.naming.held_out_gaps import run_free, unbroken

MOST_CLOCK = 3.0  # standard deviations of an input's clock
LIKELY = 0.999  # probability within which the parameters lie together; within tolerances they always do
TOGETHER = "all parameters together"


@dataclass(frozen=True)
class Matter:
    """Whether an effect is material, and the held-out error without it: of windows, in percent of the range."""

    material: bool
    error_without: float


@dataclass(frozen=True, eq=False)
class Errors:
    """Held-out errors of one model: of its windows and of whole runs, one array (..., n_measured) a record."""

    windows: Sequence[Array]
    runs: Sequence[Array]


def errors_of(held: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> Errors:
    """Errors of a fit on held-out windows, starts found anew, and from each record's own start to its end."""
    own = in_phase(held, fit, known)[0]
    placed = restarted(own, fit)
    windows = [
        record.measured[chosen] - outputs
        for record, chosen, outputs in zip(own.records, own.chosen, simulated_outputs(own, placed), strict=True)
    ]
    runs = [unbroken(record) for record in own.records]
    return Errors(windows, [r.measured - y for r, y in zip(runs, run_free(own, runs, fit), strict=True)])


def without_effects(problem: Problem, fit: Fit, keys: Collection[str]) -> Fit:
    """The set without these effects, refitted from where the whole set stands."""
    while (k := next((k for k, c in enumerate(fit.hypothesis.candidates) if c.key in keys), None)) is not None:
        hypothesis, z = without(problem, fit, k)
        fit = problem.fit(hypothesis, fit.noise, z, fit.starts, FitPlan(tuning.FULL))
    return fit


def strained(problem: Problem, fit: Fit) -> frozenset[str]:
    """Labels of the nuisances that a fit has taken beyond what they may be, and `TOGETHER` where all are improbable."""
    moving = problem.moving(fit.hypothesis)
    own = [(n, float(z)) for n, moves, z in zip(problem.nuisances, moving, fit.z, strict=False) if moves]
    found = set()
    for nuisance, z in own:
        low, high = (-MOST_CLOCK, MOST_CLOCK) if nuisance.input else nuisance.ends
        if not low <= z <= high:
            found.add(nuisance.label)
    if sum(z**2 for _, z in own) > chi2.ppf(LIKELY, max(1, len(own))):
        found.add(TOGETHER)
    return frozenset(found)


def late_clocks(problem: Problem, fit: Fit) -> frozenset[str]:
    """Labels of the clocks that a fit has moved further than clocks are off: they stand for a lateness."""
    return strained(problem, fit) & {n.label for n in problem.nuisances if n.input}


def matter_of(held: Problem, whole: Errors, less: Errors, needed: bool) -> Matter:
    """What is missing in ``less`` brings to ``whole``; ``needed``: it is material whatever the errors say."""
    ranges = spans(held.records)
    seen = ranges > 0.0
    with np.errstate(over="ignore"):
        share = _rms(less.windows)[seen] / ranges[seen]
    resolution = np.max([r.resolution for r in held.records], axis=0)
    material = needed or any(
        _matters(ours, theirs, resolution, tuning.MATERIAL)
        for ours, theirs in ((whole.windows, less.windows), (whole.runs, less.runs))
    )
    return Matter(material, 100.0 * float(np.sqrt(np.mean(share**2))))


def _matters(ours: Sequence[Array], theirs: Sequence[Array], resolution: Array, share: float) -> bool:
    with np.errstate(all="ignore"):
        own, other = _rms(ours), _rms(theirs)
        apart = _rms([b - a for a, b in zip(ours, theirs, strict=True)])
        worse = ~(other - own < share * own)  # a model that diverges without it is worse, too
        return bool(np.any(worse & (own < np.inf) & ~(apart < 0.5 * resolution) & ~(other <= own)))


def _rms(errors: Sequence[Array]) -> Array:
    """Over all known samples of each output, (n_measured,); infinite where a model's output is no number any more."""
    rows = np.concatenate([e.reshape(-1, e.shape[-1]) for e in errors])
    return np.sqrt(np.nansum(rows**2, axis=0) / np.maximum(np.sum(~np.isnan(rows), axis=0), 1))
