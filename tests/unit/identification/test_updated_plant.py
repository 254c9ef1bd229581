"""The plant after naming: parameters, tolerances and effects as fitted, and the same response from a file."""

from functools import cache

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import ExtendedPlant, LinearPlant, port_model
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming.updated_plant import updated_plant

T = np.arange(600) * 2e-3
U = 1.5 * np.sin(9 * T) + np.sign(np.sin(23 * T))


@cache
def problem(name: str) -> tuple[Problem, dict[str, Candidate]]:
    plant = rl.plant(name)
    model = port_model(plant)
    ready = prepare(plant, model, rl.simulate(plant, T, U), 100)
    nuisances = nuisance_parameters(plant, stated_tolerances(plant, None))
    return Problem(plant, [ready], nuisances), {c.key: c for c in candidates(plant, model, [ready])}


def fit_with(name: str, keys: tuple[str, ...], z, std) -> tuple[Problem, Fit]:
    """A fit with these standardised parameters and standard deviations, as if it had been found."""
    there, pool = problem(name)
    hypothesis = Hypothesis(tuple(pool[k] for k in keys))
    z, std = np.array(z, dtype=float), np.array(std, dtype=float)
    assert len(z) == there.size(hypothesis)
    noise = NoiseModel(np.ones(2), np.zeros((0, 2)))
    return there, Fit(hypothesis, z, (), 0.0, np.zeros(0), np.diag(std**-2.0), noise, 1)


def test_refitted_parameters_and_their_tolerances_are_the_fits():
    there, fit = fit_with("servo-axis", (), [1.2, -0.5], [0.1, 0.25])
    plant = updated_plant(there, fit, "run 7")
    assert isinstance(plant, LinearPlant)
    mass, friction = (n.spread for n in there.nuisances)
    assert plant.values["M"] == pytest.approx(95.1089 * np.exp(1.2 * mass))
    assert plant.values["Fv"] == pytest.approx(203.5034 * np.exp(-0.5 * friction))
    assert plant.parameters["M"].tolerance == pytest.approx(2 * 0.1 * mass)  # two standard deviations
    assert plant.parameters["Fv"].tolerance == pytest.approx(2 * 0.25 * friction)
    assert plant.parameters["gain"] == there.plant.parameters["gain"]  # held


def test_a_named_effect_is_attached_with_its_values_and_their_spread():
    there, pool = problem("servo-axis")
    friction = pool["coulomb-friction @ v"]
    (z,) = friction.standardised({"Fc": 20.0})
    _, fit = fit_with("servo-axis", ("coulomb-friction @ v",), [0.0, 0.0, z], [0.1, 0.1, 0.01])
    plant = updated_plant(there, fit, "fitted to run 7")
    assert isinstance(plant, ExtendedPlant)
    (effect,) = plant.effects
    assert (effect.effect.id, effect.site.name, effect.source) == ("coulomb-friction", "v", "fitted to run 7")
    assert effect.values == pytest.approx({"Fc": 20.0})
    spread = friction.parameters[0].prior.spread
    assert effect.std == pytest.approx({"Fc": 20.0 * np.sinh(0.01 * spread)})  # half of what one sigma spans
    assert plant.plant.values == there.plant.values


@pytest.mark.parametrize(
    "keys",
    [(), ("coulomb-friction @ v",), ("inertia @ M", "sensor-bias @ v"), ("backlash @ v", "input-delay @ u")],
)
def test_the_plant_responds_the_same_from_a_file(keys, tmp_path):
    there, pool = problem("servo-axis")
    size = 2 + sum(len(pool[k].parameters) for k in keys)
    _, fit = fit_with("servo-axis", keys, np.linspace(-0.8, 0.9, size), np.full(size, 0.1))
    plant = updated_plant(there, fit, "run 7")
    rl.save(tmp_path / "axis.h5", plant)
    again = rl.load(tmp_path / "axis.h5")
    assert type(again) is type(plant)
    run, same = rl.simulate(plant, T, U), rl.simulate(again, T, U)
    for name in ("q", "v"):
        assert (run[name] == same[name]).all()
    if keys:
        assert any((run[name] != rl.simulate(there.plant, T, U)[name]).any() for name in ("q", "v"))
    if isinstance(plant, ExtendedPlant):
        assert [(e.values, e.std, e.source) for e in again.effects] == [
            (e.values, e.std, e.source) for e in plant.effects
        ]


def test_the_plant_gives_what_the_fit_predicted():
    there, _ = problem("servo-axis")
    _, fit = fit_with("servo-axis", ("coulomb-friction @ v",), [0.5, 0.5, -0.2], np.full(3, 0.1))
    plant = updated_plant(there, fit, "run 7")
    factors, values = there.split(fit.hypothesis, fit.z)
    (simulator,) = there.simulators(fit.hypothesis)
    first = there.records[0].windows
    windows = type(first)(first.starts[:1], 300)
    predicted = simulator.run(factors, values, np.zeros((1, 2)), windows).outputs[0]
    run = rl.simulate(plant, T[:300], U[:300], step=2e-3)
    assert np.abs(predicted[:, 1] - run["v"]).max() < 2e-3 * np.ptp(run["v"])  # the steps of friction's law differ
