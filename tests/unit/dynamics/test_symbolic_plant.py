"""User-defined plants compared with built-in ones, and their features."""

import casadi as ca
import numpy as np

import robustlab as rl
from robustlab.dynamics import input_signal, port_model


def motor():
    p = rl.PlantEquations("my-motor")
    known = rl.plant("dc-motor").parameters
    R, L, Km, Kb, Kf, J = (
        p.parameter(q.name, q.value, q.unit, tolerance=q.tolerance, role=q.role, sign=q.sign, meaning=q.meaning)
        for q in known.values()
    )
    u = p.input("u", "V")
    phi, omega = p.joint("phi", "omega", "rad")
    i = p.state("i", "A", current=True)
    p.motion(J, Km * i - Kf * omega)
    p.rate(i, (u - R * i - Kb * omega + p.voltage(i)) / L)
    for name, symbol, unit in (("phi", phi, "rad"), ("omega", omega, "rad/s"), ("i", i, "A")):
        p.output(name, symbol, unit)
    return p.plant()


def test_a_linear_plant_is_that_of_the_registry():
    own, known = motor(), rl.plant("dc-motor")
    model, truth = rl.linearise(own), rl.linearise(known)
    for name in "ABCD":
        np.testing.assert_allclose(getattr(model, name), getattr(truth, name), rtol=1e-12, atol=1e-15)
    t = np.linspace(0.0, 0.1, 201)
    u = np.where(t < 0.05, 5.0, -5.0)
    np.testing.assert_allclose(
        rl.simulate(own, t, u, rtol=1e-11)["phi"], rl.simulate(known, t, u)["phi"], atol=1e-9, rtol=1e-9
    )
    ports = port_model(known).ports
    local = own.local_models(np.zeros((1, 3)), np.zeros((1, 1)))
    assert [(p.name, p.kind, p.unit, p.position) for p in own.port_places] == [
        ("omega", "joint", "N m", "phi"),
        ("i", "current", "V", ""),
    ]
    for k, place in enumerate(own.port_places):
        np.testing.assert_allclose(local.push[0, :, k], ports[place.name].force, rtol=1e-12)


def test_a_role_determines_the_sign_and_none_is_no_role():
    p = rl.PlantEquations("signs")
    signs = {"inertia": "positive", "viscous-friction": "nonnegative", "torque-constant": "either", "none": "any"}
    for role in signs:
        p.parameter(role, 1.0, tolerance=0.1, role=role)
    p.parameter("length", 1.0, sign="positive")
    p.rate(p.state("x"), 0.0)
    p.output("one", 1.0)
    found = p.plant().parameters
    assert {name: q.sign for name, q in found.items()} == {**signs, "length": "positive"}
    assert [q.role for q in found.values()] == ["inertia", "viscous-friction", "torque-constant", "", ""]


def test_a_mass_may_be_a_state():
    """A rocket: v' = T / m, m' = -T / c; the speed is c log(m0 / m)."""
    p = rl.PlantEquations("rocket")
    thrust = p.input("thrust", "N")
    (_, v), m = p.joint("height", "v", "m"), p.state("mass", "kg")
    p.motion(m, thrust)
    p.rate(m, -thrust / p.parameter("c", 2000.0, "m/s"))
    p.output("v", v, "m/s")
    t = np.linspace(0.0, 10.0, 11)
    record = rl.simulate(p.plant(), t, np.full(11, 100.0), [0.0, 0.0, 2.0], rtol=1e-10)
    np.testing.assert_allclose(record["v"], 2000 * np.log(2 / (2 - t / 20)), rtol=1e-9)


def test_discontinuous_inputs_are_exact():
    """x'' = u with steps in u between samples of different lengths: the motion is a parabola in each."""
    p = rl.PlantEquations("mass")
    F = p.input("F", "N")
    x, _ = p.joint("x", "v", "m")
    p.motion(1.0, F)
    p.output("x", x, "m")
    t = np.cumsum(np.r_[0.0, np.random.default_rng(0).uniform(0.01, 0.5, 30)])
    u = np.random.default_rng(1).choice([-1.0, 0.0, 1.0], 31)
    states = p.plant().trajectory(input_signal(t, u[:, None], "zoh"), np.zeros(2), 1e-8)
    v = np.r_[0.0, np.cumsum(u[:-1] * np.diff(t))]
    truth = np.r_[0.0, np.cumsum(v[:-1] * np.diff(t) + 0.5 * u[:-1] * np.diff(t) ** 2)]
    np.testing.assert_allclose(states, np.column_stack([truth, v]), atol=1e-13)


# --- twelve states ---------------------------------------------------------------------------------------------------


def chain(links=6):
    """Pendulum of point masses on rigid rods in a plane, by their absolute angles: a full mass matrix."""
    p = rl.PlantEquations("chain")
    m = [p.parameter(f"m_{k}", 1.0 - 0.1 * k, "kg") for k in range(links)]
    length = [p.parameter(f"l_{k}", 0.5 - 0.05 * k, "m") for k in range(links)]
    q, w = zip(*(p.joint(f"q_{k}", f"w_{k}", "rad") for k in range(links)), strict=True)
    below, turned = [sum(m[k:]) for k in range(links)], range(links)
    arm = [[below[max(i, j)] * length[i] * length[j] for j in turned] for i in turned]
    force = [
        -sum(arm[i][j] * ca.sin(q[i] - q[j]) * w[j] ** 2 for j in turned) - below[i] * 9.81 * length[i] * ca.sin(q[i])
        for i in turned
    ]
    p.motion([[arm[i][j] * ca.cos(q[i] - q[j]) for j in turned] for i in turned], force)
    p.output("q_0", q[0], "rad")
    return p.plant()


def test_a_chain_of_six_links_keeps_its_energy():
    plant, t = chain(), np.linspace(0.0, 3.0, 301)
    start = np.ravel([[angle, 0.0] for angle in np.linspace(0.5, 2.0, 6)])
    states = plant.trajectory(input_signal(t, np.zeros((301, 0)), "zoh"), start, 1e-11)
    m, length = (np.array([plant.values[f"{name}_{k}"] for k in range(6)]) for name in ("m", "l"))
    q, w = states[:, ::2], states[:, 1::2]
    vx, vy = np.cumsum(length * np.cos(q) * w, axis=1), np.cumsum(length * np.sin(q) * w, axis=1)
    height = -np.cumsum(length * np.cos(q), axis=1)
    energy = (m * (0.5 * (vx**2 + vy**2) + 9.81 * height)).sum(axis=1)
    assert np.ptp(energy) < 1e-8 * np.abs(energy).max()
