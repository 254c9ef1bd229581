"""The Stewart platform against a rigid-body tree in Pinocchio whose loops are closed exactly.

First the oracle itself is judged by the published numbers. Then it judges the plant through the public functions.
"""

from dataclasses import replace

import numpy as np
import pytest
from platform_energy import kinetic_energy, potential_energy

import robustlab as rl
from robustlab.dynamics import stewart

pytest.importorskip("pinocchio")

from oracle import stewart_pinocchio as oracle
from oracle.stewart_pinocchio import PHYSICAL, THESIS, Body, PinocchioStewart, disc

SPIN = THESIS.nut.inertia[2]


def at(z: float) -> np.ndarray:
    return np.array([0.0, 0.0, z, 0.0, 0.0, 0.0])


HOME = at(0.1262)


def random_states(n: int, seed: int = 6) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Poses within reach of the actuators, nut rates (1 rad/s = 0.64 mm/s) and motor torques of a hard run."""
    rng, lengths = np.random.default_rng(seed), PinocchioStewart().lengths
    reach = np.array([0.012, 0.012, 0.012, 0.08, 0.08, 0.12])
    poses = (HOME + reach * rng.uniform(-1, 1, 6) for _ in range(50 * n))
    inside = [pose for pose in poses if lengths(pose).min() > 0.1592 and lengths(pose).max() < 0.1880][:n]
    assert len(inside) == n
    return [(pose, 200 * rng.normal(size=6), 0.02 * rng.normal(size=6)) for pose in inside]


def b_change(one, other) -> float:
    """Percent by which the mean of B = k M^-1 over all motors moving together grows from one to other."""
    return 100 * (np.linalg.inv(other).sum() / np.linalg.inv(one).sum() - 1)


# -- the oracle against the published numbers -------------------------------------------------------------------


def test_published_geometry():
    model = PinocchioStewart()
    table_b = [[165.3, -57.4], [32.9, 171.9], [-32.9, 171.9], [-165.3, -57.4], [-132.4, -114.5], [132.4, -114.5]]
    np.testing.assert_allclose(1e3 * model.base_points[:, :2], table_b, atol=0.06)
    np.testing.assert_allclose(1e3 * model.platform_points[:4, 1], [75.85, 112.94, 112.94, 75.85], atol=0.006)
    np.testing.assert_allclose(1e3 * model.bearing_points[1:3, 0], [16.33, -16.33], atol=0.006)
    for z, length in [(0.1062, 160.71), (0.1262, 173.78), (0.1462, 188.06)]:
        np.testing.assert_allclose(1e3 * model.lengths(at(z)), length, atol=0.006)
    simple = PinocchioStewart(replace(THESIS, shift=0.0))
    for z, length in [(0.1062, 170.66), (0.1262, 183.77), (0.1462, 198.04)]:
        np.testing.assert_allclose(1e3 * simple.lengths(at(z)), length, atol=0.006)


def test_published_dynamics():
    model = PinocchioStewart()
    hold = model.trim_torque(HOME)
    # the bearing points are printed to 0.01 mm and 0.01 degrees, which moves the torque by 1e-5 of itself
    np.testing.assert_allclose(hold, 0.87012e-3, rtol=1.2e-5)
    legs = PinocchioStewart(replace(THESIS, platform=disc(1e-12)))
    np.testing.assert_allclose(legs.trim_torque(HOME), 0.3575e-3, atol=0.00006e-3)
    other_side = PinocchioStewart(replace(THESIS, offset_sign=-1.0))  # the printed torque determines the motors' side
    np.testing.assert_allclose(other_side.trim_torque(HOME), 0.87051e-3, rtol=1e-5)
    M = model.mass_matrix(HOME)
    assert b_change(M, model.mass_matrix(at(0.1062))) == pytest.approx(-1.044, abs=6e-4)  # case 1
    for factor, percent in [(1.025, -0.0037), (1.1, -0.0149)]:  # cases 2a, 2b
        heavier = PinocchioStewart(replace(THESIS, lower_link=THESIS.lower_link.scaled(factor)))
        assert b_change(M, heavier.mass_matrix(HOME)) == pytest.approx(percent, abs=6e-5)
    heavier = PinocchioStewart(THESIS.with_bodies_scaled(1.025))  # case 2c, at any pose
    pose = random_states(1)[0][0]
    np.testing.assert_allclose(heavier.mass_matrix(pose), 1.025 * model.mass_matrix(pose), rtol=1e-11, atol=1e-18)


# -- the oracle closes its loops ------------------------------------------------------------------------------------


def test_loops_are_closed_and_poses_return():
    model = PinocchioStewart()
    for pose, phidot, _ in random_states(5):
        assert np.abs(model.closure(pose)).max() < 1e-15
        np.testing.assert_allclose(model.pose(model.nut_angles(pose)), pose, rtol=0, atol=1e-13)
        e = 1e-5
        rate = (model.nut_angles(pose + e * model.pose_rate(pose, phidot)) - model.nut_angles(pose)) / e
        np.testing.assert_allclose(rate, phidot, rtol=0.05, atol=0.5)


def central(f, x: np.ndarray, step: float) -> np.ndarray:
    """Fourth-order derivative of f along each coordinate of x, on the last axis."""
    columns = []
    for e in step * np.eye(len(x)):
        columns.append((8 * (f(x + e) - f(x - e)) - (f(x + 2 * e) - f(x - 2 * e))) / (12 * step))
    return np.stack(columns, axis=-1)


# -- the plant against the oracle ---------------------------------------------------------------------------------

PRESETS = {"thesis": THESIS, "physical": PHYSICAL}
# A centre of gravity off the platform's middle, on a tilted base.
CROOKED = {
    "platform_cx": 0.021, "platform_cy": -0.034, "platform_cz": 0.05, "tilt_x": 0.11, "tilt_y": -0.17,
    "platform_mass": 10.0, "platform_x": 0.09, "platform_y": 0.08, "platform_z": 0.11,
}  # fmt: skip


def pair(preset: str, straight: bool = True, **more):
    if straight:
        return rl.plant("stewart-platform", preset=preset, **more), PinocchioStewart(PRESETS[preset])
    c = CROOKED
    body = Body(c["platform_mass"], tuple(c[f"platform_{a}"] for a in "xyz"))
    centre, tilt = tuple(c[f"platform_c{a}"] for a in "xyz"), (c["tilt_x"], c["tilt_y"])
    model = PinocchioStewart(replace(PRESETS[preset], platform=body, platform_cg=centre, tilt=tilt))
    return rl.plant("stewart-platform", preset=preset, **c, **more), model


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("straight", [True, False])
def test_trim_mass_matrix_accelerations_and_energies_of_the_plant(preset, straight):
    """The constant inertia on the nuts' own axes, and the drive torque, would hide errors: they are taken off."""
    plant, model = pair(preset, straight)
    own = (SPIN + model.parameters.rotor_inertia * model.parameters.gear**2) * np.eye(6)
    poses = [(at(z), np.zeros(6), np.zeros(6)) for z in (0.1262, 0.1062, 0.1462)]
    for pose, phidot, u in poses + random_states(12):
        trim = rl.trim(plant, pose=pose)
        np.testing.assert_allclose(trim.x, np.concatenate([model.nut_angles(pose), np.zeros(6)]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(trim.u, model.trim_torque(pose), rtol=1e-8, atol=0 if straight else 1e-11)
        expected = model.mass_matrix(pose)
        found = stewart.mass_matrix(plant, pose)
        np.testing.assert_allclose(found - own, expected - own, rtol=0, atol=1e-8 * np.abs(expected - own).max())
        x, still = np.concatenate([trim.x[:6], phidot]), np.concatenate([trim.x[:6], np.zeros(6)])
        rates, expected = plant.derivative(x, u), model.nut_acceleration(pose, phidot, u)
        np.testing.assert_array_equal(rates[:6], phidot)
        np.testing.assert_allclose(rates[6:], expected, rtol=0, atol=1e-8 * np.abs(expected).max())
        found = rates[6:] - plant.derivative(still, u)[6:]
        expected = expected - model.nut_acceleration(pose, np.zeros(6), u)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
        energy = potential_energy(plant, pose), kinetic_energy(plant, pose, phidot)
        assert energy == pytest.approx((model.potential_energy(pose), model.kinetic_energy(pose, phidot)), rel=1e-9)


def test_velocity_terms_of_a_centre_of_gravity_off_the_middle():
    plant, model = pair("thesis", straight=False, gravity=0.0)
    model = PinocchioStewart(replace(model.parameters, gravity=0.0))
    for pose, phidot, _ in random_states(10):
        expected = model.bias_torque(pose, phidot)
        found = stewart.bias_torque(plant, pose, phidot)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_linear_model_of_a_crooked_platform():
    plant, _ = pair("physical", straight=False)
    pose, phidot, u = random_states(1)[0]
    x = np.concatenate([plant.equilibrium(pose=pose).x[:6], 0.1 * phidot])
    found = plant.jacobians(x, u)[0][6:]
    expected = central(lambda at: plant.derivative(at, u)[6:], x, 1e-2)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_encoders_that_are_off():
    """The nut's angle, its own zero included, is off; the unequal transverse inertias of the nut are made equal."""
    even = {"nut_I": 1.93e-5, "nut_J": 1.93e-5}
    off = np.array([0.0, 2.0, -3.0, 0.0, 0.5, 0.0])
    plant = rl.plant("stewart-platform", **even)
    moved = plant.with_parameters(**{f"offset_{i + 1}": off[i] for i in range(6)})
    for pose, phidot, u in random_states(5):
        at, there = rl.trim(plant, pose=pose), rl.trim(moved, pose=pose)
        np.testing.assert_allclose(there.x[:6], at.x[:6] + off, rtol=0, atol=1e-11)
        np.testing.assert_allclose(there.u, at.u, rtol=1e-10)
        np.testing.assert_allclose(moved.poses(at.x[:6] + off), pose, rtol=0, atol=1e-12)
        expected = plant.derivative(np.concatenate([at.x[:6], phidot]), u)
        found = moved.derivative(np.concatenate([at.x[:6] + off, phidot]), u)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


# --- members of the uncertain platform --------------------------------------------------------------------------------


POSE = np.array([0.004, -0.003, 0.128, 0.02, -0.03, 0.04])
RATIO = 4.8 * 41 / 21


def tree(values: dict[str, float]):
    """The tree with the masses and inertias of a member of the set."""
    given = oracle.THESIS

    def body(old, name: str):
        inertia = tuple(
            values.get(f"{name}_{axis}", i)
            for axis, i in zip("IJK" if name != "platform" else "xyz", old.inertia, strict=True)
        )
        return replace(old, mass=values.get(f"{name}_mass", old.mass), inertia=inertia)

    names = {"lower_link": "link", "nut": "nut", "ball_screw": "screw", "motor": "motor", "platform": "platform"}
    bodies = {part: body(getattr(given, part), name) for part, name in names.items()}
    return oracle.PinocchioStewart(replace(given, **bodies))


def stiffness(model, step: float = 2e-4) -> np.ndarray:
    """dphidd/dphi (6, 6) with the holding torque kept: fourth-order differences over the pose, turned to nut angles."""
    u, still = model.trim_torque(POSE), np.zeros(6)
    scale = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 5.0]) * step
    rows = []
    for k in range(6):
        at = [POSE + n * scale * np.eye(6)[k] for n in (1, -1, 2, -2)]
        a, p = ([f(pose) for pose in at] for f in (lambda q: model.nut_acceleration(q, still, u), model.nut_angles))
        rows.append([8 * (x[0] - x[1]) - (x[2] - x[3]) for x in (a, p)])
    by_pose, angles = (np.array([row[k] for row in rows]).T for k in (0, 1))
    return by_pose @ np.linalg.inv(angles)


