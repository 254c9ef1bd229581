"""A plant that was saved is the same plant again, and its file is a linear model to any program."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.dynamics import (
    AttachedEffect,
    Descriptor,
    LinearPlant,
    NonlinearPlant,
    Parameter,
    Scales,
    Trim,
    catalogue,
    overridden,
    port_model,
)
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


@settings(max_examples=20)
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


# --- a plant of the user's own (docs/plants.md) ----------------------------------------------------------------------


def tanks(**given):
    parameters = (
        Parameter("A1", 0.5, "m2", 0.0, "drawing 17", "cross-section of tank 1", "positive", "inertia"),
        Parameter("A2", 0.8, "m2", 0.1, "drawing 18", "cross-section of tank 2", "positive"),
        Parameter("g1", 0.02, "m2/s", 0.15, "stop watch", "outflow of tank 1 per level", "nonnegative"),
        Parameter("n", 3.0, "", 0.0, "counted", "valves", "positive"),
    )
    levels = (rl.Signal("h1", "m"), rl.Signal("h2", "m"))

    def equations(p):
        return Descriptor(
            E=[[p["A1"], 0], [0, p["A2"]]],
            F=[[-p["g1"], 0], [p["g1"], -0.01 * p["n"] ** 2]],
            G=[[1], [0]],
            C=[[1, 0], [0, 1]],
        )

    return LinearPlant(
        "tanks", overridden(parameters, given, "tanks"), (rl.Signal("u", "m3/s"),), levels, levels, equations, ("n",)
    )


def test_a_plant_of_the_users_own_keeps_parameters_tolerances_and_equations():
    plant = tanks()
    again, matrices = there_and_back(plant)
    assert again.parameters == plant.parameters
    assert again.name == "tanks"
    assert (again.inputs, again.outputs, again.states) == (plant.inputs, plant.outputs, plant.states)
    np.testing.assert_array_equal(matrices["A"], plant.state_space().A)
    changed = {"A1": 0.7, "g1": (0.03, 0.2)}
    for matrix in "ABCD":
        truth = getattr(tanks(**changed).state_space(), matrix)
        np.testing.assert_allclose(getattr(again.with_parameters(**changed).state_space(), matrix), truth, rtol=1e-14)
    sets = [p.uncertain() for p in (plant, again)]
    assert sets[0].blocks == sets[1].blocks
    delta = {"g1": 0.5, "A2": -1.0}
    np.testing.assert_allclose(sets[1].evaluate(delta).A, sets[0].evaluate(delta).A, rtol=1e-13)
    with pytest.raises(rl.InputError, match="what it does there is not known"):
        again.with_parameters(n=4.0)
    again, _ = there_and_back(again)  # and once more
    assert again.parameters == plant.parameters


def test_effects_on_a_plant_of_the_users_own_come_back():
    plant = tanks()
    made = rl.with_effects(plant, {"input-dead-zone": {"d": 0.01}, "sensor-gain@h1": {"s": 1.1}})
    again, _ = there_and_back(made)
    assert again.plant.parameters == plant.parameters
    assert again.effects == made.effects


class Pendulum(NonlinearPlant):
    """The smallest plant that is not linear."""

    def derivative(self, x, u):
        x, u = self.point(x, u)
        return np.array([x[1], -np.sin(x[0]) + u[0]])

    def output(self, x, u):
        return self.point(x, u)[0][:1]

    def jacobians(self, x, u):
        x, _ = self.point(x, u)
        a = np.array([[0.0, 1.0], [-np.cos(x[0]), 0.0]])
        return a, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))

    def with_parameters(self, **_given):
        return self

    def equilibrium(self, *_args, **_kwargs):
        return Trim("pendulum", np.zeros(2), np.zeros(1), np.zeros(1), 0.0)


def test_a_plant_that_is_a_program_is_refused_with_the_way_to_its_linear_model(tmp_path):
    angle = (rl.Signal("phi", "rad"), rl.Signal("omega", "rad/s"))
    pendulum = Pendulum("pendulum", {}, (rl.Signal("torque", "N m"),), angle[:1], angle)
    with pytest.raises(rl.InputError, match=r"pendulum: save.*not linear(.|\n)*save\(path, linearise\(plant\)\)"):
        rl.save(tmp_path / "p.h5", pendulum)
    assert not list(tmp_path.iterdir())
    rl.save(tmp_path / "p.h5", rl.linearise(pendulum, at=([0.0, 0.0], [0.0])))
    assert type(rl.load(tmp_path / "p.h5", isolate=False)) is rl.StateSpaceModel
