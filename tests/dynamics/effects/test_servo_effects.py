"""Gravity, lag, directional friction, ripple over time and one-sided contacts against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

import robustlab as rl
from robustlab.dynamics import Simulator, Site, Windows, effect, linear_plant_of
from robustlab.errors import InputError
from robustlab.statespace import Signal, StateSpaceModel

ROUND = Site("joint", "w")


def disc(stiffness=0.0, damping=0.0):
    """A body of the inertia 1 that turns: forces are accelerations."""
    states = (Signal("q", "rad"), Signal("w", "rad/s"))
    model = StateSpaceModel(
        [[0, 1], [-stiffness, -damping]], [[0], [1]], [[1, 0]], [[0]], inputs=["u"], outputs=["q"], states=states
    )
    return linear_plant_of(model)


def turned(pairs, n, h, x0=(0.0, 0.0), u=None, plant=None):
    """States (n, 2) of the disc with effects, in steps of exactly h."""
    force = np.zeros(n) if u is None else u
    run = Simulator(plant or disc(), [(effect(name), ROUND) for name, _ in pairs], force[:, None], h)
    run.sub, run.held = 1, force[:, None].copy()
    return run.run({}, [values for _, values in pairs], np.array([x0]), Windows(np.array([0]), n)).states[0]


# --- gravity ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("zero", [0.0, 0.7, math.pi / 2])
def test_a_pendulum_swings_with_its_period_about_its_own_zero_and_keeps_its_energy(zero):
    mgl, swing = 30.0, 1.2
    values = {"G": mgl * math.cos(zero), "H": -mgl * math.sin(zero)}
    q, v = turned([("pendulum-gravity", values)], 20000, 1e-3, (zero + swing, 0.0)).T
    energy = 0.5 * v**2 - mgl * np.cos(q - zero)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert (q.min(), q.max()) == pytest.approx((zero - swing, zero + swing), abs=2e-3)
    down = np.flatnonzero((q[:-1] > zero) & (q[1:] <= zero))
    crossing = 1e-3 * (down + (q[down] - zero) / (q[down] - q[down + 1]))
    period = 4 * ellipk(math.sin(swing / 2) ** 2) / math.sqrt(mgl)
    assert np.diff(crossing).mean() == pytest.approx(period, rel=1e-5)


# --- lag -------------------------------------------------------------------------------------------------------------


@given(st.floats(-5, 1).map(lambda e: 10.0**e), st.sampled_from([1e-4, 1e-3, 1e-2]), st.integers(0, 99))
def test_a_lagged_step_is_the_mean_of_the_exact_one(T, h, seed):
    """Of a held input: x' = (u - x) / T piece by piece, with the mean of x from its own balance."""
    u = np.random.default_rng(seed).normal(size=40)
    found, x, expected = effect("actuator-lag").input(u, {"T": T}, h), u[0], []
    for level in u:
        end = level + (x - level) * math.exp(-h / T)
        expected.append(level - T * (end - x) / h)
        x = end
    np.testing.assert_allclose(found, expected, atol=1e-10 * max(1.0, T / h))


