"""Ports of linear plants, groups of parameters, bare models as plants, and the windowed simulator, by closed forms."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import Simulator, Windows, linear_plant_of, parameter_groups, port_model
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel

MOTOR = rl.plant("dc-motor")


# --- ports -----------------------------------------------------------------------------------------------------------


def test_a_motor_has_a_joint_with_its_angle_and_a_current_port():
    model = port_model(MOTOR)
    assert list(model.ports) == ["omega", "i"]
    joint, current = model.ports["omega"], model.ports["i"]
    assert (joint.kind, joint.unit, joint.speed_unit, joint.position_unit) == ("joint", "N m", "rad/s", "rad")
    assert joint.force == pytest.approx([0, 1 / 7.2e-6, 0], rel=1e-12)  # a torque of 1 N m turns the rotor at 1/J
    assert joint.velocity.tolist() == [0, 1, 0]
    assert joint.position is not None
    assert joint.position.tolist() == [1, 0, 0]
    assert (current.kind, current.unit) == ("current", "V")
    assert current.force == pytest.approx([0, 0, 1 / 0.62e-3], rel=1e-12)  # 1 V into the coil: di/dt = 1/L
    assert current.position is None


# --- bare models -----------------------------------------------------------------------------------------------------


def bare(plant) -> StateSpaceModel:
    m = plant.state_space()
    return StateSpaceModel(m.A, m.B, m.C, m.D, inputs=plant.inputs, outputs=plant.outputs, states=plant.states)


def test_a_bare_model_becomes_a_plant_with_the_same_matrices():
    model = bare(MOTOR)
    plant = linear_plant_of(model)
    for there, here in zip(
        (plant.state_space().A, plant.state_space().B, plant.state_space().C), (model.A, model.B, model.C), strict=True
    ):
        assert there == pytest.approx(here, rel=1e-14)
    assert plant.values == pytest.approx({"gain_u": 1.0, "inertia_omega": 7.2e-6, "damping_omega": 4.8e-5})
    assert {label: role for role, label, _ in parameter_groups(plant)} == {
        "gain_u": "input-gain", "inertia_omega": "inertia", "damping_omega": "viscous-friction",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("plant", "speed", "inertia", "unit"),
    [
        (MOTOR, "omega", 7.2e-6, "N m"),  # J of its parameters, from the motor constant
        (rl.plant("dc-motor", J=3e-5, Kb=-0.02, Km=-0.02), "omega", 3e-5, "N m"),  # wired the other way round
        (rl.plant("mass-spring-damper", m=2.5), "v", 2.5, "N"),  # from the input force
        (rl.plant("two-mass", J1=2e-3), "omega1", 2e-3, "N m"),
        (rl.plant("two-mass", J1=2e-3), "omega2", None, "N m/(kg m2)"),  # only a spring drives it
        (rl.plant("servo-axis"), "v", None, "N/kg"),  # volts act on it at once: its gain may be anything
    ],
)
def test_a_bare_models_forces_have_their_unit_where_the_inertia_is_known(plant, speed, inertia, unit):
    model = bare(plant)
    joint = port_model(linear_plant_of(model)).ports[speed]
    assert joint.unit == unit
    k = model.state_names.index(speed)
    assert joint.force == pytest.approx(np.eye(model.n_states)[k] / (inertia or 1.0), rel=1e-12)
    assert linear_plant_of(model).values[f"inertia_{speed}"] == pytest.approx(inertia or 1.0, rel=1e-12)


def test_discrete_models_and_other_objects_are_rejected():
    model = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.01)
    with pytest.raises(InputError, match=r"discover.*discrete model \(dt = 0.01 s\).*continuous"):
        linear_plant_of(model, "discover")
    with pytest.raises(InputError, match=r"effects.*a dict.*linear Plant or a StateSpaceModel"):
        linear_plant_of({})  # type: ignore[arg-type]


# --- windows ---------------------------------------------------------------------------------------------------------

T = np.arange(600) * 2e-3
U = np.sin(9 * T) + 0.4 * np.sign(np.sin(23 * T))
PARAMETERS = {"M": 1.1, "Fv": 0.6}


def test_windows_are_the_plants_own_response_from_their_starts():
    plant = rl.plant("servo-axis")
    true = plant.with_parameters(**{n: f * plant.values[n] for n, f in PARAMETERS.items()})
    run = rl.simulate(true, T, U, x0=[0.1, -0.2])
    starts = np.array([0, 150, 437])
    x0 = np.column_stack([run["q"][starts], run["v"][starts]])
    motion = Simulator(plant, [], U[:, None], 2e-3).run(PARAMETERS, [], x0, Windows(starts, 160))
    expected = np.stack([np.column_stack([run["q"], run["v"]])[s : s + 160] for s in starts])
    assert np.abs(motion.outputs - expected).max() < 1e-12
    assert motion.forces.shape == (3, 160, 0)
