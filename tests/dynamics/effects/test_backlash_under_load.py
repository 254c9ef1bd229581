"""Backlash with a hanging load: closed forms of one mass, and an arm of separate bodies."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import DAMPING, Simulator, Site, Windows, effect, shares_behind
from tests.plant_files import maker

ROTOR, LOAD, WEIGHT, DRAG = 6e-4, 3e-5, 0.012, 4e-3  # kg m2, kg m2, N m, N m s/rad


def hoist(drag=0.0):
    """A rotor with a load that hangs on it, turned by a torque."""
    p = rl.PlantEquations("hoist")
    rotor = p.parameter("rotor", ROTOR, "kg m2", tolerance=0.05, role="inertia")
    load = p.parameter("load", LOAD, "kg m2", tolerance=0.1, role="inertia")
    weight = p.parameter("weight", WEIGHT, "N m")
    c = p.parameter("c", drag, "N m s/rad", role="viscous-friction")
    torque = p.input("torque", "N m")
    q, w = p.joint("q", "w", "rad")
    p.motion([[rotor + load]], [torque - weight - c * w])
    p.output("q", q, "rad")
    return p.plant()


def values(gap=0.2, f=400.0):
    return {"gap": gap, "share": LOAD / (ROTOR + LOAD), "f": f}


HOLD = 40  # samples for which the load is carried at a constant speed, before the torque changes


def run(torque, n=200, dt=5e-4, speed=0.0, gap=0.2, drag=0.0, hold=HOLD):
    """States (n, 4) from the change of the torque on: q, w, delta, delta'."""
    u = np.full((hold + n, 1), torque)
    u[:hold] = WEIGHT + drag * speed
    at = speed * dt * (np.arange(len(u)) - hold)
    motion = np.column_stack([at, np.full(len(u), speed)])
    simulator = Simulator(hoist(drag), [(effect("backlash"), Site("joint", "w"))], u, dt, motion=motion)
    return simulator.run({}, [values(gap)], motion[:1], Windows(np.array([0]), len(u))).states[0, hold:]


def opens_at():
    """The torque at which the rotor alone falls as fast as the load."""
    return -ROTOR * WEIGHT / LOAD


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.9, 0.999])
def test_a_load_that_follows_never_leaves_its_flank(share):
    torque, dt = share * opens_at(), 5e-4
    x = run(torque, hold=0)
    t = dt * np.arange(len(x))
    whole = (torque - WEIGHT) / (ROTOR + LOAD)
    np.testing.assert_allclose(x[:, 1], whole * t, atol=1e-9)
    np.testing.assert_allclose(x[:, 0], 0.5 * whole * t**2, atol=1e-10)
    # contact force of the load over the reduced mass
    pressed = (LOAD * whole + WEIGHT) / (ROTOR * LOAD / (ROTOR + LOAD)) / (2 * math.pi * 400.0) ** 2
    np.testing.assert_allclose(x[:, 2], 0.1 + pressed, rtol=1e-9)


@pytest.mark.parametrize("times", [1.5, 4.0])
def test_the_flight_of_a_rotor_that_outruns_its_load(times):
    torque, gap, dt = times * opens_at(), 0.2, 1e-4
    x = run(torque, 500, dt, gap=gap)
    t = dt * np.arange(500)
    rotor, load = torque / ROTOR, -WEIGHT / LOAD
    flight = math.sqrt(2 * gap / (load - rotor))
    # the flank that the weight had pressed springs back at first, and shortens the flight by as much
    rebound = WEIGHT / LOAD / (2 * math.pi * 400.0)
    near = 2 * dt + rebound / (load - rotor)
    free = t < flight - near
    assert free.sum() > 50
    np.testing.assert_allclose(x[free, 1], rotor * t[free], atol=rebound)
    np.testing.assert_allclose(x[free, 1] - x[free, 3], load * t[free], atol=rebound)
    hit = t[np.flatnonzero(x[:, 2] < -0.5 * gap)[0]]
    assert hit == pytest.approx(flight, abs=near)
    # the impact conserves momentum
    momentum = ROTOR * x[:, 1] + LOAD * (x[:, 1] - x[:, 3])
    np.testing.assert_allclose(momentum, (torque - WEIGHT) * t, rtol=1e-6, atol=1e-10)


