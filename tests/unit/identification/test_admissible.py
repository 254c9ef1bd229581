"""Which sets may be an answer: parameters beyond their tolerances, ripples of which two periods are seen."""

from functools import cache

import numpy as np
import pytest
from naming_cases import AXIS, T, U, noisy

import robustlab as rl
from robustlab.dynamics.ports.port_model import port_model
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming.discovery import admissible

STATED = stated_tolerances(AXIS, {"M": 0.05, "Fv": 1.0})


@cache
def problem_of(stroke: float) -> Problem:
    """The axis, driven so hard that its longest stroke is this many times the usual one."""
    run = rl.simulate(AXIS, T, stroke * U)
    record = rl.Record(T, {"u": stroke * U}, noisy({k: run[k] for k in ("q", "v")}, 0), name="run")
    return Problem(AXIS, [prepare(AXIS, port_model(AXIS), record, 100)], nuisance_parameters(AXIS, STATED))


def candidate(key: str) -> Candidate:
    return next(c for c in candidates(AXIS, port_model(AXIS), problem_of(1.0).records) if c.key == key)


def fit_of(*pairs: tuple[Candidate, dict[str, float]]) -> Fit:
    """A fit that says so, and nothing else."""
    z = np.concatenate([np.zeros(2), *(c.standardised({**c.starts[0], **values}) for c, values in pairs)])
    noise = NoiseModel(np.ones(2), np.zeros((0, 2)))
    return Fit(Hypothesis(tuple(c for c, _ in pairs)), z, (), 0.0, np.zeros(0), np.eye(len(z)), noise, 0)


@pytest.mark.parametrize(("periods", "allowed"), [(0.9, False), (1.9, False), (2.1, True), (40.0, True)])
def test_two_periods_of_a_ripple_must_be_seen(periods, allowed):
    problem = problem_of(1.0)
    (ready,) = problem.records
    k = 2 * np.pi * periods / np.ptp(ready.record["q"])
    ripple = candidate("cogging @ v")
    judged = admissible(AXIS, STATED, problem, problem)
    prior = next(p.prior for p in ripple.parameters if p.name == "k")
    fit = fit_of((ripple, {"k": k}))
    assert ripple.values(fit.z[2:])["k"] == pytest.approx(k)
    assert prior.kind in ("log", "linear", "share")
    assert judged(problem, fit) is allowed


def test_two_periods_must_be_seen_in_the_held_out_records_as_well():
    long, short = problem_of(1.0), problem_of(0.1)
    k = 2 * np.pi * 5.0 / np.ptp(long.records[0].record["q"])
    fit = fit_of((candidate("cogging @ v"), {"k": k}))
    assert admissible(AXIS, STATED, long, long)(long, fit)
    assert not admissible(AXIS, STATED, long, short)(long, fit)
    assert not admissible(AXIS, STATED, short, long)(short, fit)


@pytest.mark.parametrize(("factor", "allowed"), [(1.04, False), (1.06, True), (0.97, False), (0.94, True)])
def test_a_wrong_parameter_must_lie_beyond_its_tolerance(factor, allowed):
    problem = problem_of(1.0)
    judged = admissible(AXIS, STATED, problem, problem)
    inertia, friction = candidate("inertia @ M"), candidate("coulomb-friction @ v")
    assert judged(problem, fit_of((inertia, {"s": factor}))) is allowed
    assert judged(problem, fit_of((friction, {}), (inertia, {"s": factor}))) is allowed


def test_what_is_neither_a_ripple_nor_a_parameter_may_always_be_an_answer():
    problem = problem_of(1.0)
    judged = admissible(AXIS, STATED, problem, problem)
    assert judged(problem, fit_of())
    assert judged(problem, fit_of((candidate("coulomb-friction @ v"), {}), (candidate("constant-load @ v"), {})))
