"""The flexible coupling against the two-mass plant of the registry, and against matrices by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter, Simulator, Site, Windows, effect, port_model
from robustlab.errors import InputError
from robustlab.statespace import Signal

JOINT = Site("joint", "v")
# states (q, v, delta, delta') -> (phi1, phi2, omega1, omega2)
TO_TWO = np.array([[1.0, 0, 0, 0], [1, 0, -1, 0], [0, 1, 0, 0], [0, 1, 0, -1]])


def coupled(J1, J2, c, k):
    """Values of the effect that make two masses of one, and that one."""
    m = J1 * J2 / (J1 + J2)
    omega = np.sqrt(k / m)
    values = {"f": omega / (2 * np.pi), "zeta": c / (2 * omega * m), "share": J2 / (J1 + J2)}
    return rl.plant("mass-spring-damper", m=J1 + J2, c=0.0, k=0.0), values


@given(st.floats(1e-4, 1e-2), st.floats(1e-4, 1e-2), st.floats(0, 1e-2), st.floats(0.1, 100))
def test_it_is_the_two_mass_plant(J1, J2, c, k):
    one, values = coupled(J1, J2, c, k)
    two = rl.plant("two-mass", J1=J1, J2=J2, c=c, k=k).state_space()
    found = effect("flexible-coupling").extend(port_model(one), JOINT, values)
    back = np.linalg.inv(TO_TWO)
    np.testing.assert_allclose(TO_TWO @ found.A @ back, two.A, rtol=1e-10, atol=1e-11 * np.abs(two.A).max())
    np.testing.assert_allclose(TO_TWO @ found.B, two.B, rtol=1e-12)
    np.testing.assert_allclose(found.ports["v"].force @ TO_TWO.T, [0, 0, 1 / J1, 0], rtol=1e-12)
    load = found.ports["v.load"]
    np.testing.assert_allclose(TO_TWO @ load.force, [0, 0, 0, 1 / J2], rtol=1e-12)
    np.testing.assert_allclose(load.position @ back, [0, 1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(load.velocity @ back, [0, 0, 0, 1], atol=1e-15)


def test_the_simulated_motion_is_that_of_two_masses():
    one, values = coupled(1e-3, 2e-3, 2e-3, 10.0)
    u = np.random.default_rng(5).normal(size=(500, 1))
    whole = Windows(np.array([0]), 500)
    found = Simulator(one, [(effect("flexible-coupling"), JOINT)], u, 1e-3)
    truth = Simulator(rl.plant("two-mass"), [], u, 1e-3)
    angle = found.run({}, [values], np.zeros((1, 2)), whole).outputs[0, :, 0]
    expected = truth.run({}, [], np.zeros((1, 4)), whole).outputs[0, :, 0]
    np.testing.assert_allclose(angle, expected, rtol=1e-8, atol=1e-12)


def coupled_inertias():
    """Two joints whose mass matrix is full: E is not diagonal."""
    number = {"m11": 2.0, "m12": 0.5, "m22": 1.0}
    parameters = {name: Parameter(name, value, "kg m2", role="inertia") for name, value in number.items()}

    def equations(p):
        e = np.eye(4)
        e[2:, 2:] = [[p["m11"], p["m12"]], [p["m12"], p["m22"]]]
        f = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-3, 1, -0.2, 0], [1, -2, 0, -0.1]], dtype=float)
        return Descriptor(e, f, [[0, 0], [0, 0], [1, 0], [0, 1]], np.eye(2, 4))

    angles = (Signal("a", "rad"), Signal("b", "rad"))
    rates = (Signal("wa", "rad/s"), Signal("wb", "rad/s"))
    torques = (Signal("ta", "N m"), Signal("tb", "N m"))
    return LinearPlant("arm", parameters, torques, angles, (*angles, *rates), equations=equations)


def test_a_full_mass_matrix():
    plant, s, f, zeta = coupled_inertias(), 0.3, 2.0, 0.1
    found = effect("flexible-coupling").extend(
        port_model(plant), Site("joint", "wa"), {"f": f, "zeta": zeta, "share": s}
    )
    mass = np.array([[2.0, 0.5], [0.5, 1.0]])
    J = 1 / np.linalg.inv(mass)[0, 0]  # effective inertia at joint a
    mass[0, 0] -= s * J
    w = 2 * np.pi * f
    k, c = w**2 * s * (1 - s) * J, 2 * zeta * w * s * (1 - s) * J
    # by hand over (qa, qb, va, vb, q2, v2) with M v' = F
    e = np.eye(6)
    e[2:4, 2:4], e[5, 5] = mass, s * J
    right = np.zeros((6, 6))
    right[0, 2] = right[1, 3] = right[4, 5] = 1
    right[2] = [-3 - k, 1, -0.2 - c, 0, k, c]
    right[3] = [1, -2, 0, -0.1, 0, 0]
    right[5] = [k, 0, c, 0, -k, -c]
    change = np.eye(6)
    change[4] = [1, 0, 0, 0, -1, 0]  # delta
    change[5] = [0, 0, 1, 0, 0, -1]
    expected = change @ np.linalg.solve(e, right) @ np.linalg.inv(change)
    np.testing.assert_allclose(found.A, expected, rtol=1e-9, atol=1e-9)
    inputs = change @ np.linalg.solve(e, np.eye(6)[:, 2:4])
    np.testing.assert_allclose(found.B, inputs, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(np.column_stack([found.ports[p].force for p in ("wa", "wb")]), inputs, atol=1e-12)


@pytest.mark.parametrize("second", ["flexible-coupling", "backlash"])
def test_two_load_sides_at_one_joint_are_refused(second):
    motor, joint = rl.plant("dc-motor"), Site("joint", "omega")
    once = effect("flexible-coupling").extend(port_model(motor), joint, {"f": 40.0, "zeta": 0.05, "share": 0.4})
    with pytest.raises(InputError, match="splits the joint in two"):
        effect(second).extend(once, joint, {"f": 40.0, "zeta": 0.05, "share": 0.4, "gap": 0.1})


def test_a_share_of_one_is_named():
    with pytest.raises(InputError, match="between 0 and 1"):
        effect("flexible-coupling").extend(
            port_model(rl.plant("mass-spring-damper")), JOINT, {"f": 40.0, "zeta": 0.05, "share": 1.0}
        )
