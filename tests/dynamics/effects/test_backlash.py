"""Backlash against fine contact simulations of another integrator, closed forms of free flight, and balances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import DAMPING, Simulator, Site, Windows, effect

BACKLASH = (effect("backlash"), Site("joint", "v"))
INERTIA = 3e-3


def free_mass(c=0.0):
    return rl.plant("mass-spring-damper", m=INERTIA, c=c, k=0.0)


def run(u, dt, values, x0=(0.0, 0.0), c=0.0):
    """States (n, 4): q, v, delta, delta'; contact force in N m, (n,)."""
    motion = Simulator(free_mass(c), [BACKLASH], u[:, None], dt).run(
        {}, [values], np.array([x0]), Windows(np.array([0]), len(u))
    )
    reduced = values["share"] * (1 - values["share"]) * INERTIA
    return motion.states[0], reduced * motion.forces[0, :, 0]


def contact(u, dt, values, c):
    """The same two masses with a flank of spring and damper, by an adaptive integrator, step by step of the input."""
    J1, J2 = (1 - values["share"]) * INERTIA, values["share"] * INERTIA
    m, w, half = J1 * J2 / INERTIA, 2 * np.pi * values["f"], values["gap"] / 2

    def rate(_, x, torque):
        twist, speed = x[0] - x[2], x[1] - x[3]
        depth, side = abs(twist) - half, np.sign(twist)
        push = m * (w**2 * depth + 2 * DAMPING * w * side * speed) if depth > 0 else 0.0
        force = side * max(push, 0.0)
        return [x[1], (torque - c * x[1] - force) / J1, x[3], force / J2]

    x, states = np.zeros(4), []
    for torque in u:
        states.append(x)
        x = solve_ivp(rate, (0, dt), x, args=(torque,), rtol=1e-8, atol=1e-10, max_step=dt / 4).y[:, -1]
    return np.array(states)


def test_the_motion_converges_to_that_of_a_fine_contact_simulation():
    values, c, n = {"gap": 0.02, "share": 0.4, "f": 60.0}, 5e-3, 400
    u = 0.02 * np.where(np.sin(2 * np.pi * 4 * np.arange(n) * 1e-3) >= 0, 1.0, -1.0)
    truth = contact(u, 1e-3, values, c)
    assert np.abs(truth[:, 0] - truth[:, 2]).max() > 0.01  # the flanks touch
    one_mass = Simulator(free_mass(c), [], u[:, None], 1e-3).run({}, [], np.zeros((1, 2)), Windows(np.array([0]), n))
    effect_size = np.sqrt(np.mean((one_mass.states[0, :, 1] - truth[:, 1]) ** 2))
    errors = []
    for finer in (1, 4):  # under the same input
        found = run(np.repeat(u, finer), 1e-3 / finer, values, c=c)[0][::finer]
        errors.append(np.sqrt(np.mean((found[:, 1] - truth[:, 1]) ** 2)))
    assert errors[0] < 0.04 * effect_size
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("torque", [0.01, -0.03])
def test_the_load_is_picked_up_when_half_the_gap_is_crossed(torque):
    values = {"gap": 0.1, "share": 0.4, "f": 120.0}
    dt = 1e-4
    states, force = run(np.full(4000, torque), dt, values)
    acceleration = abs(torque) / (0.6 * INERTIA)
    expected = np.sqrt(0.1 / acceleration)  # half the gap = a t^2 / 2
    assert dt * np.flatnonzero(force)[0] == pytest.approx(expected, abs=1.01 * dt)
    load = states[:, 1] - states[:, 3]
    assert np.abs(load[dt * np.arange(4000) <= expected]).max() == 0.0


def test_the_free_flight_after_a_reversal():
    values = {"gap": 0.1, "share": 0.4, "f": 120.0}
    dt, n = 1e-4, 8000
    u = np.where(np.arange(n) < 5000, 0.02, -0.02)
    states, force = run(u, dt, values)
    touching = force != 0
    assert touching[4500:5000].all()  # driven from the front flank, at rest against it
    last = 5000 + np.flatnonzero(~touching[5000:])[0]  # the first sample after the last push
    again = last + np.flatnonzero(touching[last:])[0]
    delta, rate = states[last, 2:]
    a = -0.02 / (0.6 * INERTIA)
    # delta + rate t + a t^2 / 2 = -gap / 2
    flight = (-rate - np.sqrt(rate**2 - 2 * a * (delta + 0.05))) / a
    assert dt * (again - last) == pytest.approx(flight, abs=1.5 * dt)
    load = states[last:again, 1] - states[last:again, 3]
    np.testing.assert_allclose(load[:-1], load[0], rtol=1e-10)


random_values = st.fixed_dictionaries(
    {"gap": st.floats(0.0, 0.2), "share": st.floats(0.05, 0.9), "f": st.floats(20.0, 2000.0)}
)


@settings(max_examples=40)
@given(random_values, st.floats(-50.0, 50.0), st.sampled_from([1e-4, 1e-3, 5e-3]))
def test_no_contact_creates_energy_at_any_step(values, speed, dt):
    states, force = run(np.zeros(400), dt, values, x0=(0.0, speed))
    J1, J2 = (1 - values["share"]) * INERTIA, values["share"] * INERTIA
    load = states[:, 1] - states[:, 3]
    depth = np.maximum(np.abs(states[:, 2]) - values["gap"] / 2, 0.0)
    stored = J1 * J2 / INERTIA * (2 * np.pi * values["f"]) ** 2 * depth**2
    energy = 0.5 * (J1 * states[:, 1] ** 2 + J2 * load**2 + stored)
    assert (np.diff(energy) <= 1e-10 * energy[0] + 1e-300).all()
    assert (force * states[:, 2] <= 0).all()  # the flanks push, they never pull
