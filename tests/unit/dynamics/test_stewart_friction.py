"""Dry friction at the platform's nuts: exact sticking, and motion judged by a smooth law integrated by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import DryFriction
from robustlab.dynamics.stewart import kinetic_energy, potential_energy
from robustlab.dynamics.stewart.rigid_body import friction_torques, simulate_platform_with_friction
from robustlab.errors import InputError, NoTrustworthyNumber

PLANT = rl.plant("stewart-platform", preset="physical")
HOME = rl.trim(PLANT, pose=[0, 0, 0.1262, 0, 0, 0])
RATIO = PLANT.values["ratio"]


def all_nuts(coulomb, static=None):
    return [DryFriction(f"phidot_{i}", coulomb, static) for i in range(1, 7)]


def test_friction_above_the_holding_torque_holds_the_platform_without_motors():
    t = np.linspace(0, 0.3, 31)
    held = simulate_platform_with_friction(
        PLANT, all_nuts(1.2 * RATIO * HOME.u[0]), t, np.zeros((31, 6)), HOME, step=1e-3
    )
    np.testing.assert_array_equal(held.x[:, 6:], 0)
    np.testing.assert_array_equal(held.x, np.tile(HOME.x, (31, 1)))
    np.testing.assert_allclose(held.force, RATIO * np.tile(HOME.u, (31, 1)), rtol=1e-9)
    assert held.events == ()


def test_below_it_the_platform_sinks_and_friction_takes_its_energy():
    t = np.linspace(0, 0.2, 41)
    sinks = simulate_platform_with_friction(
        PLANT, all_nuts(0.5 * RATIO * HOME.u[0]), t, np.zeros((41, 6)), HOME, step=1e-3
    )
    energy = np.array(
        [
            kinetic_energy(PLANT, PLANT.poses(x[:6]), x[6:]) + potential_energy(PLANT, PLANT.poses(x[:6]))
            for x in sinks.x
        ]
    )
    assert (np.diff(energy) < 0).all()
    assert (sinks.x[1:, 6:] < 0).all()
    # What is lost is the work of the friction torques, 0.5 of the weight's.
    work = -0.5 * RATIO * HOME.u[0] * (sinks.x[0, :6] - sinks.x[-1, :6]).sum()
    np.testing.assert_allclose(energy[-1] - energy[0], work, rtol=1e-5)


def test_without_friction_it_is_the_plant_of_second_order():
    t = np.linspace(0, 0.1, 11)
    u = np.tile(1.3 * HOME.u, (11, 1))
    exact = np.array(rl.simulate(PLANT, t, u, HOME, rtol=1e-10)["phi_1"])
    error = [
        np.abs(simulate_platform_with_friction(PLANT, [], t, u, HOME, step=h).record["phi_1"] - exact).max()
        for h in (2e-3, 1e-3)
    ]
    assert 3.5 < error[0] / error[1] < 4.5


def test_stick_slip_under_a_sine_against_a_smooth_law():
    """Reference: F tanh(v / eps) with a small eps, by scipy's implicit solver on the plant's own equations."""
    level, eps = 0.025, 1e-4
    t = np.arange(0, 0.4, 2e-3)
    drive = HOME.u[0] + 4e-3 * np.sin(2 * np.pi * 5 * t)
    u = np.tile(drive[:, None], (1, 6))
    found = simulate_platform_with_friction(PLANT, all_nuts(level), t, u, HOME, step=2e-4)

    def rates(time, x):
        k = min(int(time / 2e-3 + 1e-9), len(t) - 1)
        return PLANT.derivative(x, u[k] - level * np.tanh(x[6:] / eps) / RATIO)

    reference = solve_ivp(rates, (0, t[-1]), HOME.x, "LSODA", t, rtol=1e-6, atol=1e-8, max_step=2e-3).y.T
    moved = np.ptp(reference[:, 0])
    assert moved > 0.02
    assert np.abs(found.x[:, :6] - reference[:, :6]).max() < 0.01 * moved
    # It sticks and slides by turns: the rates are exactly zero in between, with no more than 4 changes a turn.
    assert 0.1 < np.mean(found.x[:, 6] == 0) < 0.9
    assert len([e for e in found.events if e.velocity == "phidot_1"]) <= 4 * 2 + 1


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_coulombs_law_holds_in_every_joint(seed, n):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    response = root @ root.T + 0.1 * np.eye(n)
    free, slide = rng.standard_normal(n), rng.uniform(0, 1, n)
    hold = slide * rng.uniform(1, 2, n)
    before = np.where(rng.random(n) < 0.5, 0.0, rng.standard_normal(n))
    torques, after = friction_torques(response, free, before, slide, hold)
    np.testing.assert_allclose(after, free + response @ torques, atol=1e-9)
    limit = np.where(before == 0, hold, slide)
    for i in range(n):
        if after[i] == 0:
            assert abs(torques[i]) <= limit[i] * (1 + 1e-9)
        elif abs(after[i]) > 1e-9:
            assert torques[i] == pytest.approx(-slide[i] * np.sign(after[i]), abs=1e-9)


def test_refused():
    t, u = [0, 0.1], np.zeros((2, 6))
    with pytest.raises(InputError, match="did you mean phidot_1"):
        simulate_platform_with_friction(PLANT, DryFriction("phidot1", 1.0), t, u)
    with pytest.raises(InputError, match="given twice"):
        simulate_platform_with_friction(PLANT, [DryFriction("phidot_1", 1.0)] * 2, t, u)
    with pytest.raises(InputError, match="surface"):
        simulate_platform_with_friction(PLANT, DryFriction("phidot_1", 1.0, surface=1.0), t, u)
    with pytest.raises(InputError, match="motors"):
        simulate_platform_with_friction(rl.plant("stewart-platform", motors=True), [], t, u)
    with pytest.raises(NoTrustworthyNumber, match="end of its range"):
        simulate_platform_with_friction(PLANT, [], [0, 3.0], u, HOME, step=2e-3)
