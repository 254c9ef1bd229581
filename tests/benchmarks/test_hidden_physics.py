"""The newer physics of the blind tests' machine against closed forms and scipy's solvers."""

import numpy as np
import pytest
from hidden.machine import Machine, simulate
from scipy.integrate import solve_ivp

DT = 1e-3
J = 1.5e-5
PUSHED = Machine(J1=J, winding=0.0, gain=1.0)  # u is a torque


def ode(rates, x0, n, u, dt=DT):
    """States (n, n_x) of a smooth ODE x' = rates(t, x, u) with u (n,) held over each sample."""
    out = np.zeros((n, len(x0)))
    out[0] = x0
    for k in range(n - 1):
        span = (k * dt, (k + 1) * dt)
        out[k + 1] = solve_ivp(rates, span, out[k], "DOP853", args=(u[k],), rtol=1e-10, atol=1e-13).y[:, -1]
    return out


def test_a_pendulum_swings_and_turns_over():
    mgl, rest, b = 5e-3, 0.7, 2e-5
    u = np.repeat(np.random.default_rng(3).uniform(-15e-3, 15e-3, 5), 80)
    truth = ode(lambda t, x, f: [x[1], (f - b * x[1] - mgl * np.sin(x[0] - rest)) / J], [0.0, 0.0], len(u), u)
    got = simulate(PUSHED._replace(b_pos=b, b_neg=b, grav=mgl, x_grav=rest), u, DT)
    assert np.ptp(truth[:, 0]) > np.pi
    assert np.abs(got.phi - truth[:, 0]).max() < 1e-7 * np.ptp(truth[:, 0])


@pytest.mark.parametrize("gamma", [0.0, 0.25, 0.5])
def test_a_bouc_wen_loop(gamma):
    k, yields = 4e-3, 0.8
    b = 3e-5
    u = 6e-3 * np.sin(2 * np.pi * 4 * np.arange(500) * DT)

    def rates(t, x, f):
        # z' = v - beta |v| z - gamma v |z| (exponent 1), beta + gamma = 1 at the yield
        r = x[2] / yields
        dz = x[1] - (1 - gamma) * abs(x[1]) * r - gamma * x[1] * abs(r)
        return [x[1], (f - b * x[1] - k * x[2]) / J, dz]

    truth = ode(rates, [0.0, 0.0, 0.0], len(u), u)
    machine = PUSHED._replace(b_pos=b, b_neg=b, k_h=k, x_h=yields, gamma_h=gamma)
    got = simulate(machine, u, DT)
    assert np.abs(truth[:, 2]).max() > 0.9 * yields  # it yields
    assert np.abs(got.phi - truth[:, 0]).max() < 1e-5 * np.ptp(truth[:, 0])


def test_a_one_sided_spring_throws_back_what_it_is_given():
    k, place = 0.06, 0.2
    u = np.zeros(500)
    u[:10] = 3e-3
    got = simulate(PUSHED._replace(side=1.0, x_side=place, k_side=k), u, DT)
    v, w = 3e-3 * 10 * DT / J, np.sqrt(k / J)
    assert got.phi.max() == pytest.approx(place + v / w, rel=1e-3)  # sampled at its top
    assert got.omega[-1] == pytest.approx(-v, rel=1e-6)
    inside = (got.phi > place).sum() * DT
    assert inside == pytest.approx(np.pi / w, abs=2 * DT)
    mirrored = simulate(PUSHED._replace(side=-1.0, x_side=-place, k_side=k), -u, DT)
    assert np.array_equal(mirrored.phi, -got.phi)
