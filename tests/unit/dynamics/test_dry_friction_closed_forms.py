"""Dry friction against closed forms: sliding to rest, release, Coulomb-damped oscillation, stick-slip on a belt."""

from __future__ import annotations

import math

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics.dry_friction import DryFriction, simulate_with_friction


def mass(**given):
    return rl.plant("mass-spring-damper", **({"m": 2.0, "c": 0.0, "k": 0.0} | given))


@pytest.mark.parametrize("n", [2, 7, 1000])
def test_mass_slides_to_rest_and_stays(n):
    t, v0, force = np.linspace(0.0, 4.0, n), 3.1, 4.0
    found = simulate_with_friction(mass(), DryFriction("v", force), t, np.zeros(n), x0=[0.2, v0])
    stop, distance = 2.0 * v0 / force, 2.0 * v0**2 / (2 * force)
    assert [(e.velocity, e.becomes) for e in found.events] == [("v", 0)]
    assert found.events[0].time == pytest.approx(stop, abs=1e-12)
    exact = np.where(t < stop, 0.2 + v0 * t - force * t**2 / 4, 0.2 + distance)
    np.testing.assert_allclose(found.record["q"], exact, rtol=1e-12)
    rest = t > stop
    assert (found.record["v"][rest] == 0.0).all()  # exactly, not nearly
    assert np.ptp(found.record["q"][rest]) == 0.0
    assert (found.force[rest] == 0.0).all()
    assert (found.force[~rest] == -force).all()


def test_mass_sticks_until_the_ramp_exceeds_the_static_force():
    t, rate = np.linspace(0.0, 3.0, 61), 5.0
    found = simulate_with_friction(mass(), DryFriction("v", 4.0, static=7.0), t, rate * t, hold="foh")
    release = 7.0 / rate
    assert [e.becomes for e in found.events] == [1]
    assert found.events[0].time == pytest.approx(release, abs=1e-11)
    since = np.maximum(t - release, 0.0)  # m v' = 7 + rate s - 4
    np.testing.assert_allclose(found.record["v"], (3.0 * since + rate * since**2 / 2) / 2.0, atol=1e-11)
    np.testing.assert_allclose(found.record["q"], (3.0 * since**2 / 2 + rate * since**3 / 6) / 2.0, atol=1e-11)
    stuck = t < release
    assert (found.record["v"][stuck] == 0).all()
    np.testing.assert_allclose(found.force[stuck, 0], -rate * t[stuck], atol=1e-12)


def test_release_with_equal_forces_has_no_chatter():
    t = np.linspace(0.0, 2.0, 201)
    found = simulate_with_friction(mass(), DryFriction("v", 4.0), t, 5.0 * t, hold="foh")
    assert [(round(e.time, 9), e.becomes) for e in found.events] == [(0.8, 1)]
    since = np.maximum(t - 0.8, 0.0)
    np.testing.assert_allclose(found.record["v"], 5.0 * since**2 / 4, atol=1e-11)


def test_oscillator_loses_four_fc_over_k_a_cycle():
    m, k, force, x0 = 2.0, 50.0, 3.0, 1.0
    half = math.pi / math.sqrt(k / m)
    t = np.arange(0, 12 * 40 + 1) * half / 40
    found = simulate_with_friction(mass(k=k), DryFriction("v", force), t, np.zeros(len(t)), x0=[x0, 0.0])
    turns = found.record["q"][::40]
    loss = 2 * force / k  # a half cycle
    swings = 8  # |q| after n swings is 1 - 0.12 n; it stays where |q| <= 3 / 50
    expected = [(-1) ** n * (x0 - n * loss) for n in range(swings + 1)]
    np.testing.assert_allclose(turns[: swings + 1], expected, atol=1e-11)
    np.testing.assert_allclose(turns[swings:], expected[-1], atol=1e-11)
    directions = found.sliding[:, 0]
    assert np.count_nonzero(np.diff(directions[directions != 0])) == swings - 1
    rest = t > swings * half + 1e-9
    assert (found.record["v"][rest] == 0).all()
    assert (directions[rest] == 0).all()


