"""Gaps on held-out data: windows and free run, against scipy's simulation and plain formulas."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

import robustlab as rl
from robustlab.dynamics import port_model
from robustlab.identification.hypotheses.candidates import nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming.held_out import held_out_gaps

AXIS = rl.plant("servo-axis")
HEAVIER = 1.25
DEMO = Path(__file__).parents[3] / "recipes" / "data" / "motor_record.csv"
N, DT, LENGTH = 1000, 2e-3, 100
T = np.arange(N) * DT
U = 1.5 * np.sin(2 * np.pi * 1.3 * T) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 50)


def stepped(mass_factor, x0, u):
    """q and v of the axis with a held input, by scipy."""
    p = AXIS.values
    mass = mass_factor * p["M"]
    a, b = np.array([[0.0, 1.0], [0.0, -p["Fv"] / mass]]), np.array([[0.0], [p["gain"] / mass]])
    a_d, b_d, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), DT)
    x = np.empty((len(u), 2))
    x[0] = x0
    for k in range(len(u) - 1):
        x[k + 1] = a_d @ x[k] + b_d[:, 0] * u[k]
    return x


def record(name="run 7", seed=0, moving=0.05):
    """The heavier axis, in motion when the record begins."""
    rng = np.random.default_rng(seed)
    x = stepped(HEAVIER, [0.1, moving], U) + rng.normal(size=(N, 2)) * [1e-5, 1e-4]
    return rl.Record(T, {"u": U}, {"q": x[:, 0], "v": x[:, 1]}, {"u": "V", "q": "m", "v": "m/s"}, name)


@cache
def parts(chosen=None, lost=None):
    """The problem, and the models as given and with the true mass."""
    run, valid = record(), {}
    if lost is not None:
        known = np.ones(N, dtype=bool)
        known[slice(*lost)] = False
        valid = {"q": known, "v": known}
    ready = prepare(AXIS, port_model(AXIS), run, LENGTH, valid)
    nuisances = nuisance_parameters(AXIS, stated_tolerances(AXIS, None))
    problem = Problem(AXIS, [ready], nuisances, None if chosen is None else [np.array(chosen)])
    noise = NoiseModel(np.array([1e-5, 1e-4]) / np.sqrt(ready.thin), np.zeros((1, 2)))
    z = np.zeros(len(nuisances))
    (k,) = (k for k, n in enumerate(nuisances) if "M" in n.names)
    true = z.copy()
    true[k] = np.log(HEAVIER) / nuisances[k].spread
    given, right = (Fit(Hypothesis(()), z, (), 0.0, np.zeros(0), np.eye(0), noise, 0) for z in (z, true))
    return problem, {"nominal": given, "refitted": given, "updated": right}


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("model", "factor"), [("nominal", 1.0), ("updated", HEAVIER)])
def test_the_free_run_is_one_simulation_from_its_start_to_its_end(model, factor):
    found = held_out_gaps(*parts())
    run = found.series["free_run"]
    signals = run["outputs"]
    assert (len(run["t"]), run["record"], found.free_run_on) == (N, "run 7", "run 7")
    start = [signals["q"][model][0], signals["v"][model][0]]
    expected = stepped(factor, start, U)
    for j, name in enumerate(("q", "v")):
        assert signals[name][model] == pytest.approx(expected[:, j], rel=1e-9, abs=1e-12)
        error = signals[name]["measured"] - expected[:, j]
        assert getattr(found.free_run[name], model) == pytest.approx(rms(error), rel=1e-6)


def test_the_true_model_is_at_the_noise_and_the_wrong_one_far_from_it():
    found = held_out_gaps(*parts())
    for gaps in (found.windows, found.free_run):
        assert gaps["q"].updated < 3e-5
        assert gaps["v"].updated < 1.3e-4
    assert found.free_run["q"].nominal > 100 * found.free_run["q"].updated
    assert found.free_run["q"].nominal > found.windows["q"].nominal  # windows start anew
    assert found.windows["q"].nominal == found.windows["q"].refitted
    assert found.windows["q"].range == pytest.approx(np.ptp(record()["q"]))


def test_a_wrong_model_starts_where_the_sensors_say_and_not_where_its_errors_pull():
    """The demo's motor has friction that the model lacks: errors are 500 times the encoder's noise."""
    motor = rl.plant("dc-motor")
    run = rl.Record.read(DEMO, inputs=["u"], outputs=["phi", "i"])
    ready = prepare(motor, port_model(motor), run, 381, {})
    problem = Problem(motor, [ready], nuisance_parameters(motor, stated_tolerances(motor, None)))
    noise, z = NoiseModel(ready.smoothed.noise_std, np.zeros((0, 2))), np.zeros(len(problem.nuisances))
    given = Fit(Hypothesis(()), z, (), 0.0, np.zeros(0), np.eye(0), noise, 0)
    found = held_out_gaps(problem, dict.fromkeys(("nominal", "refitted", "updated"), given))
    simulated = rl.simulate(motor, run.t, run.inputs["u"])  # from rest, as the record begins
    for name in ("phi", "i"):
        assert found.free_run[name].nominal == pytest.approx(rms(simulated[name] - run.outputs[name]), rel=0.15)
    # A model that starts anew is not further away than one that never does, up to the speed that it cannot hold.
    assert found.windows["i"].nominal < 1.3 * found.free_run["i"].nominal
    assert found.windows["phi"].nominal < found.free_run["phi"].nominal
    first = found.series["outputs"]["i"]
    step = ready.windows.length
    assert np.abs(first["nominal"][::step] - first["measured"][::step]).max() < 1.0  # was 60 A
