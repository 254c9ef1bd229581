"""The blind tests' simulator against closed forms: matrix exponentials, equilibria, balances."""

import ast
from pathlib import Path

import hidden
import numpy as np
import pytest
from hidden.machine import Machine, simulate
from scipy.integrate import solve_ivp
from scipy.linalg import expm

DT = 1e-3
R, L, K, J, B = 2.07, 0.62e-3, 0.0525, 1.5e-5, 1e-5
MOTOR = Machine(J1=J, R=R, L=L, Kt=K, Ke=K, b_pos=B, b_neg=B)
PUSHED = Machine(J1=J, winding=0.0, gain=1.0)  # u is a torque
A_MOTOR = np.array([[0, 1, 0], [0, -B / J, K / J], [0, -K / L, -R / L]])
B_MOTOR = np.array([0, 0, 1 / L])


def linear_response(A, B, u, dt=DT):
    """States (n, n_x) of x' = A x + B u from zero, u held over each sample: exact."""
    nx = len(A)
    block = np.zeros((nx + 1, nx + 1))
    block[:nx, :nx], block[:nx, nx] = A, B
    step = expm(block * dt)
    x = np.zeros((len(u), nx))
    for k in range(len(u) - 1):
        x[k + 1] = step[:nx, :nx] @ x[k] + step[:nx, nx] * u[k]
    return x


def levels(n=600, seed=0):
    return np.repeat(np.random.default_rng(seed).uniform(-20, 20, n // 40), 40)


def settled(machine, u, seconds=1.0):
    return simulate(machine, np.full(round(seconds / DT), float(u)), DT)


def test_the_linear_motor_is_the_matrix_exponential():
    u = levels()
    x, got = linear_response(A_MOTOR, B_MOTOR, u), simulate(MOTOR, u, DT)
    for seen, truth in ((got.phi, x[:, 0]), (got.omega, x[:, 1]), (got.current, x[:, 2])):
        assert np.abs(seen - truth).max() < 1e-6 * np.abs(truth).max()
    assert np.array_equal(got.y, got.phi)
    assert np.array_equal(got.i, got.current)


@pytest.mark.parametrize("delay", [0.25e-3, 3e-3, 3.37e-3])
def test_an_input_delay_is_exact_between_the_samples_too(delay):
    u, fine = levels(), 1e-5
    x = linear_response(A_MOTOR, B_MOTOR, np.concatenate([np.zeros(round(delay / fine)), np.repeat(u, 100)]), fine)
    truth = x[::100][: len(u), 0]
    got = simulate(MOTOR._replace(delay=delay), u, DT).phi
    assert np.abs(got - truth).max() < 1e-6 * np.abs(truth).max()


def test_two_bodies_on_a_shaft_are_the_matrix_exponential():
    J1, J2, k, c = 0.6 * J, 0.4 * J, 0.4, 8e-4
    A = np.array(
        [
            [0, 1, 0, 0, 0],
            [-k / J1, -(B + c) / J1, k / J1, c / J1, K / J1],
            [0, 0, 0, 1, 0],
            [k / J2, c / J2, -k / J2, -c / J2, 0],
            [0, -K / L, 0, 0, -R / L],
        ]
    )
    u = levels()
    x = linear_response(A, np.array([0, 0, 0, 0, 1 / L]), u)
    got = simulate(MOTOR._replace(J1=J1, J2=J2, k_s=k, c_s=c), u, DT)
    assert np.abs(got.phi - x[:, 0]).max() < 1e-6 * np.abs(x[:, 0]).max()
    assert np.abs(got.load_phi - x[:, 2]).max() < 1e-6 * np.abs(x[:, 2]).max()


def coulomb(Fc, bend=3e-5):
    return MOTOR._replace(Fc=Fc, s0=Fc / bend, s1=0.2 * np.sqrt(Fc / bend * J))


def test_steady_sliding_pays_the_friction_at_that_speed():
    Fc, dF, vs = 4e-3, 5e-3, 12.0
    plain = settled(coulomb(Fc), -3.0)
    assert plain.omega[-1] == pytest.approx((-3.0 + R * Fc / K) / (K + R * B / K), rel=1e-6)
    machine = coulomb(Fc + dF)._replace(Fc=Fc, dF=dF, vs=vs)
    got = settled(machine, 0.9)  # slides within the dip
    w = got.omega[-1]
    assert 1.0 < w < 2 * vs
    assert K * got.current[-1] - B * w == pytest.approx(Fc + dF * np.exp(-((w / vs) ** 2)), rel=1e-6)


def test_backlash_free_flight_momentum_and_loss():
    u = np.zeros(4000)
    u[:20] = 0.01
    J1, J2, gap = 0.6 * J, 0.4 * J, 0.1
    got = simulate(PUSHED._replace(J1=J1, J2=J2, k_s=20.0, gap=gap, hc=0.1), u, 1e-4)
    momentum = J1 * got.omega + J2 * got.load_omega
    assert momentum[25:] == pytest.approx(0.01 * 20e-4, rel=1e-9)
    twist = np.abs(got.phi - got.load_phi)
    assert (np.abs(np.diff(got.load_omega))[(twist < gap / 2)[:-1] & (twist < gap / 2)[1:]] < 1e-12).mean() > 0.99
    energy = 0.5 * J1 * got.omega**2 + 0.5 * J2 * got.load_omega**2
    flying = energy[25:][twist[25:] < gap / 2]
    assert (np.diff(flying) < 1e-6 * flying[0]).all()  # impacts only take energy
    kept = 0.5 * (0.01 * 20e-4) ** 2 / J  # by the centre of mass
    assert 0 < flying[-1] - kept < 0.5 * (flying[0] - kept)


def test_only_record_and_plant_come_from_robustlab():
    for file in Path(hidden.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("robustlab"):
                assert (node.module, [a.name for a in node.names]) == ("robustlab", ["Record"])
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rl":
                assert node.attr == "plant"


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
