"""The blind tests' simulator against closed forms: matrix exponentials, equilibria, balances."""

import ast
from pathlib import Path

import hidden
import numpy as np
import pytest
from hidden.machine import Machine, longest_step, simulate
from scipy.linalg import expm
from scipy.optimize import brentq

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


@pytest.mark.parametrize("delay", [0.25e-3, 3e-3, 3.37e-3])
def test_a_sensor_delay_is_exact_and_leaves_the_machine_alone(delay):
    u, fine = levels(), 1e-5
    x = linear_response(A_MOTOR, B_MOTOR, np.repeat(u, 100), fine)[:, 0]
    truth = np.concatenate([np.zeros(round(delay / fine)), x])[::100][: len(u)]
    got = simulate(MOTOR._replace(y_delay=delay), u, DT)
    assert np.abs(got.y - truth).max() < 1e-6 * np.abs(truth).max()
    assert np.abs(got.phi - x[::100]).max() < 1e-6 * np.abs(x).max()


def test_both_delays_at_once():
    u = levels()
    a = simulate(MOTOR._replace(delay=2.3e-3, y_delay=3.4e-3), u, DT).y
    b = simulate(MOTOR._replace(delay=5.7e-3), u, DT).y
    assert np.abs(a - b).max() < 1e-6 * np.abs(b).max()


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


def test_the_twist_rings_at_the_two_mass_frequency():
    J1, J2, k = 0.6 * J, 0.4 * J, 0.1
    u = np.zeros(2000)
    u[:5] = 0.01
    got = simulate(PUSHED._replace(J1=J1, J2=J2, k_s=k), u, 1e-4)
    twist = (got.phi - got.load_phi)[10:]
    up = np.flatnonzero((twist[:-1] < 0) & (twist[1:] >= 0))
    crossing = up - twist[up] / (twist[up + 1] - twist[up])
    period = np.mean(np.diff(crossing)) * 1e-4
    assert 2 * np.pi / period == pytest.approx(np.sqrt(k * (1 / J1 + 1 / J2)), rel=1e-4)


def test_terminal_speed_with_quadratic_drag():
    c = 1e-7
    speed = brentq(lambda w: K * (24 - K * w) / R - B * w - c * w * w, 0, 500)
    assert settled(MOTOR._replace(drag=c), 24).omega[-1] == pytest.approx(speed, rel=1e-9)
    assert settled(MOTOR._replace(drag=c), -24).omega[-1] == pytest.approx(-speed, rel=1e-9)


def coulomb(Fc, bend=3e-5):
    return MOTOR._replace(Fc=Fc, s0=Fc / bend, s1=0.2 * np.sqrt(Fc / bend * J))


def test_breakaway_voltage_with_dry_friction():
    Fc = 6e-3
    breakaway = R * Fc / K
    assert abs(settled(coulomb(Fc), 0.97 * breakaway).phi[-1]) < 1e-3
    creeping = settled(coulomb(Fc), 1.05 * breakaway).omega[-1]
    assert creeping == pytest.approx(0.05 * breakaway / (K + R * B / K), rel=1e-6)


def test_steady_sliding_pays_the_friction_at_that_speed():
    Fc, dF, vs = 4e-3, 5e-3, 12.0
    plain = settled(coulomb(Fc), -3.0)
    assert plain.omega[-1] == pytest.approx((-3.0 + R * Fc / K) / (K + R * B / K), rel=1e-6)
    machine = coulomb(Fc + dF)._replace(Fc=Fc, dF=dF, vs=vs)
    got = settled(machine, 0.9)  # slides within the dip
    w = got.omega[-1]
    assert 1.0 < w < 2 * vs
    assert K * got.current[-1] - B * w == pytest.approx(Fc + dF * np.exp(-((w / vs) ** 2)), rel=1e-6)


