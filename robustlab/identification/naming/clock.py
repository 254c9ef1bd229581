"""The clock under which hypotheses are simulated: what inputs do between their samples, and how short the steps are.

What a record does not say is inferred: an input may be held between its samples, or be a signal that was only sampled
(then the plant sees it half a sample earlier on average, and more of its fast part). A hypothesis that is simulated
better than another would win by that alone; so all share one stepping, short enough for the best of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustlab.identification.hypotheses.effect_fit import Clock, Fit, FitPlan, Problem
from robustlab.identification.hypotheses.nuisance import Nuisance
from robustlab.identification.tuning import NamingTuning

__all__ = ["clock_nuisances", "held_inputs", "short_steps", "step_error"]


def clock_nuisances(inputs: tuple[str, ...], dt: float, tuning: NamingTuning) -> tuple[Nuisance, ...]:
    """A shift of each input against the outputs, a part of a sample: clocks are not told more exactly than that."""
    return tuple(Nuisance(f"clock of {name}", (), tuning.clock_share * dt, input=name) for name in inputs)


def held_inputs(problem: Problem, fit: Fit) -> tuple[Fit, Problem]:
    """The fit and its problem under the hold of each input that explains the records best: held, or smooth."""
    hold = list(problem.clock.hold or ["zoh"] * len(problem.plant.inputs))
    for k in range(len(hold)):
        other = hold.copy()
        other[k] = "smooth" if hold[k] == "zoh" else "zoh"
        there = problem.under(replace(problem.clock, hold=tuple(other)))
        again = there.fit(fit.hypothesis, fit.noise, fit.z, fit.starts, FitPlan(problem.tuning.last))
        if again.cost < fit.cost - 2.0 * problem.tuning.promising:
            hold, fit, problem = other, again, there
    return fit, problem


def step_error(problem: Problem, fit: Fit) -> float:
    """Change of residuals, in standard deviations of the noise, when every step is halved: 99 in 100 change by less."""
    halved = problem.under(Clock(2 * (problem.clock.sub or 1), problem.clock.hold))
    pairs = zip(
        problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise),
        halved.whitened(halved.errors(fit.hypothesis, fit.z, fit.starts), fit.noise),
        strict=True,
    )
    return float(np.quantile(np.concatenate([np.abs(a - b).ravel() for a, b in pairs]), 0.99))


def short_steps(problem: Problem, fit: Fit) -> Problem:
    """The problem with steps so short that halving them changes no residual by more than a tenth of the noise."""
    tuning = problem.tuning
    while (problem.clock.sub or 1) < tuning.most_steps and step_error(problem, fit) > tuning.step_error:
        problem = problem.under(replace(problem.clock, sub=2 * (problem.clock.sub or 1)))
    return problem
