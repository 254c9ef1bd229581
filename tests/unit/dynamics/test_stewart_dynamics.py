"""Dynamics of the Stewart platform against laws of mechanics, the thesis' numbers, and independent derivatives."""

import numpy as np
import pytest
from platform_energy import kinetic_energy, potential_energy

import robustlab as rl
from robustlab.dynamics import NonlinearPlant, input_signal, stewart

THESIS = rl.plant("stewart-platform")
PHYSICAL = rl.plant("stewart-platform", preset="physical")
FREE = {"L_min": 0.10, "L_max": 0.25}
HOME = THESIS.geometry.home


def at(z):
    return np.array([0.0, 0.0, z, 0.0, 0.0, 0.0])


def random_poses(n, seed=3):
    return HOME + np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * [0.006, 0.006, 0.006, 0.04, 0.04, 0.06]


def disc(mass):
    across, along = mass * (3 * 0.19**2 + 0.01**2) / 12, mass * 0.19**2 / 2
    return {"platform_mass": mass, "platform_x": across, "platform_y": across, "platform_z": along}


def gain(plant, pose=HOME):
    """Acceleration of the nuts by equal torques on all motors."""
    return rl.linearise(plant, at=pose).B[6:].sum() / 6


# --- the thesis' numbers (THESIS items 7, 12, 15-18, sensitivities) ---------------------------------------------------


def test_holding_torque():
    # bearing points are printed to 0.01 mm, which moves the torque by 1e-5 of itself
    np.testing.assert_allclose(rl.trim(THESIS).u, 0.87012e-3, rtol=1.2e-5)
    np.testing.assert_allclose(rl.trim(PHYSICAL).u, rl.trim(THESIS).u, rtol=1e-15)
    np.testing.assert_allclose(rl.trim(THESIS.with_parameters(**disc(1e-9))).u, 0.3575e-3, atol=6e-8)


@pytest.mark.parametrize(
    ("change", "inertia", "a", "case_1", "case_2a", "case_2b", "hold"),
    [
        ({}, 2.277e-5, 2.60, -1.044, -0.0037, -0.0149, 0.8701e-3),
        ({**disc(3.841), "motor_cg": -0.1087 / 2}, 2.276e-5, 2.11, -0.795, -0.0037, -0.0149, 0.8701e-3),
        ({"rotor_J": 7.2e-6}, 6.551e-4, 0.090, -0.037, -0.0001, -0.0005, 0.8701e-3),
        (disc(3.484), 2.282e-5, 2.68, -1.087, -0.0037, -0.0149, 0.9214e-3),
        ({**disc(0.479), "lead": 0.008}, 2.334e-5, 7.29, -2.504, -0.0145, -0.0581, 0.8701e-3),
        ({**disc(3.208), "screw_cg": 0.09414}, 2.277e-5, 2.57, -1.038, -0.0037, -0.0149, 0.8701e-3),
        ({**disc(0.545), "lead": 0.004 * 41 / 21}, 2.332e-5, 7.02, -2.425, -0.0139, -0.0554, 0.8701e-3),
        ({**disc(0.545), "ratio": 4.8}, 2.240e-5, 1.92, -0.674, -0.0038, -0.0151, 0.8701e-3),
        ({"nut_K": 2.2071e-5 / 4}, 6.22e-6, 9.53, -3.717, -0.0136, -0.0545, 0.8701e-3),
    ],
)
def test_sensitivities(change, inertia, a, case_1, case_2a, case_2b, hold):
    plant = THESIS.with_parameters(**change)
    np.testing.assert_allclose(rl.trim(plant).u, hold, rtol=2e-4)
    assert stewart.mass_matrix(plant, HOME).sum() / 6 == pytest.approx(inertia, rel=3e-4)
    A = rl.linearise(plant, at=HOME).A
    assert A[6:, :6].sum() / 6 == pytest.approx(a, abs=6e-3)
    assert 100 * (gain(plant, at(0.1062)) / gain(plant) - 1) == pytest.approx(case_1, abs=1.2e-3)
    for factor, percent in ((1.025, case_2a), (1.1, case_2b)):
        heavy = plant.with_parameters(**{f"link_{k}": factor * plant.values[f"link_{k}"] for k in ("mass", *"IJK")})
        assert 100 * (gain(heavy) / gain(plant) - 1) == pytest.approx(percent, abs=6e-5)


# --- laws of mechanics ---------------------------------------------------------------


def central(f, x, step):
    return np.stack(
        [
            (45 * (f(x + e) - f(x - e)) - 9 * (f(x + 2 * e) - f(x - 2 * e)) + (f(x + 3 * e) - f(x - 3 * e)))
            / (60 * step)
            for e in step * np.eye(len(x))
        ],
        axis=-1,
    )


def test_holding_torque_is_virtual_work():
    """K u . dphi = dU: the potential energy is summed over the bodies apart from the equations of motion."""
    k = THESIS.values["ratio"]
    for pose in random_poses(3):
        dU = central(lambda q: np.array(potential_energy(THESIS, q)), pose, 2e-3)
        dphi = central(lambda q: stewart.nut_angles(THESIS.geometry, q), pose, 2e-3)
        np.testing.assert_allclose(k * rl.trim(THESIS, pose=pose).u @ dphi, dU, rtol=0, atol=1e-9 * np.abs(dU).max())


