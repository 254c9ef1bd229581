"""Parameter effects against plants rebuilt with the scaled values."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import Simulator, Site, effect, linear_plant_of, port_model
from robustlab.statespace import StateSpaceModel

CASES = [
    ("dc-motor", "inertia", "J", ("J",)),
    ("dc-motor", "viscous-friction", "Kf", ("Kf",)),
    ("dc-motor", "torque-constant", "Km+Kb", ("Km", "Kb")),
    ("dc-motor", "resistance", "R", ("R",)),
    ("linear-actuator", "inertia", "J+J_nut+m_screw+m_cart", ("J", "J_nut", "m_screw", "m_cart")),
    ("two-mass", "inertia", "J2", ("J2",)),
    ("two-mass", "stiffness", "k", ("k",)),
    ("mass-spring-damper", "viscous-friction", "c", ("c",)),
]


def matrices(plant, effects, values):
    return Simulator(plant, effects, np.zeros((2, len(plant.inputs))), 1e-3).model({}, values)


@pytest.mark.parametrize(("name", "identity", "label", "scaled"), CASES)
@pytest.mark.parametrize("s", [0.3, 1.0, 2.7])
def test_the_model_is_the_plant_with_those_values(name, identity, label, scaled, s):
    plant = rl.plant(name)
    site = Site("parameter", label)
    assert site in effect(identity).sites(plant, port_model(plant))
    found = matrices(plant, [(effect(identity), site)], [{"s": s}])
    rebuilt = rl.plant(name, **{p: s * plant.parameters[p].value for p in scaled}).state_space()
    np.testing.assert_allclose(found.A, rebuilt.A, rtol=1e-12)
    np.testing.assert_allclose(found.B, rebuilt.B, rtol=1e-12)


def test_stiffness_at_a_joint_is_a_spring_to_ground():
    motor = rl.plant("dc-motor", J=2e-5)
    site = Site("joint", "omega")
    assert effect("stiffness").sites(motor, port_model(motor)) == (site,)
    found = matrices(motor, [(effect("stiffness"), site)], [{"k": 0.4}])
    expected = motor.state_space().A.copy()
    expected[1, 0] -= 0.4 / 2e-5
    np.testing.assert_allclose(found.A, expected, rtol=1e-12)


def test_a_bare_model():
    a = np.array([[0.0, 1.0], [-9.0, -0.6]])
    model = StateSpaceModel(
        a, [[0.0], [2.0]], np.eye(2), np.zeros((2, 1)), 0.0, ["u"], ["q", "v"], [("q", "m"), ("v", "m/s")]
    )
    plant = linear_plant_of(model)
    sites = effect("viscous-friction").sites(plant, port_model(plant))
    assert sites == (Site("parameter", "damping_v"),)
    found = matrices(plant, [(effect("viscous-friction"), sites[0])], [{"s": 3.0}])
    np.testing.assert_allclose(found.A, [[0.0, 1.0], [-9.0, -1.8]], rtol=1e-12)


def test_a_joint_without_a_position_takes_no_spring():
    a = [[-5.0]]
    plant = linear_plant_of(StateSpaceModel(a, [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["w"], [("omega", "rad/s")]))
    assert effect("stiffness").sites(plant, port_model(plant)) == ()