def test_a_soft_bristle_is_a_spring_before_it_slides():
    Fc, bend = 0.01, 0.2
    machine = PUSHED._replace(Fc=Fc, s0=Fc / bend, s1=2 * 0.7 * np.sqrt(Fc / bend * J), b_pos=2e-5, b_neg=2e-5)
    # Dahl's curve for a slow push: F = Fc (1 - exp(-x / bend))
    got = simulate(machine, np.linspace(0, 0.8 * Fc, 20000), DT)
    assert got.phi[-1] == pytest.approx(-bend * np.log(0.2), rel=1e-2)


def test_position_dependent_friction_follows_the_position():
    Fc, P, N, a = 4e-3, 2.5e-3, 4.8, 0.7
    machine = coulomb(Fc + P)._replace(Fc=Fc, P=P, N=N, a_P=a)
    got = settled(machine, 2.0)
    slow = slice(200, None)  # past the start
    force = K * got.current[slow] - B * got.omega[slow] - J * np.gradient(got.omega, DT)[slow]
    law = Fc + P * np.cos(got.phi[slow] / N + a)
    assert np.abs(force - law)[1:-1].max() < 0.01 * P


def test_the_friction_is_resolved_by_the_steps_taken():
    machine, u = coulomb(5e-3), 0.1 * levels(1200, seed=2)
    coarse, fine = simulate(machine, u, DT), simulate(machine, u, DT, step=longest_step(machine) / 8)
    assert np.abs(coarse.phi - fine.phi).max() < 2e-4 < 1e-4 * np.ptp(fine.phi) + 2e-4


def test_asymmetric_viscous_friction_by_direction():
    machine = MOTOR._replace(b_pos=8e-5, b_neg=2e-5)
    assert settled(machine, 12).omega[-1] == pytest.approx(12 / (K + R * 8e-5 / K), rel=1e-9)
    assert settled(machine, -12).omega[-1] == pytest.approx(-12 / (K + R * 2e-5 / K), rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "force", "place"),
    [
        ({"k": 1e-3}, 0.02, 20.0),
        ({"k3": 1e-5}, 0.08, 20.0),
        ({"A": 0.03, "n": 2.0, "a_A": 0.4}, 0.02, (np.arccos(0.02 / 0.03) - 0.4) / 2 - np.arccos(0.02 / 0.03)),
        ({"T0": 0.005, "k": 1e-3}, 0.02, 15.0),
        ({"x_high": 2.0, "k_stop": 4.0, "c_stop": 0.01}, 0.2, 2.05),
        ({"x_low": -2.0, "k_stop": 4.0, "c_stop": 0.01}, -0.2, -2.05),
    ],
)
def test_loads_hold_the_machine_where_they_balance(changes, force, place):
    got = settled(PUSHED._replace(b_pos=5e-4, b_neg=5e-4, **changes), force, 20.0)
    assert abs(got.omega[-1]) < 1e-6
    assert got.phi[-1] == pytest.approx(place, rel=1e-5)


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


def test_a_weakly_damped_contact_loses_what_hunt_and_crossley_say():
    # Restitution of Hunt and Crossley's law for small losses: e = 1 - 2/3 hc v (linear contact: k d (1 + hc d')).
    machine = PUSHED._replace(x_high=1.0, k_stop=50.0, c_stop=2e-3)
    u = np.zeros(1500)
    u[:30] = 0.05
    got = simulate(machine, u, 1e-4)
    v, back = got.omega[31], -got.omega[-1]
    assert 9 < v < 11
    assert 1 - back / v == pytest.approx(2 / 3 * 2e-3 * v, rel=0.03)


def test_the_gear_takes_its_share_of_the_load_torque():
    eta, J2 = 0.7, 0.6 * J
    w = 2 * np.pi * 1000
    k = 0.24 * J * w**2
    machine = PUSHED._replace(J1=0.4 * J, J2=J2, k_s=k, c_s=0.6 * 0.24 * J * w, loss=1 / eta - 1, s0=200.0, s1=5e-3)
    got = settled(machine, 0.02, 0.5)
    acceleration = (got.omega[-1] - got.omega[200]) / (299 * DT)
    assert acceleration == pytest.approx(0.02 / (0.4 * J + J2 / eta), rel=1e-4)