def test_stick_slip_on_a_belt_has_the_known_period():
    m, k, coulomb, static, belt = 1.0, 100.0, 2.0, 3.0, 0.05
    omega, y = math.sqrt(k / m), (static - coulomb) / k
    slip = 2 * (math.pi - math.atan(y * omega / belt)) / omega
    period = 2 * y / belt + slip
    t = np.linspace(0.0, 10.0, 1001)
    friction = DryFriction("v", coulomb, static, surface=belt)
    found = simulate_with_friction(mass(m=m, k=k), friction, t, np.zeros(len(t)), x0=[0.0, belt])
    slips = np.array([e.time for e in found.events if e.becomes])
    sticks = np.array([e.time for e in found.events if not e.becomes])
    assert slips[0] == pytest.approx(static / k / belt, abs=1e-11)
    np.testing.assert_allclose(np.diff(slips), period, rtol=1e-11)
    np.testing.assert_allclose(sticks - slips[: len(sticks)], slip, rtol=1e-10)
    assert (found.record["v"][found.sliding[:, 0] == 0] == belt).all()


def test_motor_below_and_above_its_breakaway_voltage():
    motor, t = rl.plant("dc-motor"), np.arange(0, 0.4, 1e-3)
    friction = DryFriction("omega", 0.02)
    held = simulate_with_friction(motor, friction, t, np.full(len(t), 0.99 * 0.02 / 0.052 * 2.07))
    assert (held.record["phi"] == 0).all()
    assert not held.events
    turning = simulate_with_friction(motor, friction, t, np.full(len(t), 10.0))
    km, kb, kf, r = 0.052, 0.052, 4.8e-5, 2.07
    speed = (km * 10.0 / r - 0.02) / (km * kb / r + kf)
    assert turning.record["omega"][-1] == pytest.approx(speed, rel=1e-9)
    # first order lag of the current until the torque breaks away: i = u/R (1 - exp(-R t/L))
    breakaway = -0.62e-3 / r * math.log(1 - 0.02 / km * r / 10.0)
    assert turning.events[0].time == pytest.approx(breakaway, rel=1e-9)


def test_jig_with_friction_stops_dead_between_pulses():
    actuator, t = rl.plant("linear-actuator"), np.arange(0, 1.0, 1e-3)
    u = np.where(t < 0.3, 11.8, 0.0)
    found = simulate_with_friction(actuator, DryFriction("omega", 0.02), t, u)
    assert [e.becomes for e in found.events] == [1, 0]
    rest = t > 0.5
    assert (found.record["omega"][rest] == 0).all()
    assert np.count_nonzero(np.diff(np.sign(found.record["omega"][rest]))) == 0


def test_no_friction_is_the_linear_plant():
    t = np.linspace(0, 3, 301)
    u = np.sin(3 * t)
    plant = rl.plant("two-mass", k=2.0)
    found = simulate_with_friction(plant, [], t, u, hold="foh")
    linear = rl.simulate(plant, t, u, hold="foh")
    np.testing.assert_allclose(found.record["phi2"], linear["phi2"], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("excess", [1e-2, 1e-5, -1e-5])
def test_a_force_that_only_just_exceeds_the_holding_one_between_two_samples_is_seen(excess):
    k, m, static = 30.0, 1.5, 4.0
    omega, swing = math.sqrt(k / m), static / k * (1 + excess)
    plant = rl.plant("mass-spring-damper", m=[1.0, m], c=[0.0, 0.0], k=[0.0, k])
    t = np.arange(9) * math.pi / omega  # the force is zero at every sample
    start = {"q1": 0.0, "q2": 0.0, "v1": 0.0, "v2": swing * omega}
    friction = DryFriction("v1", 0.5 * static, static)
    found = simulate_with_friction(plant, friction, t, np.zeros((9, 2)), x0=[start[s.name] for s in plant.states])
    if excess < 0:
        assert not found.events
        assert (found.record["v1"] == 0).all()
    else:
        first = math.asin(1 / (1 + excess)) / omega
        assert found.events[0].becomes == 1
        assert found.events[0].time == pytest.approx(first, abs=1e-9)
