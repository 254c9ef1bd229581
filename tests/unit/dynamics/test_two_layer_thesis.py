"""Two-layer control: gains by their polynomials, and section 9.1.3 of the thesis (THESIS items 20-25)."""

import math

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import SineTrajectory, closed_loop, follow, torque_gains, two_layer

MOTOR = {"R": 2.07, "L": 0.62e-3, "Km": 0.052, "Kb": 0.052, "Kf": 4.8e-5}
SIZE = np.array([5e-3] * 3 + [20e-3] * 3)
T = np.arange(0.0, 5.0005, 1e-3)


@pytest.fixture(scope="module")
def machines():
    return {preset: rl.plant("stewart-platform", preset=preset, motors=True) for preset in ("thesis", "physical")}


@pytest.fixture(scope="module")
def following(machines):
    """Runs by (preset, signs, rise time), each made once."""
    made = {}

    def run(preset, signs="++++++", rise=0.0):
        key = (preset, signs, rise)
        if key not in made:
            amplitude = SIZE * [1 if s == "+" else -1 for s in signs]
            plant = machines[preset]
            path = SineTrajectory(plant.geometry.home, amplitude=amplitude, rise_time=rise)
            made[key] = follow(plant, two_layer(plant), path, T)
        return made[key]

    return run


def test_torque_loop_has_its_triple_pole_with_a_free_rotor():
    gains, p = torque_gains(1700.0, J=7.2e-6, **MOTOR), 1700.0
    motor = rl.plant("dc-motor").state_space()
    a, b = motor.A[1:, 1:], motor.B[1:]  # omega, i
    torque = np.array([[-MOTOR["Kf"], MOTOR["Km"]]])
    # u = sigma - kd m, sigma' = ki xi - kp m, xi' = m_ref - m
    loop = np.block(
        [
            [a - b @ torque * gains.kd, np.zeros((2, 1)), b],
            [-torque, np.zeros((1, 2))],
            [-gains.kp * torque, np.array([[gains.ki, 0.0]])],
        ]
    )
    found = np.sort_complex(np.linalg.eigvals(loop))
    # four states: -p three times, and the speed, which a torque does not bring back, at zero
    assert abs(found[-1]) < 1e-6 * p
    np.testing.assert_allclose(np.poly(found[:3]), np.poly([-p] * 3), rtol=1e-8)


def test_upper_loop_has_its_triple_pole_in_every_channel(machines):
    p = 236.0
    upper = two_layer(machines["thesis"], p_up=p).upper
    model = rl.linearise(rl.plant("stewart-platform"))
    b, none = model.B[6:], np.zeros((6, 6))
    loop = np.block(
        [
            [none, np.eye(6), none],
            [model.A[6:, :6] + b @ upper.D[:, 6:12], model.A[6:, 6:] + b @ upper.D[:, 12:], b @ upper.C],
            [-np.eye(6), none, none],
        ]
    )
    scale = np.repeat([1.0, p, 1.0 / p], 6)
    shifted = (loop * scale / scale[:, None]) / p + np.eye(18)  # states measured so that all entries are near one
    assert np.abs(np.linalg.matrix_power(shifted, 3)).max() < 1e-10  # (A + p)^3 = 0: Cayley-Hamilton in each channel


@pytest.mark.parametrize(
    ("preset", "unstable", "stable"),
    [("thesis", (1000, 1500, 2000), (2200, 3000, 10000)), ("physical", (1000, 1400), (1500, 2200, 3000))],
)
def test_stable_poles_of_the_lower_layer(machines, preset, unstable, stable):  # item 25
    plant = machines[preset]
    for p_low in unstable:
        assert closed_loop(plant, two_layer(plant, p_low=p_low)).poles().real.max() > 0
    for p_low in stable:
        model = closed_loop(plant, two_layer(plant, p_low=p_low))
        assert model.poles().real.max() < -1
        np.testing.assert_allclose(model.dc_gain()[:6], np.eye(6), atol=1e-7)


def test_tracking_error(following):  # items 20, 21
    p, omega = 236.0, math.pi
    share = abs(1 - (p / (1j * omega + p)) ** 3)
    error = following("thesis").largest_error(after=3.0)
    np.testing.assert_allclose(error[:3] * 1e3, 0.200, atol=0.005)
    np.testing.assert_allclose(error[3:] * 1e3, 0.799, atol=0.02)
    np.testing.assert_allclose(error, SIZE * share, rtol=2e-3)
    assert following("thesis").largest_error()[:3].max() * 1e3 < 0.2
    assert following("thesis").largest_error()[3:].max() * 1e3 < 0.8


def test_torque_and_voltage_are_within_the_motors_limits(following):  # items 22, 23
    run = following("thesis")
    assert run.largest_torque().max() == pytest.approx(0.0087, abs=2e-4)
    assert run.largest_voltage().max() == pytest.approx(20.8, abs=0.05)
    assert run.within_limits
    np.testing.assert_allclose(run.torque[0], 0.8701e-3, rtol=1e-4)  # item 7: holds before it moves


def test_small_motions_are_those_of_the_linear_loop(machines):
    plant, t = machines["physical"], np.arange(0, 0.6, 1e-3)
    controller = two_layer(plant)
    path = SineTrajectory(plant.geometry.home, (0, 0, 1e-6, 0, 0, 0), SIZE * 1e-4, 20.0, 0.1, 0.2)
    run = follow(plant, controller, path, t, rtol=1e-9)
    model = closed_loop(plant, controller)
    from robustlab.dynamics import stewart

    angles = stewart.nut_angles(plant.geometry, path.pose(t))
    linear = rl.simulate(model, t, angles, hold="foh")
    for i in range(1, 7):
        size = np.abs(run.phi[:, i - 1]).max()
        np.testing.assert_allclose(run.phi[:, i - 1], linear[f"phi_{i}"], atol=1e-3 * size)
        torque = run.torque[:, i - 1] - controller.at.u[i - 1] / MOTOR["R"] * MOTOR["Km"]
        np.testing.assert_allclose(torque, linear[f"torque_{i}"], atol=5e-3 * np.abs(torque).max())
        volts = run.voltage[:, i - 1] - controller.at.u[i - 1]
        np.testing.assert_allclose(volts, linear[f"u_{i}"], atol=5e-3 * np.abs(volts).max())
