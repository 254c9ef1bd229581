"""linear-actuator: reflected inertia by energy, the numbers of chapter 11, its uncertain model."""

import math

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import linear_actuator

RATIO, LEAD = 4.8 * 41 / 21, 0.004
DRIVE = 0.052**2 + 2.07 * 4.8e-5  # Km Kb + R Kf


def test_inertia_is_that_of_the_kinetic_energy():
    actuator, omega = rl.plant("linear-actuator", m_cart=2.0), 300.0
    nut, cart = omega / RATIO, omega / RATIO / (2 * math.pi) * LEAD  # rad/s, m/s
    energy = (7.2e-6 * omega**2 + 2.2071e-5 * nut**2 + (0.112 + 2.0) * cart**2) / 2
    current = 1.7
    acceleration = actuator.derivative([0, 0, current], [0])[1]
    assert 0.052 * current / acceleration * omega**2 / 2 == pytest.approx(energy, rel=1e-12)


def test_time_constants_with_and_without_the_rotor():  # THESIS 28: 5.5 ms and 0.19 ms
    for rotor, expected in ((7.2e-6, 5.5e-3), (0.0, 0.19e-3)):
        actuator = linear_actuator(J=rotor, L=1e-9)  # mechanical time constant alone
        slowest = -1 / max(pole for pole in actuator.state_space().poles().real if pole < -1e-6)
        assert slowest == pytest.approx(expected, rel=0.02)


def square_wave_peak(**given):
    """Peak-to-peak angle over one period of 1 Hz, +-11.8 V, from rest."""
    t = np.arange(1001) * 1e-3
    record = rl.simulate(linear_actuator(**given), t, {"u": np.where(t < 0.5, 11.8, -11.8)})
    return np.ptp(record["phi"]), record["omega"][499]


def test_friction_of_the_motor_moves_the_peak_by_a_percent():  # THESIS 27: +1.26 %, +1.25 %
    peak, speed = square_wave_peak()
    less, faster = square_wave_peak(Kf=0.65 * 4.8e-5)
    exact = DRIVE / (0.052**2 + 2.07 * 0.65 * 4.8e-5) - 1
    assert speed == pytest.approx(0.052 * 11.8 / DRIVE, rel=1e-9)
    assert faster / speed - 1 == pytest.approx(exact, rel=1e-6)
    assert 100 * exact == pytest.approx(1.26, abs=0.005)
    assert 100 * (less / peak - 1) == pytest.approx(1.25, abs=0.02)


def test_uncertain_model_is_the_rebuilt_plant():
    actuator = linear_actuator(R=(2.07, 0.1), J=(7.2e-6, 0.2))
    uncertain = actuator.uncertain()
    assert {b.name: b.repeats for b in uncertain.blocks} == {
        "R": 1, "Kf": 1, "J": 1, "J_nut": 1, "m_screw": 1, "m_cart": 1,
    }  # fmt: skip
    delta = {"R": -0.4, "Kf": 1.0, "J": 0.7, "J_nut": -1.0, "m_screw": 0.3, "m_cart": 0.9}
    values = {name: value for name, (value, _) in uncertain.physical(delta).items()}
    rebuilt = actuator.with_parameters(**values).state_space()
    found = uncertain.evaluate(delta)
    for name in "ABCD":
        np.testing.assert_allclose(getattr(found, name), getattr(rebuilt, name), rtol=1e-12, atol=1e-12)


def test_exact_parameters_take_no_tolerance():
    with pytest.raises(rl.InputError, match=r"lead: relative tolerance 0\.01, expected no tolerance"):
        linear_actuator(lead=(0.004, 0.01))
    with pytest.raises(rl.InputError, match="a positive value"):
        linear_actuator(ratio=0.0)
    with pytest.raises(rl.InputError, match="no negative value"):
        linear_actuator(m_cart=-1.0)
    with pytest.raises(rl.InputError, match="E is singular"):
        linear_actuator(J=0.0, J_nut=0.0, m_screw=0.0, m_cart=0.0)
