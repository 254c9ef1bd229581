"""The newer physics of the blind tests' machine against closed forms and scipy's solvers."""

import numpy as np
import pytest
from hidden.excitation import BETWEEN, Drive
from hidden.machine import Machine, simulate
from hidden.plants import PLANTS
from hidden.rig import Rig
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


@pytest.mark.parametrize(("samples", "zeta"), [(8, 0.005), (15, 0.03)])
def test_free_decay_of_a_lightly_damped_oscillator(samples, zeta):
    dt = 2e-3
    w = 2 * np.pi / (samples * dt)
    u = np.zeros(1200)
    u[0] = 10.0
    got = simulate(Machine(J1=1.0, winding=0.0, gain=1.0, b_pos=2 * zeta * w, b_neg=2 * zeta * w, k=w**2), u, dt)
    # From the state at the end of the push: x = e^(-zeta w t) (x0 cos wd t + (v0 + zeta w x0)/wd sin wd t)
    t, wd = np.arange(1199) * dt, w * np.sqrt(1 - zeta**2)
    x0, v0 = got.phi[1], got.omega[1]
    truth = np.exp(-zeta * w * t) * (x0 * np.cos(wd * t) + (v0 + zeta * w * x0) / wd * np.sin(wd * t))
    assert np.abs(got.phi[1:] - truth).max() < 1e-7 * np.abs(truth).max()
    # The push itself: the step response of a second-order system, by its slow expansion in no damping.
    assert x0 == pytest.approx(10.0 / w**2 * (1 - np.cos(w * dt)), rel=0.03)


def test_coulomb_friction_takes_the_same_from_every_swing():
    k, Fc, w = 100.0, 0.4, 10.0
    u = np.zeros(4000)
    u[:60] = 40.0  # a shove
    got = simulate(Machine(J1=1.0, winding=0.0, gain=1.0, k=k, Fc=Fc, s0=Fc / 1e-6, s1=10.0), u, 1e-3)
    free = got.phi[80:]
    top = np.flatnonzero((free[1:-1] > free[:-2]) & (free[1:-1] >= free[2:])) + 1
    size = free[top][free[top] > 3 * Fc / k]
    assert len(size) >= 4
    assert np.diff(size) == pytest.approx(np.full(len(size) - 1, -4 * Fc / k), rel=2e-2)
    assert np.diff(top)[0] * 1e-3 == pytest.approx(2 * np.pi / w, rel=2e-3)


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


def test_friction_that_grows_with_the_load_both_ways():
    J1, J2, k, Fc, drive_loss, back_loss = 0.4 * J, 0.6 * J, 24.0, 1e-4, 0.15, 0.5
    w = np.sqrt(k * (1 / J1 + 1 / J2))
    damping = 0.6 * J1 * J2 / (J1 + J2) * w
    machine = PUSHED._replace(J1=J1, J2=J2, k_s=k, c_s=damping, Fc=Fc, loss=drive_loss, loss_back=back_loss,
                              s0=200.0, s1=5e-3)  # fmt: skip
    u = np.full(500, 0.02)
    u[250:] = -0.01  # brakes, long before it turns
    got = simulate(machine, u, DT)
    assert got.omega.min() >= 0.0
    speeding = (got.omega[249] - got.omega[100]) / (149 * DT)
    braking = (got.omega[499] - got.omega[350]) / (149 * DT)
    # J1 a = T - F - J2 a with F = Fc + loss |J2 a| against the motion
    assert speeding == pytest.approx((0.02 - Fc) / (J1 + J2 * (1 + drive_loss)), rel=1e-4)
    assert braking == pytest.approx((-0.01 - Fc) / (J1 + J2 * (1 - back_loss)), rel=1e-4)


def test_a_continuous_input_acts_between_its_samples():
    """A torque sin wt of 10 samples a period on an inertia: phi = (t / w - sin(wt) / w^2) / J; held it is another."""
    w, n = 2 * np.pi / (10 * DT), 300
    middle = (np.arange(BETWEEN * n) + 0.5) * DT / BETWEEN
    t = np.arange(n) * DT
    true = Drive(np.sin(w * t), np.sin(w * middle))
    rig = Rig(PLANTS["servo-axis"], PUSHED, PUSHED, {}, 0, "mid", DT)
    truth = (t / w - np.sin(w * t) / w**2) / J
    assert np.abs(rig.clean(true).phi - truth).max() < 1e-5 * truth.max()
    assert np.abs(rig.clean(Drive(true.samples)).phi - truth).max() > 1e-2 * truth.max()
