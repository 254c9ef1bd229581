"""The plants under models/plants against equations written out in numpy, scipy's integrator, and Pinocchio."""

import casadi as ca
import numpy as np
import pytest
from plant_files import NAMES, maker
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.result import Status

G = 9.81


def cart_pole(x, u, p):
    _, v, th, w = x
    mass = [
        [p["M"] + p["m"], p["m"] * p["l"] * np.cos(th)],
        [p["m"] * p["l"] * np.cos(th), p["J"] + p["m"] * p["l"] ** 2],
    ]
    force = [
        u[0] + p["m"] * p["l"] * np.sin(th) * w**2 - p["d"] * v,
        p["m"] * G * p["l"] * np.sin(th) - p["c"] * w,
    ]
    a = np.linalg.solve(np.array(mass), np.array(force))
    return np.array([v, a[0], w, a[1]])


def two_link_arm(x, u, p):
    """By the centres of mass: the kinetic energy's Hessian, and d'Alembert's forces of their accelerations."""
    q1, w1, q2, w2 = x
    s1, c1, s12, c12 = np.sin(q1), np.cos(q1), np.sin(q1 + q2), np.cos(q1 + q2)
    l1, r1, r2 = p["l_1"], p["c_1"], p["c_2"]
    j1 = r1 * np.array([[-s1, 0 * s1], [c1, 0 * c1]])
    j2 = np.array([[-l1 * s1 - r2 * s12, -r2 * s12], [l1 * c1 + r2 * c12, r2 * c12]])
    b1 = -r1 * w1**2 * np.array([c1, s1])
    b2 = -l1 * w1**2 * np.array([c1, s1]) - r2 * (w1 + w2) ** 2 * np.array([c12, s12])
    turn = np.array([[1.0, 1.0], [1.0, 1.0]])
    mass = p["m_1"] * j1.T @ j1 + p["m_2"] * j2.T @ j2 + p["I_2"] * turn
    mass = mass + np.diag([p["I_1"] + p["I_r1"], p["I_r2"]])
    down = np.array([0.0, -G])
    force = np.array([u[0] - p["b_1"] * w1, u[1] - p["b_2"] * w2])
    force = force + p["m_1"] * j1.T @ (down - b1) + p["m_2"] * j2.T @ (down - b2)
    a = np.linalg.solve(mass, force)
    return np.array([w1, a[0], w2, a[1]])


def water_tank(x, u, p):
    out = [p["a_1"] * np.sqrt(2 * G * x[0]), p["a_2"] * np.sqrt(2 * G * x[1])]
    return np.array([(p["k"] * u[0] - out[0]) / p["A_1"], (out[0] - out[1]) / p["A_2"]])


def quadrotor_height(x, u, p):
    _, v, rotor = x
    return np.array([v, (4 * p["k_t"] * rotor**2 - p["d"] * v) / p["m"] - G, (u[0] - rotor) / p["T"]])


TRUTH = {
    "cart_pole": cart_pole,
    "two_link_arm": two_link_arm,
    "water_tank": water_tank,
    "quadrotor_height": quadrotor_height,
}
LOW = {"water_tank": 0.05, "quadrotor_height": 500.0}
HIGH = {"water_tank": 0.3, "quadrotor_height": 900.0}


def points(name, n, seed=0):
    plant, rng = maker(name)(), np.random.default_rng(seed)
    low, high = LOW.get(name, -2.0), HIGH.get(name, 2.0)
    return plant, rng.uniform(low, high, (n, len(plant.states))), rng.uniform(low, high, (n, len(plant.inputs)))