@pytest.fixture(scope="module")
def uncertain():
    names = ("platform_mass", "link_mass", "nut_mass", "screw_mass", "motor_mass", "nut_K", "platform_x")
    plant = rl.plant("stewart-platform")
    plant = plant.with_parameters(**{name: (plant.values[name], 0.2) for name in names})
    return plant.uncertain(at=POSE)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_a_member_is_the_tree_with_its_masses(uncertain, seed):
    rng = np.random.default_rng(seed)
    delta = {b.name: float(rng.choice([-1.0, 1.0]) if seed == 13 else rng.uniform(-1, 1)) for b in uncertain.blocks}
    model = tree({name: value for name, (value, _) in uncertain.physical(delta).items()})
    member = uncertain.evaluate(delta)
    gain = RATIO * np.linalg.inv(model.mass_matrix(POSE))
    np.testing.assert_allclose(member.B[6:], gain, atol=1e-10 * np.abs(gain).max())
    k = stiffness(model)
    np.testing.assert_allclose(member.A[6:, :6], k, atol=1e-6 * np.abs(k).max())
    # the change is well above these tolerances: 20 % of mass change the stiffness by much more
    change = np.abs(member.A[6:, :6] - uncertain.nominal.A[6:, :6]).max()
    assert change > 1e-3 * np.abs(k).max()