def bodies(x, u, p, gap, omega):
    """Rates of (q1, w1, rotor 2, its speed, q2, w2): the arm with rotor 2 as a separate body."""
    q1, w1, r2, wr2, q2, w2 = x
    a1 = p["I_1"] + p["I_2"] + p["m_1"] * p["c_1"] ** 2 + p["m_2"] * (p["l_1"] ** 2 + p["c_2"] ** 2) + p["I_r1"]
    a2, a3 = p["m_2"] * p["l_1"] * p["c_2"], p["I_2"] + p["m_2"] * p["c_2"] ** 2
    mass = np.array([[a1 + 2 * a2 * np.cos(q2), a3 + a2 * np.cos(q2)], [a3 + a2 * np.cos(q2), a3]])
    twist, speed = r2 - q2, wr2 - w2
    depth, side = abs(twist) - 0.5 * gap, np.sign(twist)
    behind = mass[1, 1] - mass[0, 1] ** 2 / mass[0, 0]  # effective inertia on a closed flank
    reduced = p["I_r2"] * behind / (p["I_r2"] + behind)
    push = reduced * side * max(omega**2 * depth + 2 * DAMPING * omega * side * speed, 0.0) if depth > 0 else 0.0
    fall_2 = p["m_2"] * p["g"] * p["c_2"] * np.cos(q1 + q2)
    fall_1 = (p["m_1"] * p["c_1"] + p["m_2"] * p["l_1"]) * p["g"] * np.cos(q1) + fall_2
    bend = a2 * np.sin(q2)
    force = [u[0] + bend * (2 * w1 * w2 + w2**2) - p["b_1"] * w1 - fall_1, push - bend * w1**2 - fall_2]
    acceleration = np.linalg.solve(mass, force)
    rotor = (u[1] - p["b_2"] * wr2 - push) / p["I_r2"]
    return [w1, acceleration[0], wr2, rotor, w2, acceleration[1]]


def test_an_arm_whose_second_joint_has_a_gap_matches_separate_bodies():
    arm, gap, f, dt, n = maker("two_link_arm")(), 0.02, 150.0, 1e-3, 400
    (share,), p = shares_behind(arm, "w_2"), arm.values
    t = dt * np.arange(n)
    u = np.column_stack([14 + 5 * np.sin(9 * t), 3.0 + 12 * np.sign(np.sin(28 * t + 0.4))])
    x = np.array([0.3, 0.0, 0.5, 0.0, 0.5, 0.0])
    true = []
    for torque in u:
        true.append(x)
        rates = lambda _, x, torque=torque: bodies(x, torque, p, gap, 2 * math.pi * f)  # noqa: E731
        x = solve_ivp(rates, (0, dt), x, rtol=1e-8, atol=1e-10, max_step=2e-4).y[:, -1]
    true = np.array(true)
    twist = true[:, 2] - true[:, 4]
    assert np.mean(np.abs(twist) < 0.5 * gap) > 0.05  # it flies
    rough = rl.with_effects(arm, {"backlash@w_2": {"gap": gap, "share": share, "f": f}})
    found, _ = rough.stepped(t, u, np.array([0.3, 0.0, 0.5, 0.0, 0.0, 0.0]), 1e-4)
    moved = np.ptp(true[:, [0, 2]], axis=0)
    assert np.abs(found[:, [0, 2]] - true[:, [0, 2]]).max(axis=0) == pytest.approx([0, 0], abs=2e-3 * moved.max())
    np.testing.assert_allclose(found[:, 4], twist, atol=0.1 * gap)