@pytest.mark.parametrize("name", NAMES)
def test_rates_are_those_of_the_equations_written_out(name):
    plant, x, u = points(name, 20)
    for state, force in zip(x, u, strict=True):
        truth = TRUTH[name](state, force, plant.values)
        np.testing.assert_allclose(plant.derivative(state, force), truth, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_slopes_are_those_of_an_imaginary_step(name):
    plant, x, u = points(name, 10, seed=1)
    local, n_x = plant.local_models(x, u), len(plant.states)
    for k in range(len(x)):
        z, slopes = np.concatenate([x[k], u[k]]).astype(complex), np.hstack([local.A[k], local.B[k]])
        for j in range(len(z)):
            step = z.copy()
            step[j] += 1e-30j
            truth = TRUTH[name](step[:n_x], step[n_x:], plant.values).imag / 1e-30
            np.testing.assert_allclose(slopes[:, j], truth, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(local.outputs, plant.outputs_along(x, u))


@pytest.mark.parametrize(("name", "friction"), [("cart_pole", ("d", "c")), ("two_link_arm", ("b_1", "b_2"))])
def test_a_push_is_the_difference_that_a_force_makes(name, friction):
    plant, x, u = points(name, 5, seed=2)
    values, names = plant.values, [s.name for s in plant.states]
    local = plant.local_models(x, u)
    for k in range(len(x)):
        for j, place in enumerate(plant.port_places):
            # One more unit of viscous friction at the joint is a force of -v there.
            more = {**values, friction[j]: values[friction[j]] + 1.0}
            truth = TRUTH[name](x[k], u[k], values) - TRUTH[name](x[k], u[k], more)
            push = local.push[k, :, j] * x[k][names.index(place.name)]
            np.testing.assert_allclose(push, truth, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_each_point_may_have_parameters_of_its_own(name):
    plant, x, u = points(name, 6, seed=3)
    first = next(iter(plant.parameters))
    factors = np.linspace(0.9, 1.1, len(x))
    local = plant.local_models(x, u, {first: plant.values[first] * factors})
    for k, factor in enumerate(factors):
        alone = plant.with_parameters(**{first: plant.values[first] * factor})
        np.testing.assert_allclose(local.rates[k], alone.derivative(x[k], u[k]), rtol=1e-14, atol=1e-14)
        np.testing.assert_allclose(local.A[k], alone.jacobians(x[k], u[k])[0], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("hold", ["zoh", "spline"])
def test_trajectories_are_those_of_scipy(name, hold):
    plant, x, _ = points(name, 1, seed=4)
    t = np.linspace(0.0, 1.0, 101)
    middle = {"water_tank": 3.0, "quadrotor_height": 640.0}.get(name, 0.0)
    u = np.column_stack([middle + np.sin(3 * t + k) for k in range(len(plant.inputs))])
    record = rl.simulate(plant, t, u, x[0], hold=hold, rtol=1e-11)

    def force(time):
        k = min(int(time / 0.01 + 1e-9), 99)
        if hold == "zoh":
            return u[k]
        return np.array([middle + np.sin(3 * time + k) for k in range(len(plant.inputs))])

    state, truth = x[0], [x[0]]
    for k in range(100):
        span = (t[k], t[k + 1])
        args = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
        held = u[k]
        state = solve_ivp(
            lambda s, z, held=held: TRUTH[name](z, held if hold == "zoh" else force(s), plant.values),
            span,
            state,
            **args,
        ).y[:, -1]
        truth.append(state)
    outputs = plant.outputs_along(np.array(truth), u)
    for k, signal in enumerate(plant.outputs):
        size = np.abs(outputs[:, k]).max()
        # The spline through 101 samples is the sine to 1e-12 of it.
        np.testing.assert_allclose(record[signal.name], outputs[:, k], atol=3e-9 * size)


def test_the_arm_is_that_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    plant, x, u = points("two_link_arm", 20, seed=5)
    p, model = plant.values, pin.Model()
    model.gravity = pin.Motion(np.array([0.0, -G, 0.0, 0.0, 0.0, 0.0]))
    offset, parent = pin.SE3.Identity(), 0
    for k in (1, 2):
        parent = model.addJoint(parent, pin.JointModelRZ(), offset, f"joint_{k}")
        inertia = np.diag([0.0, 0.0, p[f"I_{k}"]])
        body = pin.Inertia(p[f"m_{k}"], np.array([p[f"c_{k}"], 0.0, 0.0]), inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        offset = pin.SE3(np.eye(3), np.array([p["l_1"], 0.0, 0.0]))
    model.armature = np.array([p["I_r1"], p["I_r2"]])
    data = model.createData()
    for state, force in zip(x, u, strict=True):
        q, w = np.array(state[::2]), np.array(state[1::2])
        torque = force - np.array([p["b_1"], p["b_2"]]) * w
        truth = pin.aba(model, data, q, w, torque)
        np.testing.assert_allclose(plant.derivative(state, force)[1::2], truth, rtol=1e-10, atol=1e-10)
        pin.computeABADerivatives(model, data, q, w, torque)
        np.testing.assert_allclose(plant.jacobians(state, force)[0][1::2, ::2], data.ddq_dq, rtol=1e-9, atol=1e-9)


# --- rest ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_at_a_trim_the_equations_written_out_are_at_rest(name):
    plant = maker(name)()
    found = rl.trim(plant)
    assert found.status is Status.CONVERGED
    assert np.abs(TRUTH[name](found.x, found.u, plant.values)).max() < 1e-9


def test_trims_that_have_a_closed_form():
    arm, tank, quad = (maker(name)() for name in NAMES[1:])
    p = arm.values
    second = p["m_2"] * G * p["c_2"] * np.cos(0.5)
    held = rl.trim(arm, q_1=0.3, q_2=0.2)
    torque = (p["m_1"] * p["c_1"] + p["m_2"] * p["l_1"]) * G * np.cos(0.3) + second
    np.testing.assert_allclose(held.u, [torque, second], rtol=1e-12)
    p = tank.values
    level = (3.0 * p["k"] / p["a_1"]) ** 2 / (2 * G)
    np.testing.assert_allclose(rl.trim(tank, u=3.0).x, level, rtol=1e-10)
    np.testing.assert_allclose(rl.trim(tank, level=p["k_s"] * level).u, 3.0, rtol=1e-10)
    p = quad.values
    hover = np.sqrt(p["m"] * G / (4 * p["k_t"]))
    found = rl.trim(quad)
    np.testing.assert_allclose([found.x[2], found.u[0]], hover, rtol=1e-10)
    assert found.x[0] == pytest.approx(0.0, abs=1e-9)  # of all heights the nearest to zero
    assert rl.trim(quad, z=2.5).x[0] == 2.5


def test_a_rest_that_rounding_blurs_is_error_context_inaccurate():
    p = rl.PlantEquations("blurred")
    x, big = p.state("x"), p.parameter("big", 1e9)
    p.rate(x, ca.sqrt((x + big) ** 2) - big - 1.23)
    p.output("x", x)
    found = rl.trim(p.plant())
    assert found.status is Status.INACCURATE
    assert found.x[0] == pytest.approx(1.23, abs=1e-6)
    assert found.residual > 1e-9


def test_a_start_says_which_of_many_rests():
    arm = maker("two_link_arm")()
    for angle in (np.pi / 2, -np.pi / 2):
        start = (np.array([angle + 0.1, 0.0, 0.0, 0.0]), np.zeros(2))
        found = rl.trim(arm, torque_1=0.0, torque_2=0.0, start=start)
        np.testing.assert_allclose(found.x, [angle, 0.0, 0.0, 0.0], atol=1e-9)
