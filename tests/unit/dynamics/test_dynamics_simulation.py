"""Simulation against closed forms."""

import numpy as np
import pytest

import robustlab as rl


def test_motor_step_is_the_two_pole_solution():
    r, ind, k, kf, j = 2.07, 0.62e-3, 0.052, 4.8e-5, 7.2e-6
    # J L w'' + (J R + Kf L) w' + (Kf R + K^2) w = K u
    p1, p2 = np.roots([j * ind, j * r + kf * ind, kf * r + k * k])
    final = 12 * k / (kf * r + k * k)
    t = np.arange(500) * 1e-4
    expected = final * (1 + (p2 * np.exp(p1 * t) - p1 * np.exp(p2 * t)) / (p1 - p2))
    record = rl.simulate(rl.plant("dc-motor"), t, {"u": np.full(500, 12.0)})
    np.testing.assert_allclose(record["omega"], expected, rtol=1e-10, atol=1e-10 * final)
    assert record.units == {"u": "V", "phi": "rad", "omega": "rad/s", "i": "A"}
    # the angle is the integral of the speed
    area = final * (t + (p2 / p1 * np.expm1(p1 * t) - p1 / p2 * np.expm1(p2 * t)) / (p1 - p2))
    np.testing.assert_allclose(record["phi"], area, rtol=1e-9, atol=1e-12)


def test_undamped_chain_keeps_its_energy():
    m, k = np.array([1.0, 2.0, 0.5]), np.array([30.0, 20.0, 50.0])
    chain = rl.plant("mass-spring-damper", m=m, k=k, c=0.0)
    x0 = np.array([0.1, -0.2, 0.3, 1.0, 0.0, -1.0])
    t = np.arange(20000) * 0.01
    record = rl.simulate(chain, t, np.zeros((20000, 3)), x0)
    q = np.array([record[f"q{j}"] for j in (1, 2, 3)])
    v = np.array([record[f"v{j}"] for j in (1, 2, 3)])
    stretch = np.diff(q, axis=0, prepend=np.zeros((1, q.shape[1])))
    energy = 0.5 * (m @ v**2 + k @ stretch**2)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_irregular_clock_gives_the_same_points(hold):
    """Samples of a fine uniform run that are taken away do not change the others, where the input allows it."""
    plant = rl.plant("two-mass")
    t = np.arange(2001) * 1e-3
    u = np.where(t < 0.7, 1.0, -0.5) if hold == "zoh" else np.interp(t, [0, 0.7, 2.0], [0, 1.0, -1.0])
    keep = np.zeros(2001, dtype=bool)
    keep[np.random.default_rng(3).choice(2001, 300, replace=False)] = True
    keep[[0, 700, 2000]] = True
    fine = rl.simulate(plant, t, u, hold=hold)
    sparse = rl.simulate(plant, t[keep], u[keep], hold=hold)
    for name in ("phi1", "phi2"):
        np.testing.assert_allclose(sparse[name], fine[name][keep], rtol=1e-8, atol=1e-10)


def test_stamps_rounded_by_a_logger_stay_exact():
    lag = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    t = 1000.0 + np.arange(5000) * 1e-3  # steps differ by rounding
    y = rl.simulate(lag, t, np.ones(5000))["y1"]
    np.testing.assert_allclose(y, 1 - np.exp(-(t - t[0])), atol=1e-9)


def test_badly_scaled_model():
    """Units of 1e9 in a state and an input change nothing: the scaling inside absorbs them."""
    a = np.array([[-1.0, 0.5], [-0.5, -2.0]])
    b = np.array([[1.0], [0.3]])
    s = np.array([1e9, 1e-6])
    plain = rl.StateSpaceModel(a, b, np.eye(2), np.zeros((2, 1)))
    scaled = rl.StateSpaceModel(a * s[:, None] / s, b * s[:, None] * 1e8, np.diag(1 / s), np.zeros((2, 1)))
    t = np.linspace(0, 5, 51)
    u = np.sin(3 * t)
    one, two = rl.simulate(plain, t, u, hold="foh"), rl.simulate(scaled, t, u / 1e8, hold="foh")
    for name in ("y1", "y2"):
        np.testing.assert_allclose(two[name], one[name], rtol=1e-12, atol=1e-14)