def test_a_motor_behind_a_lag_follows_the_equations():
    motor, T = rl.plant("dc-motor"), 4e-3
    t = np.arange(300) * 1e-3
    u = np.where(np.arange(300) // 50 % 2, -6.0, 8.0)
    model, free = motor.state_space(), rl.simulate(motor, t, {"u": u})["phi"]
    wide = np.block([[model.A, model.B], [np.zeros((1, 3)), np.array([[-1 / T]])]])
    x, truth = np.r_[np.zeros(3), u[0]], []
    for k in range(300):  # each sample exactly, its input held
        truth.append(x[0])
        rate = lambda _, y, k=k: wide @ y + np.r_[0.0, 0.0, 0.0, u[k] / T]  # noqa: E731
        x = solve_ivp(rate, (0, 1e-3), x, rtol=1e-10, atol=1e-12, method="LSODA").y[:, -1]
    found = rl.simulate(rl.with_effects(motor, {"actuator-lag": {"T": T}}), t, {"u": u})["phi"]
    assert np.abs(found - truth).max() < 1e-3 * np.abs(free - truth).max()


def test_a_lag_is_a_state_where_delays_are_rational_and_a_parameter_of_the_set():
    motor, T = rl.plant("dc-motor", R=(6.0, 0.0), Kf=(1e-5, 0.0)), 4e-3
    real = rl.with_effects(motor, {"input-delay": {"d": 2e-3}, "actuator-lag": {"T": (T, 1e-3)}})
    s = 1j * np.array([1.0, 30.0, 400.0])
    rational = 1 - s * 1e-3 + s**2 * 4e-6 / 12
    rational = rational / np.conj(rational)
    bare = rl.frequency_response(motor.state_space(), s.imag)[:, :, 0]

    def expected(time):
        return bare * (rational / (1 + s * time))[:, None]

    np.testing.assert_allclose(rl.frequency_response(real.linear_model(pade=2), s.imag)[:, :, 0], expected(T))
    assert real.linear_model().n_states == 3
    assert any("a lag of 0.004 s" in left.reason for left in real.left_out())
    rational, real = 1.0, rl.with_effects(motor, {"actuator-lag": {"T": (T, 1e-3)}})
    made = rl.uncertain_from(real, sigmas=2.0).model
    lag = next(b for b in made.blocks if b.name == "actuator-lag@u")
    assert (lag.parameter.low, lag.parameter.high) == pytest.approx((2e-3, 6e-3))
    assert "Lag of the actuator" in lag.origin
    for delta, time in ((0.0, T), (1.0, 6e-3), (-1.0, 2e-3), (0.4, 4.8e-3)):
        member = made.evaluate({"actuator-lag@u": delta})
        np.testing.assert_allclose(rl.frequency_response(member, s.imag)[:, :, 0], expected(time), rtol=1e-8)
    known = rl.uncertain_from(rl.with_effects(motor, {"actuator-lag": {"T": T}})).model
    assert "actuator-lag@u" not in [b.name for b in known.blocks]
    np.testing.assert_allclose(
        rl.frequency_response(known.nominal, s.imag)[:, :, 0], bare / (1 + s * T)[:, None], rtol=1e-9
    )
    with pytest.raises(InputError, match=r"lag actuator-lag@u.*stays positive"):
        rl.uncertain_from(real, sigmas=5.0)


# --- Coulomb friction by direction -----------------------------------------------------------------------------------

LEVELS = {"F_pos": 5.0, "F_neg": 2.0}


@pytest.mark.parametrize(("v0", "level"), [(3.0, 5.0), (-3.0, 2.0)])
def test_a_body_stops_by_the_level_of_its_direction_and_stays(v0, level):
    states = turned([("asymmetric-coulomb-friction", LEVELS)], 3000, 1e-3, (0.0, v0))
    assert abs(states[-1, 0]) == pytest.approx(v0**2 / (2 * level), rel=1e-6)
    assert (states[math.ceil(abs(v0) / level * 1e3) + 1 :, 1] == 0).all()


# --- hysteretic spring -----------------------------------------------------------------------------------------------


def test_a_slow_loop_has_the_area_and_the_corners_of_its_branches():
    """Between the ends -m and m of z over the way 2 a, from the closed form of both branches."""
    level, width, rho, a, n = 2.0, 0.3, 0.5, 0.25, 4000
    m = brentq(lambda m: math.log1p(rho * m) / rho - math.log1p(-m) - 2 * a / width, 0.0, 1 - 1e-12)
    back = width * math.log1p(rho * m) / rho
    up = quad(lambda s: (1 - (1 + rho * m) * math.exp(-rho * s / width)) / rho, 0, back)[0]
    up += quad(lambda s: 1 - math.exp(-(s - back) / width), back, 2 * a)[0]
    slow, t = 2 * math.pi / (n * 1e-3), np.arange(6 * n) * 1e-3
    # A stiff guide forces the motion q = a sin: the law's own force hardly changes it.
    guide = 1e8
    plant = disc(guide, 2 * math.sqrt(guide))
    u = guide * a * np.sin(slow * t) + 2 * math.sqrt(guide) * a * slow * np.cos(slow * t)
    pairs = [(effect("bouc-wen"), ROUND)]
    # A held input would move the guide at the beginning of each sample; the mean force of a sample is one over time.
    run = Simulator(plant, pairs, u[:, None], 1e-3, hold=("linear",))
    motion = run.run(
        {}, [{"Fy": level, "qy": width, "rho": rho}], np.array([[0.0, a * slow]]), Windows(np.r_[0], 6 * n)
    )
    q, f = motion.states[0, 4 * n :, 0], motion.forces[0, 4 * n :, 0]
    assert np.abs(f).max() == pytest.approx(level * m, rel=1e-3)
    area = -np.sum(f[1 : n + 1] * np.diff(q[: n + 1]))  # a force is that of the step before its sample
    assert area == pytest.approx(2 * level * up, rel=1e-3)
    footprint = effect("bouc-wen").footprint(ROUND, {"Fy": level, "qy": width, "rho": rho}, a)
    assert footprint.gain_upper == pytest.approx(4 / math.pi * level * m / a)
    first = 2 * np.mean(-f[:n] * np.sin(slow * (t[:n] - 5e-4))) / a
    assert footprint.gain_lower < first < footprint.gain_upper


# --- ripple over time ------------------------------------------------------------------------------------------------


def test_a_free_body_follows_a_ripple_and_windows_keep_its_time():
    values = {"Ac": 40.0, "As": 0.0, "f": 8.0}
    omega = 2 * math.pi * 8.0
    t = np.arange(1000) * 1e-3
    v = turned([("torque-ripple", values)], 1000, 1e-3)[:, 1]
    np.testing.assert_allclose(v, 40.0 / omega * np.sin(omega * t), atol=1e-9)
    run = Simulator(disc(), [(effect("torque-ripple"), ROUND)], np.zeros((1000, 1)), 1e-3)
    windows = run.run({}, [values], np.zeros((2, 2)), Windows(np.array([130, 600]), 300)).states[:, :, 1]
    for k, start in enumerate((130, 600)):
        np.testing.assert_allclose(windows[k], v[start : start + 300] - v[start], atol=1e-9)
    late = Simulator(disc(), [(effect("torque-ripple"), ROUND)], np.zeros((300, 1)), 1e-3, 0.13)
    np.testing.assert_allclose(
        late.run({}, [values], np.zeros((1, 2)), Windows(np.array([0]), 300)).states[0, :, 1], windows[0], atol=1e-9
    )


# --- contacts on one side --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_body_bounces_off_one_side_and_flies_on_the_other(side):
    values = {"k": side * 400.0, "q0": side * 1.0, "d": 0.0}
    states = turned([("one-sided-spring", values)], 3000, 1e-3, (0.0, side * 2.0))
    assert np.abs(side * states[:, 0]).max() > 3.0
    assert (side * states[:, 0]).max() == pytest.approx(1 + 2.0 / 20.0, rel=1e-4)
    assert states[-1, 1] == pytest.approx(-side * 2.0, rel=1e-6)
    away = turned([("one-sided-spring", values)], 3000, 1e-3, (0.0, -side * 2.0))
    np.testing.assert_allclose(away[:, 1], -side * 2.0, rtol=1e-12)
