"""A proposed path, done by the hidden machine: the two delays of a leg that its record hardly tells apart."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import platform_cases as pc
import platform_next

from robustlab.identification import tuning
from robustlab.identification.experiment.path_experiment import propose_path
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Clock, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.noise import first_noise, whitening
from robustlab.identification.hypotheses.prepared_record import ports_of, prepare

WINDOW = 40  # samples, as a naming cuts a shaken leg whose sensor is late
pytestmark = pytest.mark.slow


def fitted(problem, pool, noise):
    """Fits of the late sensor and of the late input at leg 3."""
    bare = np.zeros(len(problem.nuisances))
    return [
        min(
            (problem.fit(Hypothesis((c,)), noise, np.array([*bare, *c.standardised(s)]), plan=FitPlan(8))
             for s in c.starts[:2]), key=lambda f: f.cost,
        )
        for place in ("phi_3", "torque_3")
        for c in pool
        if c.effect.id in ("sensor-delay", "input-delay") and c.site.name == place
    ]  # fmt: skip


@pytest.fixture(scope="module")
def opened():
    case, plant = pc.make_case("sensor-delay", 1, motors=False, duration=4.0), pc.nominal_plant(motors=False)
    model = ports_of(plant, case.record)
    tolerances = nuisance_parameters(plant, stated_tolerances(plant, None))
    record = prepare(plant, model, case.record, WINDOW)
    problem = Problem(plant, [record], tolerances, clock=Clock(tuning.LEAST_STEPS))
    pool = candidates(plant, model, problem.records)
    noise = whitening(problem, fitted(problem, pool, first_noise(problem))[0])
    return case, problem, pool, fitted(problem, pool, noise)


def test_the_path_that_is_proposed_tells_the_hidden_machine_and_another_does_not(opened, tmp_path):
    case, problem, pool, fits = opened
    asked = ("slow reversals", "shake", "leg 3 shake")
    found = propose_path(problem, fits[0], fits[1:], only=asked)
    d = {t.name: t.separation for t in found.menu}
    assert found.name == "leg 3 shake"
    assert d["slow reversals"] < 3.0
    assert d["leg 3 shake"] == found.separation > max(5.0, d["shake"])
    text = found.save(tmp_path / "next.csv").read_text().splitlines()
    table = np.loadtxt(text[1:], delimiter=",")
    assert text[0].split(",") == ["t", *(f"phi_{j}_ref" for j in range(1, 7)), "tx", "ty", "tz", "ax", "ay", "az"]
    assert np.abs(pc.nut_angles(table[:, 7:]) - table[:, 1:7]).max() < 1e-4
    # the machine does it, under the case's own controller
    record = platform_next.done(case, table[:, 7:], table[:, 1:7])
    assert np.abs(np.column_stack(list(record.inputs.values()))).max() < 1.2 * pc.TORQUE_MAX
    prepared = prepare(problem.plant, ports_of(problem.plant, record), record, WINDOW)
    there = problem.on([problem.records[0], prepared])
    late_sensor, late_input = fitted(there, pool, fits[0].noise)
    told = np.sqrt(late_input.cost - late_sensor.cost)  # what was predicted, and the first record beside it
    assert 0.7 * found.separation < told < 2.5 * found.separation
    (candidate,) = late_sensor.hypothesis.candidates
    assert candidate.values(late_sensor.z[-1:])["d"] == pytest.approx(case.values[0]["d"], abs=1e-4)


def test_a_name_that_the_menu_does_not_have_is_refused(opened):
    _, problem, _, fits = opened
    with pytest.raises(platform_next.rl.InputError, match="no 'leg 9'"):
        propose_path(problem, fits[0], fits[1:], only=("leg 9",))
    assert propose_path(problem, fits[0], fits[:1]) is None