def test_brush_drop_of_a_motor_that_stands():
    got = settled(MOTOR._replace(J1=10.0, Vb=0.8, i_s=4e-3), 2.0, 0.05)
    assert got.current[-1] == pytest.approx((2.0 - 0.8) / R, rel=1e-5)
    below = settled(MOTOR._replace(J1=10.0, Vb=0.8, i_s=4e-3), 0.4, 0.05).current[-1]
    assert below == pytest.approx(brentq(lambda i: R * i + 0.8 * np.tanh(i / 4e-3) - 0.4, 0, 1), rel=1e-6)


def test_the_winding_heats_as_two_thermal_masses():
    C_w, G, C_h, G_ha, n = 0.5, 0.2, 3.0, 0.1, 4000
    standing = MOTOR._replace(J1=1e3, alpha=1e-12, C_w=C_w, G_wh=G, C_h=C_h, G_ha=G_ha, L=1e-5)
    got = simulate(standing, np.full(n, 6.0), DT, step=5e-6)
    A = np.array([[-G / C_w, G / C_w], [G / C_h, -(G + G_ha) / C_h]])
    truth = linear_response(A, np.array([1 / C_w, 0]), np.full(n, 6.0**2 / R))[:, 0]
    assert got.temperature[-1] == pytest.approx(truth[-1], rel=1e-4)
    hot = simulate(standing._replace(alpha=0.0039), np.full(n, 6.0), DT, step=5e-6)
    assert hot.current[-1] == pytest.approx(6.0 / (R * (1 + 0.0039 * hot.temperature[-1])), rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "what_acts"),
    [
        ({"limit": 9.0}, lambda u: np.clip(u, -9, 9)),
        ({"dead": 0.8}, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.8, 0)),
        ({"amplify": 0.85}, lambda u: 0.85 * u),
    ],
)
def test_the_driver_changes_the_voltage_and_nothing_else(changes, what_acts):
    u = levels()
    got = simulate(MOTOR._replace(**changes), u, DT)
    assert np.array_equal(got.u, u)  # the log keeps what was asked for
    assert np.allclose(got.phi, simulate(MOTOR, what_acts(u), DT).phi, rtol=0, atol=1e-9)


def test_a_slew_limit_ramps():
    u = np.full(200, 10.0)
    got = simulate(PUSHED._replace(slew=100.0), u, DT)  # 0.1 s of ramp to 10
    assert got.omega[-1] * J == pytest.approx(0.5 * 0.1 * 10 + 0.099 * 10, rel=1e-3)


def test_sensors_read_what_they_should():
    u = levels()
    got = simulate(
        MOTOR._replace(y_gain=1.05, y_bias=0.2, y_e=0.03, y_n=1.0, y_a=0.5, i_bias=0.3), u, DT, lsb=2 * np.pi / 2000
    )
    ideal = 1.05 * got.phi + 0.2 + 0.03 * np.cos(got.phi + 0.5)
    assert np.abs(got.y - ideal).max() <= np.pi / 2000 + 1e-12
    assert np.allclose(got.y / (2 * np.pi / 2000), np.round(got.y / (2 * np.pi / 2000)), atol=1e-6)
    assert np.allclose(got.i, got.current + 0.3)


def test_field_weakening_where_torque_and_friction_balance():
    machine = MOTOR._replace(weakening=300.0)
    w = settled(machine, 5.0).omega[-1]
    k = K / (1 + (w / 300.0) ** 2)
    assert k * (5 - k * w) / R == pytest.approx(B * w, rel=1e-6)


