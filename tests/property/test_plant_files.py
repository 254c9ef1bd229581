"""A plant that was saved is the same plant again, and its file is a linear model to any program."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.dynamics.effects.attached_effect import AttachedEffect
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.dynamics.effects.effect_contract import Scales
from robustlab.dynamics.effects.port_model import port_model
from robustlab.storage import read

T = np.arange(60) * 1e-3
U = np.where(T < 0.03, 5.0, -5.0)
POSITIVE = st.floats(1e-3, 1e3)


def there_and_back(plant):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.h5"
        rl.save(path, plant)
        loaded = read(path, isolate=False)
        with h5py.File(path) as file:
            matrices = {name: file[name][()] for name in "ABCD"}
    assert (loaded.kind, loaded.verified) == ("plant", True)
    return loaded.object, matrices


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    r=POSITIVE,
    tolerance=st.floats(0.0, 0.9),
    fc=POSITIVE,
    std=st.floats(0.0, 10.0),
    source=st.text("ab /%é", max_size=8),
)
def test_values_come_back_bit_for_bit(r, tolerance, fc, std, source):
    motor = rl.plant("dc-motor", R=(r, tolerance))
    friction = AttachedEffect(catalogue()["coulomb-friction"], rl.with_effects(
        motor, {"coulomb-friction": {"Fc": fc}}).effects[0].site, {"Fc": fc}, {"Fc": std}, source)  # fmt: skip
    plant = rl.with_effects(motor, friction)
    again, matrices = there_and_back(plant)
    assert again.effects == plant.effects
    assert [(p.value, p.tolerance, p.source) for p in again.parameters.values()] == [
        (p.value, p.tolerance, p.source) for p in motor.parameters.values()
    ]
    np.testing.assert_array_equal(matrices["A"], rl.linearise(plant).A)


SCALES = Scales(force=0.02, speed=100.0, position=10.0, input=12.0, output=50.0, current=1.0)
UNITS = {"force_unit": "N m", "speed_unit": "rad/s", "position_unit": "rad"}


@pytest.mark.parametrize("name", list(catalogue()))
def test_every_effect_of_the_catalogue_is_a_plant_that_comes_back(name):
    motor = rl.plant("dc-motor")
    effect = catalogue()[name]
    for site in effect.sites(motor, port_model(motor)):
        units = UNITS if site.kind in ("joint", "current") else {}
        values = effect.starts(Scales(**{**vars(SCALES), **units}))[0]
        plant = rl.with_effects(motor, AttachedEffect(effect, site, values))
        again, _ = there_and_back(plant)
        found, truth = rl.simulate(again, T, U), rl.simulate(plant, T, U)
        for signal in ("phi", "omega", "i"):
            np.testing.assert_array_equal(found[signal], truth[signal])
        assert np.isfinite(plant.derivative(np.r_[1.0, 50.0, 0.1, np.zeros(len(plant.states) - 3)], [5.0])).all()


@pytest.mark.parametrize("name", ["dc-motor", "servo-axis", "mass-spring-damper", "two-mass", "linear-actuator"])
def test_plants_of_the_registry_come_back(name):
    plant = rl.plant(name)
    again, matrices = there_and_back(plant)
    assert again.parameters == plant.parameters
    for matrix in "ABCD":
        np.testing.assert_array_equal(matrices[matrix], getattr(plant.state_space(), matrix))


@pytest.mark.parametrize("motors", [False, True])
def test_the_platform_comes_back(motors):
    plant = rl.plant("stewart-platform", motors=motors, preset="physical", platform_mass=3.3)
    again, _ = there_and_back(plant)
    assert (again.motors, again.preset, again.parameters) == (motors, "physical", plant.parameters)


def test_effects_on_a_bare_model_come_back():
    model = rl.linearise(rl.plant("servo-axis"))
    plant = rl.with_effects(model, {"coulomb-friction": {"Fc": 0.2}}).with_parameters(gain_u=1.1, inertia_v=1.2)
    again, _ = there_and_back(plant)
    assert again.values == plant.values
    np.testing.assert_array_equal(rl.simulate(again, T, U)["q"], rl.simulate(plant, T, U)["q"])
