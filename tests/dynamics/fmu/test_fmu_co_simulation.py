"""Co-simulation: a unit by pythonfmu against its closed form, and one of our own in C."""

from __future__ import annotations

import fmu_units as units
import numpy as np
import pytest
from fmu_units import needs_compiler

import robustlab as rl
from robustlab.dynamics.fmu import FmuPlant
from robustlab.errors import NativeTimeout, UnitMismatch, UsageError

T = np.linspace(0.0, 1.0, 101)


@pytest.fixture(scope="module")
def motor(folder):
    return rl.plant(str(units.python_motor(folder)), J=(0.02, 0.2))


def speed(t, J=0.02, u=2.0):
    return 0.5 * u * (1 - np.exp(-0.1 / J * t))


def test_a_python_unit_follows_its_closed_form(motor):
    record = rl.simulate(motor, T, np.full(101, 2.0))
    np.testing.assert_allclose(record["omega"], speed(T), atol=1e-14)
    slower = motor.with_parameters(J=0.05)
    np.testing.assert_allclose(rl.simulate(slower, T, 2 * np.ones(101))["omega"], speed(T, 0.05), atol=1e-14)
    np.testing.assert_allclose(rl.simulate(motor, T, 2 * np.ones(101), step=1e-3)["omega"], speed(T), atol=1e-13)


def test_a_record_is_compared_from_the_initial_state(motor):
    measured = rl.Record(T, {"u": 2 * np.ones(101)}, {"omega": speed(T) + 0.01}, {"omega": "rad/s"}, "run 1")
    found = rl.compare(motor, measured)
    assert found.to_json(series=False) == motor.compare(measured).to_json(series=False)
    assert found.gaps["omega"]["rms"] == pytest.approx(0.01)
    assert found.gaps["omega"]["peak"] == pytest.approx(0.01)
    assert "free run from the unit's own initial state" in found.summary()
    assert found.to_json()["gaps"]["omega"]["fit"] < 100
    with pytest.raises(rl.InputError, match="no input 'u'"):
        motor.compare(rl.Record(T, {"F": T}, {"omega": T}))
    with pytest.raises(rl.InputError, match="no output in common"):
        rl.compare(motor, rl.Record(T, {"u": T}, {"phi": T}))
    for option in ({"window": 0.1}, {"lags": 5}, {"repeats": [measured]}):
        with pytest.raises(UsageError, match="runs from its own initial state"):
            rl.compare(motor, measured, **option)


def test_samples_over_parameters(motor):
    answer = rl.sample(motor, 0, vertices="all").respond(T, 2.0)
    np.testing.assert_allclose(answer.y[0, :, 0], speed(T, 0.016), atol=1e-14)
    np.testing.assert_allclose(answer.y[1, :, 0], speed(T, 0.024), atol=1e-14)


def test_what_has_no_meaning_is_refused_with_the_reason(motor):
    with pytest.raises(rl.InputError, match="offers no directional derivatives"):
        rl.linearise(motor)
    with pytest.raises(rl.InputError, match="shows no rates"):
        rl.trim(motor)
    with pytest.raises(rl.InputError, match="a unit for co-simulation, expected one for model-exchange"):
        FmuPlant(motor.process.path)
    with pytest.raises(rl.InputError, match="'zoh'"):
        rl.simulate(motor, T, T, hold="foh")
    with pytest.raises(rl.InputError, match="a program"):
        rl.save("never.h5", motor)
    with pytest.raises(rl.InputError, match="interface"):
        rl.plant(str(motor.process.path), interface="both")


def test_an_exception_in_a_python_unit_is_an_error_and_a_loop_a_timeout(motor):
    with pytest.raises(rl.NoTrustworthyNumber, match="fmi2DoStep failed"):
        rl.simulate(motor, T, np.full(101, 2e3))
    hanging = rl.plant(str(motor.process.path), time_limit=1.0)
    with pytest.raises(NativeTimeout):
        rl.simulate(hanging, T, np.full(101, -2e3))
    assert np.isfinite(rl.simulate(motor, T, T)["omega"]).all()


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_a_unit_with_directional_derivatives_has_a_linear_model(unit, version):
    plant = rl.plant(unit(version), interface="co-simulation", k3=4.0)
    model = rl.linearise(plant)
    np.testing.assert_allclose(model.A, [[0, 1], [-(8 + 12 * 0.25) / 2, -0.2]], atol=1e-14)
    np.testing.assert_allclose(model.D, [[0], [0.5]])
    assert model.state_names == ("q", "v")
    assert model.operating_point.x.tolist() == [0.5, 0.0]
    truth = rl.simulate(rl.plant("mass-spring-damper", m=2.0, c=0.4, k=8.0), T, np.sin(T), [0.5, 0.0])
    linear = plant.with_parameters(k3=0.0)
    np.testing.assert_allclose(rl.simulate(linear, T, np.sin(T))["q"], truth["q"], atol=1e-10)
    uneven = np.cumsum(np.linspace(0.01, 0.02, 50))
    if version == 2:
        assert np.isfinite(rl.simulate(linear, uneven, np.sin(uneven))["q"]).all()
    else:
        with pytest.raises(rl.InputError, match="steps that differ"):
            rl.simulate(linear, uneven, np.sin(uneven))
    with pytest.raises(rl.InputError, match="initial state"):
        rl.linearise(plant, at=([], [1.0]))
    wrong = rl.Record(T, {"F": T}, {"q": T}, {"F": "A"})
    with pytest.raises(UnitMismatch):
        plant.compare(wrong)
    with pytest.raises(rl.NoTrustworthyNumber, match="is nan at t ="):
        rl.simulate(plant.with_parameters(fault=3), T, T)


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_units_and_their_free_run_show_themselves(unit, plant_of, version):
    run = rl.plant(unit(version), interface="co-simulation")
    response = rl.simulate(run, T, np.sin(T))
    record = rl.Record(T, {"F": np.sin(T)}, {"q": response["q"] + 0.01}, {"F": "N", "q": "m"}, "day one")
    free = run.compare(record)
    for shown in (plant_of(version), run, free):
        lines = repr(shown).splitlines()
        assert lines[0].startswith(type(shown).__name__)
        assert len(lines) <= 6
        assert len(repr(shown)) <= 600
        assert shown._repr_html_().startswith("<table>")
        with pytest.raises(rl.InputError, match="nothing to draw"):
            shown.plot()
    assert repr(free).splitlines()[0] == "FreeRun (converged)"
    assert "q: rms 0.01 m, peak 0.01 m, fit " in repr(free)
    assert free.summary().splitlines()[0] == repr(free).splitlines()[0]
