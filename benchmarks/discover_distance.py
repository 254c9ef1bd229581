r"""What a case's records can tell: the refit distance between what is hidden and what was answered.

The hidden effects are fitted as the catalogue knows them, the answer from where it stands; the distance is that of
`robustlab.identification.hypotheses.effect_fit.refit_distance`, in standard deviations of the noise that the hidden
ones leave. Below 3 no test on these records tells the two apart, and a first answer cannot be asked for.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

RESOLVABLE = 3.0
WINDOWS = 12  # into which a record is cut
MOST_STARTS = 24  # combinations of places and starts of the hidden effects


Told = tuple[str, str, Mapping[str, float]]  # an effect by its id, its place, its parameters


def distance(case: Any, truth: Sequence[str], answer: Sequence[Told]) -> float:
    """Refit distance from the hidden effects to those of the answer; NaN where the catalogue cannot say one here."""
    from robustlab.dynamics.ports.port_model import linear_plant_of, port_model
    from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
    from robustlab.identification.hypotheses.effect_fit import FitPlan, Hypothesis, Problem, refit_distance
    from robustlab.identification.hypotheses.noise import first_noise, whitening
    from robustlab.identification.hypotheses.prepared_record import prepare

    plant = linear_plant_of(case.plant, "bench")
    ports, length = port_model(plant), case.record.n // WINDOWS
    problem = Problem(
        plant, [prepare(plant, ports, case.record, length)], nuisance_parameters(plant, stated_tolerances(plant, None))
    )
    pool, noise = candidates(plant, ports, problem.records), first_noise(problem)
    own = [[(c, start) for c in pool if c.effect.id == name for start in c.starts] for name in truth]
    fits = [
        problem.fit(Hypothesis(tuple(c for c, _ in chosen)), noise, _point(problem, chosen), plan=FitPlan(12))
        for chosen in itertools.islice(itertools.product(*own), MOST_STARTS)
    ]
    if not fits:
        return float("nan")
    true = min(fits, key=lambda f: f.cost)
    noise = whitening(problem, true)
    true = problem.fit(true.hypothesis, noise, true.z, true.starts, FitPlan(12))
    told = [(c, values) for name, place, values in answer for c in _alike(pool, name, place)]
    rival = problem.fit(Hypothesis(tuple(c for c, _ in told)), noise, _point(problem, told), true.starts, FitPlan(12))
    return refit_distance(problem, true, rival)


def _alike(pool: Iterable[Any], name: str, place: str) -> list[Any]:
    return [c for c in pool if c.effect.id == name and c.site.name == place][:1]


def _point(problem: Any, chosen: Sequence[tuple[Any, Any]]) -> Any:
    """Standardised parameters: nominal ones at their values, each effect where it begins."""
    return np.concatenate([np.zeros(len(problem.nuisances)), *(c.standardised(start) for c, start in chosen)])
