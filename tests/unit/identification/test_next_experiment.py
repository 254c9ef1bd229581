"""The proposed experiment: known answers of the effect catalogue, and a trial on an independent machine."""

from functools import cache

import numpy as np
import pytest
from hidden import make_case

from robustlab.dynamics import port_model
from robustlab.identification import (
    FitPlan,
    Hypothesis,
    Problem,
    candidates,
    first_noise,
    nuisance_parameters,
    prepare,
    propose_experiment,
    stated_tolerances,
    whitening,
    window_length,
)

SEED = 5
DT = 1e-3


def problem_of(plant, record, length=None):
    model = port_model(plant)
    prepared = prepare(plant, model, record, length or window_length(plant, [record]))
    return Problem(plant, [prepared], nuisance_parameters(plant, stated_tolerances(plant, None)))


def best_fit(problem, pool, name, noise):
    """The cheapest fit of the nominal model with this effect over all its sites and starts."""
    bare = np.zeros(len(problem.nuisances))
    if name == "none":
        return problem.fit(Hypothesis(()), noise, bare)
    tries = [
        problem.fit(Hypothesis((c,)), noise, np.array([*bare, *c.standardised(s)]))
        for c in pool
        if c.effect.id == name
        for s in c.starts
    ]
    return min(tries, key=lambda f: f.cost)


@cache
def opened(true, excitation, *names, factor=None, plant="dc-motor", noise="mid"):
    """A blind case, its problem, and the fits of these candidates with the residual noise of the first."""
    parameters = {true: {"factor": factor}} if factor else None
    case = make_case(true, SEED, excitation=excitation, parameters=parameters, plant=plant, noise=noise)
    problem = problem_of(case.plant, case.record)
    pool = candidates(case.plant, port_model(case.plant), problem.records)
    first = best_fit(problem, pool, names[0], first_noise(problem))
    final = whitening(problem, first)
    return case, problem, tuple(best_fit(problem, pool, name, final) for name in names)


@cache
def proposal(true, excitation, *names, **more):
    case, problem, fits = opened(true, excitation, *names, **more)
    return case, problem, fits, propose_experiment(problem, fits[0], fits[1:])


# --- known answers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rival", ["constant-load", pytest.param("input-dead-zone", marks=pytest.mark.slow)])
def test_reversals_identify_coulomb_friction_and_one_way_steps_do_not(rival):
    case, problem, fits, found = proposal("coulomb-friction", "oneway", "coulomb-friction", rival)
    assert found.now < 3
    assert found.separation > 10
    assert found.advice == ""
    assert found.added == ()
    u = found.inputs["u"]
    assert u.min() < 0 < u.max()  # the record has one sign only
    assert np.abs(u).max() <= np.abs(case.record.inputs["u"]).max()
    assert len(found.t) == len(u)
    assert found.t[1] - found.t[0] == pytest.approx(DT)

    # An independent simulation of the blind machine runs the proposal; both candidates are refitted.
    record = case.experiment(u)
    there = problem_of(case.plant, record, problem.records[0].windows.length)
    named, other = (there.fit(f.hypothesis, f.noise, f.z) for f in fits)
    realised = np.sqrt(max(0.0, other.cost - named.cost))
    assert realised > 10
    assert 0.5 < realised / found.separation < 2.0


def test_a_wrong_inertia_and_a_wrong_resistance_require_a_current_sensor():
    _, _, _, found = proposal("inertia", "rich", "inertia", "resistance", factor=0.8)
    assert found.added == ("i",)
    assert found.sensors == ("phi", "i")
    assert found.now < 3 < found.separation
    # 0.1 % of the range of a current that reverses at full voltage: twice 2 U / R.
    assert found.assumed_noise["i"] == pytest.approx(1e-3 * 4 * 24 / 2.07, rel=0.15)
    assert "i is new" in found.description


@pytest.mark.slow
def test_a_torque_constant_and_a_sensor_gain_require_an_independent_measurement():
    _, _, _, found = proposal("torque-constant", "rich", "torque-constant", "sensor-gain", factor=0.93)
    # Only the tolerances of the time constant separate them: 3 to 4 noise sigmas for any signal.
    assert 2.0 < found.separation < 5.0
    assert "separate sensor-gain and torque-constant" in found.advice
    assert "open-circuit voltage" in found.advice
    assert "known from elsewhere" in found.advice


def test_a_saturation_above_the_recorded_range_is_reported_as_out_of_reach():
    case, problem, _ = opened("none", "square", "none")
    top = float(np.abs(case.record.inputs["u"]).max())
    pool = candidates(case.plant, port_model(case.plant), problem.records)
    saturation = next(c for c in pool if c.effect.id == "input-saturation")
    bare = opened("none", "square", "none")[2][0]
    z = np.array([*bare.z, *saturation.standardised({"u_max": 0.9999 * top})])
    high = problem.fit(Hypothesis((saturation,)), bare.noise, z, plan=FitPlan(0))
    found = propose_experiment(problem, bare, [high])
    assert found.separation < 3
    assert f"u between {-top:.3g} and {top:.3g} V" in found.advice
    assert "driver's output voltage" in found.advice
    assert np.abs(found.inputs["u"]).max() <= top
