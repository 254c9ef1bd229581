"""Which fitted sets of effects may be an answer at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.ports.port_model import AnyPlant, parameter_groups
from robustlab.identification.hypotheses.candidates import FEWEST_PERIODS, periods_seen
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem

__all__ = ["admissible", "beyond_tolerance"]


LONGEST_LAG = 0.1  # of a window: until the lag has passed, nothing of the simulation shows


def admissible(
    plant: AnyPlant, stated: Mapping[str, tuple[float, bool]], fitted: Problem, held: Problem
) -> Callable[[Problem, Fit], bool]:
    """The test that a set has to pass: parameters beyond their tolerances, ripples of which enough is seen.

    Parameters
    ----------
    stated
        Parameter -> (relative tolerance, whether it was assumed).
    fitted, held
        The records: a force over the position must be seen for two of its periods in both.
    """
    limits = {label: max(stated[n][0] for n in names) for _, label, names in parameter_groups(plant)}
    positions = _positions(plant, fitted)

    def allowed(problem: Problem, fit: Fit) -> bool:
        _, values = problem.split(fit.hypothesis, fit.z)
        for candidate, own in zip(fit.hypothesis.candidates, values, strict=True):
            if not beyond_tolerance(problem, fit, candidate, limits):
                return False
            window = problem.records[0].windows.length * problem.records[0].record.dt
            if candidate.effect.lag(own) > LONGEST_LAG * window:
                return False
            if candidate.effect.spatial and "k" in own:
                position = positions[candidate.site.name]
                if min(periods_seen(own["k"], position, p.records) for p in (fitted, held)) < FEWEST_PERIODS:
                    return False
        return True

    return allowed


def beyond_tolerance(problem: Problem, fit: Fit, candidate: Candidate, limits: Mapping[str, float]) -> bool:
    """False for a parameter effect whose factor lies within the parameter's tolerance: nothing is missing then."""
    if candidate.site.kind != "parameter":
        return True
    factors, values = problem.split(fit.hypothesis, fit.z)
    k = next(i for i, c in enumerate(fit.hypothesis.candidates) if c.key == candidate.key)
    own = candidate.effect.factors(problem.plant, candidate.site, values[k])
    if not candidate.effect.scale:  # shifts: a coordinate of the value 0 has its tolerance in its unit
        p = problem.plant.parameters
        return any(abs(p[n].reference * f - p[n].value) > p[n].radius for n, f in own.items())
    name = next(iter(own))
    total = np.log(factors.get(name, 1.0) * own[name])
    return bool(abs(total) > np.log1p(limits[candidate.site.name]))


def _positions(plant: AnyPlant, problem: Problem) -> dict[str, Array]:
    """Row of the states that is the position at each joint, and what each output shows."""
    model = problem.simulators(Hypothesis(()))[0].model({}, [])
    shown = model.C.reshape(-1, *model.C.shape[-2:])[0]
    rows = {s.name: row for s, row in zip(plant.outputs, shown, strict=True)}
    return rows | {name: port.position for name, port in model.ports.items() if port.position is not None}