def test_a_dead_driver_and_an_outer_load():
    n = 300
    alive = np.ones(n)
    alive[100:] = 0
    got = simulate(PUSHED, np.full(n, 0.01), DT, alive=alive)
    assert got.omega[-1] == pytest.approx(0.01 * 100e-3 / J, rel=1e-9)
    pushed = simulate(PUSHED, np.zeros(n), DT, external=np.full(n, 0.01))
    assert pushed.omega[-1] == pytest.approx(0.01 * 299e-3 / J, rel=1e-9)


def test_only_record_and_plant_come_from_robustlab():
    for file in Path(hidden.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("robustlab"):
                assert (node.module, [a.name for a in node.names]) == ("robustlab", ["Record"])
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rl":
                assert node.attr == "plant"


# --- other formulas (`hidden.laws`) ---


def test_smoothed_friction_balances_the_push_at_any_speed():
    """F tanh(v / w) + b v = u, from creeping to sliding."""
    machine = PUSHED._replace(b_pos=1e-4, b_neg=1e-4, Fc=0.01, smooth=2.0)
    for push in (0.002, -0.009, 0.02):
        speed = settled(machine, push, 3.0).omega[-1]
        assert 0.01 * np.tanh(speed / 2.0) + 1e-4 * speed == pytest.approx(push, rel=1e-6)


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_the_fall_of_stribeck_friction_has_its_exponent(power):
    machine = PUSHED._replace(b_pos=1e-3, b_neg=1e-3, Fc=0.01, dF=0.004, vs=5.0, smooth=0.01, bend_vs=power)
    speed = settled(machine, 0.02, 3.0).omega[-1]
    assert 0.01 + 0.004 * np.exp(-((speed / 5.0) ** power)) + 1e-3 * speed == pytest.approx(0.02, rel=1e-6)


def test_a_stop_of_kelvin_and_voigt_rings_as_a_linear_oscillator():
    """Held in contact by a push: the body's distance from where it comes to rest is a damped sine."""
    k, ratio, push = 50.0, 0.1, 0.5
    c = 2 * ratio * np.sqrt(k * J)
    machine = PUSHED._replace(x_high=0.0, k_stop=k, kelvin=c)
    got = simulate(machine, np.full(100, push), 1e-4)
    w = np.sqrt(k / J)
    wd, t = w * np.sqrt(1 - ratio**2), np.arange(100) * 1e-4
    depth = push / k * (1 - np.exp(-ratio * w * t) * (np.cos(wd * t) + ratio * w / wd * np.sin(wd * t)))
    assert np.abs(got.phi - depth).max() < 1e-4 * push / k


def test_a_stop_of_hertz_carries_the_three_halves_power_of_its_depth():
    machine = PUSHED._replace(x_high=0.01, k_stop=50.0, hertz=0.002, c_stop=2.0, b_pos=1e-3, b_neg=1e-3)
    depth = settled(machine, 0.5, 3.0).phi[-1] - 0.01
    assert 50.0 * depth * np.sqrt(depth / 0.002) == pytest.approx(0.5, rel=1e-6)


def test_teeth_of_kelvin_and_voigt_push_only_and_carry_their_springs_load():
    """Both bodies accelerate together behind the closed gap; parting, the damper does not hold them."""
    from hidden.machine import _shaft

    machine = PUSHED._replace(J2=J, k_s=80.0, gap=0.02, kelvin_teeth=0.01)
    got = simulate(machine, np.full(4000, 0.1), 1e-4)
    assert (got.phi - got.load_phi)[-1] - 0.01 == pytest.approx(0.05 / 80.0, rel=1e-5)
    for e in (0.012, -0.012):
        assert _shaft(machine, e, -np.sign(e) * 1e3) == 0.0
        assert _shaft(machine, e, np.sign(e)) == pytest.approx(np.sign(e) * (80.0 * 0.002 + 0.01))
    assert _shaft(machine, 0.005, 1e3) == 0.0
