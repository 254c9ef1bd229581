"""The clock of a naming: what inputs do between their samples, their shift, and steps that are short enough."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import catalogue, port_model
from robustlab.identification.hypotheses.candidates import nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Clock, Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming.set_search import clock_nuisances, held_inputs

MASS, DAMPING, SPRING = 1.0, 0.4, 400.0  # 20 rad/s, lightly damped
OSCILLATOR = rl.plant("mass-spring-damper", m=MASS, c=DAMPING, k=SPRING)
SAMPLES = 9  # a period of the oscillator
DT = 2 * np.pi / 20.0 / SAMPLES
COUNT = 1200
NOISE = 2e-4  # of the range
NONE = Hypothesis(())
ONE_STEP = Clock(1)


def drive(t):
    """A band-limited force in N: sines below a quarter of the sample rate."""
    rng = np.random.default_rng(4)
    omega, phase = rng.uniform(1.0, 40.0, 12), rng.uniform(0.0, 2 * np.pi, 12)
    return 20.0 * np.sin(np.multiply.outer(t, omega) + phase).sum(axis=-1) / 12


def simulated(force, cubic=0.0, splits=1):
    """Position at the samples by scipy's DOP853; ``force`` takes the time and the number of the sample before it."""
    q, x = np.zeros(COUNT), np.zeros(2)
    for k in range(COUNT - 1):
        q[k] = x[0]

        def rate(t, x, k=k):
            return [x[1], (force(t, k) - DAMPING * x[1] - SPRING * x[0] - cubic * x[0] ** 3) / MASS]

        for part in range(splits):
            span = (k + part / splits) * DT, (k + (part + 1) / splits) * DT
            x = solve_ivp(rate, span, x, method="DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
    q[-1] = x[0]
    return q


@cache
def record(kind: str, cubic=0.0) -> rl.Record:
    """The force is held over each sample, or goes on between them; or comes 0.3 of a sample late."""
    t = DT * np.arange(COUNT)
    sampled = drive(t)
    late = 0.3 * DT if kind == "late" else 0.0
    q = simulated((lambda _, k: sampled[k]) if kind == "held" else (lambda now, _: drive(now - late)), cubic)
    q = q + NOISE * np.ptp(q) * np.random.default_rng(7).normal(size=COUNT)
    return rl.Record(t, {"f": sampled}, {"q": q}, {"f": "N", "q": "m"}, kind)


def problem_of(record: rl.Record, clock=ONE_STEP) -> Problem:
    model = port_model(OSCILLATOR)
    ready = prepare(OSCILLATOR, model, record, 100)
    stated = nuisance_parameters(OSCILLATOR, stated_tolerances(OSCILLATOR, {"m": 0.05, "c": 0.5, "k": 0.05}))
    return Problem(OSCILLATOR, [ready], (*stated, *clock_nuisances(("f",), DT)), clock=clock)


def fitted(problem: Problem) -> Fit:
    """Under the noise that was added."""
    noise = NoiseModel(np.array([NOISE * np.ptp(problem.records[0].y)]), np.zeros((0, 1)))
    return problem.fit(NONE, noise, np.zeros(len(problem.nuisances)), plan=FitPlan(20))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "hold"), [("held", "zoh"), ("continuous", "smooth")])
@pytest.mark.parametrize("begun", ["zoh", "smooth"])
def test_what_an_input_does_between_its_samples_is_inferred(kind, hold, begun):
    problem = problem_of(record(kind), Clock(1, (begun,)))
    before = fitted(problem)
    fit, there = held_inputs(problem, before)
    assert there.clock.hold in (None, (hold,))
    assert fit.cost <= before.cost
    assert (fit.cost < 0.5 * before.cost) == (begun != hold)
    shift = there.shift(fit.z)
    assert shift is not None
    assert abs(shift[0]) < 0.02 * DT


@pytest.mark.slow
def test_a_clock_that_is_late_is_found():
    problem = problem_of(record("late"), Clock(1, ("smooth",)))
    fit = fitted(problem)
    (shift,) = problem.shift(fit.z) or (np.nan,)
    std = problem.nuisances[-1].spread * fit.std[-1]
    assert shift == pytest.approx(0.3 * DT, abs=max(4 * std, 0.01 * DT))
    assert 0.0 < std < 0.1 * DT


@pytest.mark.slow
def test_discover_reports_the_clock():
    few = [name for name in catalogue() if name not in ("coulomb-friction", "constant-load")]
    found = rl.discover(OSCILLATOR, record("continuous"), exclude=few, tolerances={"m": 0.05, "c": 0.5, "k": 0.05})
    assert found.verdict == "no missing effect"  # what is left is estimated under the same clock
    assert found.complete
    (clock,) = found.clocks
    assert (clock.input, clock.hold) == ("f", "smooth")
    assert 0.0 < clock.std < 0.1 * DT
    assert abs(clock.shift) < 5 * clock.std
