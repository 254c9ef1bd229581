"""A driver with a dead zone between controller and plant, against an independent integrator."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import controlled_plant, driver_in_loop
from robustlab.errors import InputError

T = np.linspace(0.0, 2.0, 8001)
WAVE = 3.0 * np.sin(np.pi * T)
# u = 2 (r - phi) - 0.02 omega behind a lag of 5 ms
K = rl.StateSpaceModel([[-200.0]], [[400.0, -400.0, -4.0]], [[1.0]], [[0.0, 0.0, 0.0]])


def loop(plant, K=K):
    return controlled_plant(plant, K, ["phi"], ["phi", "omega"])


def integrated(G, d):
    """The motor's angle by classical Runge-Kutta steps, the reference held in each."""

    def rate(x, r):
        seen = np.sign(x[3]) * max(abs(x[3]) - d, 0.0)
        return np.append(G.A @ x[:3] + G.B[:, 0] * seen, 400.0 * (r - x[0]) - 4.0 * x[1] - 200.0 * x[3])

    x, h, angle = np.zeros(4), T[1], [0.0]
    for r in WAVE[:-1]:
        k1 = rate(x, r)
        k2 = rate(x + h / 2 * k1, r)
        k3 = rate(x + h / 2 * k2, r)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, r))
        angle.append(x[0])
    return np.array(angle)


@pytest.mark.parametrize("d", [0.0, 0.4, 1.0])
def test_the_dead_zone_acts_on_the_command(d):
    motor = rl.plant("dc-motor")
    made = loop(motor)
    run = rl.simulate(rl.with_effects(made, driver_in_loop(made, motor, "u", {"d": d})), T, WAVE)
    truth = integrated(motor.state_space(), d)
    assert run["phi"] == pytest.approx(truth, abs=6e-3)  # the law sees the command of the step before
    assert np.abs(WAVE - run["phi"]).max() > 0.3 * d / 2


def test_a_direct_term_is_rejected():
    motor = rl.plant("dc-motor")
    direct = loop(motor, rl.StateSpaceModel([], [], [], [[2.0, -2.0, -0.02]]))
    with pytest.raises(InputError, match="direct term"):
        driver_in_loop(direct, motor, "u", {"d": 1.0})
