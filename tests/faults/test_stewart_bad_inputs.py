"""Input that the Stewart platform rejects, with message and exit code."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import SineTrajectory, follow, stewart, two_layer

PLANT = rl.plant("stewart-platform")
HOME = PLANT.geometry.home
T = np.linspace(0, 0.3, 31)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"preset": "thesys"}, "did you mean thesis"),
        ({"motors": "yes"}, "True or False"),
        ({"link_mass": -0.4}, "'link_mass': -0.4 kg, expected no negative value"),
        ({"platform_mass": 0.0}, "a positive value"),
        ({"link_K": 2e-3}, "triangle inequality"),
        ({"platform_z": 1.0}, "stewart-platform: platform"),
        ({"gravity": float("nan")}, "gravity: nan"),
        ({"lead": 0.0}, "'lead'"),
        ({"c": 0.5}, "c: 0.5 m"),
        ({"L_min": 0.2}, "L_min"),
        ({"m_plat": 3.0}, "no such parameter"),
        ({"R": 2.07}, "no such parameter"),  # a motor's, without motors
        ({"r_m": 0.17502, "alpha_m": 0.0, "z_m": 0.0}, "bearing points fall on the base points"),
    ],
)
def test_bad_machines(given, words):
    with pytest.raises(rl.InputError, match=words) as caught:
        rl.plant("stewart-platform", **given)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ([0, 0, 0.15, 0, 0, 0], "out of the workspace: actuator . would be .* mm .6 of 6"),
        ([0, 0, 0.1262, 0.3, 0, 0], "out of the workspace"),
        ([0, 0, float("nan"), 0, 0, 0], r"pose\[2\] is NaN"),
        ([0, 0, 0.1262], "shape"),
        ([HOME, HOME], "2 poses, expected one"),
        (["a"] * 6, "dtype"),
    ],
)
def test_bad_poses(pose, words):
    with pytest.raises(rl.InputError, match=words) as caught:
        rl.trim(PLANT, pose=pose)
    assert caught.value.exit_code == 3


def test_singular_pose():
    free = rl.plant("stewart-platform", L_min=0.01, L_max=1.0)
    pose = HOME.copy()
    yaw = np.tile(HOME, (2001, 1))
    yaw[:, 5] = np.linspace(1.0, 2.2, 2001)
    from scipy.optimize import brentq

    def determinant(angle):
        pose[5] = angle
        return np.linalg.det(stewart.velocity_jacobian(free.geometry, pose))

    pose[5] = brentq(determinant, 1.0, 2.2, xtol=1e-15)
    for call in (lambda: rl.trim(free, pose=pose), lambda: stewart.mass_matrix(free, pose)):
        with pytest.raises(rl.NoTrustworthyNumber, match="singular pose") as caught:
            call()
        assert caught.value.exit_code == 4


HOLD = np.tile(rl.trim(PLANT).u, (31, 1))
FAR = np.array([1500.0, 0, 0, 0, 0, 0])  # one actuator 0.95 m longer than the others
G = PLANT.geometry
REFUSED = [
    (lambda: PLANT.uncertain(hold=["phi_1"]), rl.InputError, "the pose is held"),
    (lambda: PLANT.uncertain(at=[0, 0, 0.5, 0, 0, 0]), rl.InputError, "mm"),
    (lambda: PLANT.uncertain(ranges={"platform_mas": (3.0, 4.0)}), rl.InputError, "did you mean platform_mass"),
    (lambda: PLANT.uncertain(ranges={"platform_mass": (-1.0, 4.0)}), rl.InputError, "positive"),
    (lambda: PLANT.uncertain(["nothing"], ranges={"platform_mass": (3.0, 4.0)}), rl.InputError, "nothing"),
    (lambda: rl.trim(PLANT, phi=FAR), rl.NoTrustworthyNumber, "no pose"),
    (lambda: rl.trim(PLANT, phi=-300.0 * np.ones(6)), rl.NoTrustworthyNumber, "shorter than nothing"),
    (lambda: PLANT.derivative(np.r_[FAR, np.zeros(6)], np.zeros(6)), rl.NoTrustworthyNumber, "no pose"),
    (lambda: rl.trim(PLANT, phi=30.0 * np.ones(6)), rl.InputError, "out of the workspace"),
    (lambda: rl.trim(PLANT, phi=np.zeros(6), pose=HOME), rl.InputError, "one of them"),
    (lambda: rl.trim(PLANT, poes=HOME), rl.InputError, "'poes'"),
    (lambda: rl.trim(rl.plant("dc-motor")), rl.InputError, "no nonlinear plant"),
    (lambda: rl.linearise(PLANT, at="home"), rl.InputError, "linearise: at"),
    (lambda: rl.linearise(PLANT, at=(np.zeros(11), np.zeros(6))), rl.InputError, "expected 12"),
    (lambda: rl.simulate(PLANT, T, 3 * HOLD), rl.NoTrustworthyNumber, r"end of its range .* at t = 0\.\d+ s"),
    (lambda: rl.simulate(PLANT, T, {"torque_1": HOLD[:, 0]}), rl.InputError, "no samples for input torque_2"),
    (lambda: rl.simulate(PLANT, T, HOLD, hold="cubic"), rl.InputError, "hold: 'cubic'"),
    (lambda: rl.simulate(PLANT, T[:5], HOLD[:5], hold="spline"), rl.InputError, "at least 6"),
    (lambda: rl.simulate(PLANT, T, HOLD, np.zeros(3)), rl.InputError, "3 numbers for phi_1"),
    (lambda: rl.simulate(PLANT, T, HOLD, rtol=0.0), rl.InputError, "between 0 and 1"),
    (lambda: rl.simulate(PLANT, T, HOLD, step=-1.0), rl.InputError, "between 0 and 1"),
    (lambda: rl.simulate(PLANT, T, HOLD, step=1e-3), rl.InputError, "integrated with error control"),
    (lambda: rl.simulate(rl.plant("dc-motor"), T, np.zeros(31), rtol=1e-8), rl.InputError, "without error"),
    (lambda: rl.simulate(rl.plant("dc-motor"), T, np.zeros(31), hold="spline"), rl.InputError, "for a linear model"),
    (lambda: stewart.direct_kinematics(G, [0.17, 0.17, -0.17, 0.17, 0.17, 0.17]), rl.InputError, r"lengths\[0,2\]"),
    (lambda: stewart.direct_kinematics(G, np.full((3, 6), 0.17), [HOME, HOME]), rl.InputError, "2 starts"),
    (lambda: stewart.direct_kinematics(G, np.tile(G.home_lengths, (2, 1))).pose, rl.InputError, "2 poses"),
]


@pytest.mark.parametrize(("call", "error", "words"), REFUSED)
def test_what_is_refused(call, error, words):
    with pytest.raises(error, match=words) as caught:
        call()
    assert caught.value.exit_code == (4 if error is rl.NoTrustworthyNumber else 3)


# --- two-layer control ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def machine():
    return rl.plant("stewart-platform", motors=True)


def test_controllers_that_are_none(machine):
    with pytest.raises(rl.InputError, match="a plant without motors"):
        two_layer(rl.plant("stewart-platform"))
    for name in ("p_up", "p_low"):
        for value in (0.0, -3.0, float("nan")):
            with pytest.raises(rl.InputError, match=name):
                two_layer(machine, **{name: value})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"start": np.zeros(5)}, "start has 5 entries"),
        ({"amplitude": [np.nan] * 6}, "amplitude"),
        ({"omega": 0.0}, "a number that is positive"),
        ({"lift_time": -1.0}, "a number that is positive"),
        ({"rise_time": -1.0}, "a number that is not negative"),
    ],
)
def test_trajectories_that_are_none(given, words):
    with pytest.raises(rl.InputError, match=words):
        SineTrajectory(**({"start": np.zeros(6)} | given))


def test_a_trajectory_out_of_the_workspace_is_reported_with_its_time(machine):
    path = SineTrajectory(machine.geometry.home, lift=(0, 0, 0.04, 0, 0, 0))
    with pytest.raises(rl.InputError, match=r"trajectory at t = 1.*out of the workspace: actuator"):
        follow(machine, two_layer(machine), path, np.linspace(0, 3, 301))


def test_an_unstable_loop_is_reported_with_its_time(machine):
    path = SineTrajectory(machine.geometry.home)
    with pytest.raises(rl.NoTrustworthyNumber, match=r"t = \d"):
        follow(machine, two_layer(machine, p_low=1200.0), path, np.linspace(0, 3, 301))
    with pytest.raises(rl.InputError, match="rtol"):
        follow(machine, two_layer(machine), path, np.linspace(0, 1, 11), rtol=0.0)