def test_velocity_terms_are_lagranges():
    rng = np.random.default_rng(0)
    for pose in random_poses(2):
        phi, rate = stewart.nut_angles(THESIS.geometry, pose), 100 * rng.normal(size=6)
        dM = central(lambda p, near=pose: stewart.mass_matrix(PHYSICAL, PHYSICAL.poses(p, near)), phi, 0.3)
        expected = np.einsum("ijk,k,j->i", dM, rate, rate) - 0.5 * np.einsum("jki,j,k->i", dM, rate, rate)
        found = stewart.bias_torque(PHYSICAL, pose, rate) - stewart.bias_torque(PHYSICAL, pose, np.zeros(6))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("preset", ["thesis", "physical"])
def test_energy_over_a_second(preset):
    """Energy changes by the work of constant torques, over a second of motion at rtol 1e-11."""
    plant = rl.plant("stewart-platform", preset=preset, **FREE)
    start, t = rl.trim(plant, pose=[0.002, -0.003, 0.1262, 0.01, -0.02, 0.02]), np.linspace(0, 1, 201)
    u = start.u * (1 + 0.02 * np.array([1, -1, 0.5, -0.5, 0.3, -0.2]))
    record = rl.simulate(plant, t, np.tile(u, (201, 1)), start, rtol=1e-11)
    phi = np.column_stack([record[f"phi_{i}"] for i in range(1, 7)])
    rate = np.column_stack([record[f"phidot_{i}"] for i in range(1, 7)])
    poses = plant.poses(phi, start.pose)
    energy = np.array(
        [kinetic_energy(plant, q, v) + potential_energy(plant, q) for q, v in zip(poses, rate, strict=True)]
    )
    work = plant.values["ratio"] * (phi - phi[0]) @ u
    moved = np.ptp([potential_energy(plant, q) for q in poses])
    assert moved > 1e-4
    assert np.abs(energy - energy[0] - work).max() < 1e-8 * moved


# --- derivatives ---------------------------------------------------------------


@pytest.mark.parametrize("motors", [False, True])
def test_linear_model_is_the_derivative(motors):
    plant = rl.plant("stewart-platform", preset="physical" if motors else "thesis", motors=motors)
    trim = rl.trim(plant, pose=random_poses(1)[0])
    rng = np.random.default_rng(2)
    x, u = trim.x.copy(), trim.u * 1.5
    for speed in (0.0, 60.0):  # at rest but not trimmed, and moving
        x[6:12] = speed * rng.normal(size=6)
        model = rl.linearise(plant, at=(x, u))
        size = np.array([0.05] * 6 + [0.5] * 6 + [0.1] * (6 if motors else 0))
        A = central(lambda s, size=size: plant.derivative(size * s, u), x / size, 1.0) / size
        B = central(lambda v: plant.derivative(x, v), u, 1e-3)
        for rows in (slice(0, 6), slice(6, 12), slice(12, None)):
            for columns in (slice(0, 6), slice(6, 12), slice(12, None)):
                block = A[rows, columns]
                if block.size and np.abs(block).max() > 0:
                    floor = 1e-9 * max(np.abs(block).max(), 1e-3 * np.abs(A[rows]).max())
                    np.testing.assert_allclose(model.A[rows, columns], block, rtol=0, atol=floor)
        np.testing.assert_allclose(model.B, B, rtol=0, atol=1e-10 * np.abs(B).max())
        np.testing.assert_array_equal(model.C, np.eye(12, len(x)))
        assert not model.D.any()


# --- trim and simulation ---------------------------------------------------------------


def test_trim_by_pose_and_by_angles():
    for motors in (False, True):
        plant = rl.plant("stewart-platform", motors=motors)
        pose = random_poses(1)[0]
        trim = rl.trim(plant, pose=pose)
        np.testing.assert_allclose(rl.trim(plant, phi=trim.x[:6]).pose, pose, atol=1e-12)
        # the rounding of the torque, times a gain of 4e5
        assert np.abs(plant.derivative(trim.x, trim.u)).max() < 1e-9
        assert trim.status is rl.Status.CONVERGED
        if motors:
            p = plant.values
            np.testing.assert_allclose(trim.u / p["R"] * p["Km"], rl.trim(THESIS, pose=pose).u, rtol=1e-13)


@pytest.mark.parametrize("hold", ["zoh", "foh", "spline"])
@pytest.mark.parametrize("motors", [False, True])
def test_compiled_integrator_against_scipy(hold, motors):
    """Another integrator, in nut coordinates, through derivative and direct kinematics."""
    plant = rl.plant("stewart-platform", motors=motors, preset="physical", **FREE)
    trim, t = rl.trim(plant), np.linspace(0, 0.05, 11)
    shape = np.sin(2 * np.pi * 20 * t)[:, None] * np.array([1, -0.5, 0.3, 0.2, -1, 0.6])
    u = trim.u + (1.0 if motors else 5e-3) * shape
    signal = input_signal(t, u, hold)
    expected = NonlinearPlant.trajectory(plant, signal, trim.x, 1e-10)
    found = plant.trajectory(signal, trim.x, rtol=1e-10)
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=2e-7)
