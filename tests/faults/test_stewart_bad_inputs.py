"""What the Stewart platform refuses, with the words that name it and the exit code."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics.stewart import (
    acceleration_bias,
    assembly_poses,
    condition_map,
    direct_kinematics,
    inverse_kinematics,
    linear_models,
    mass_matrix,
)

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
        from robustlab.dynamics.stewart import velocity_jacobian

        return np.linalg.det(velocity_jacobian(free.geometry, pose))

    pose[5] = brentq(determinant, 1.0, 2.2, xtol=1e-15)
    for call in (lambda: rl.trim(free, pose=pose), lambda: mass_matrix(free, pose)):
        with pytest.raises(rl.NoTrustworthyNumber, match="singular pose") as caught:
            call()
        assert caught.value.exit_code == 4


def test_unreachable_trim():
    phi = np.array([1500.0, 0, 0, 0, 0, 0])  # one actuator 0.95 m longer than the others
    with pytest.raises(rl.NoTrustworthyNumber, match="no pose"):
        rl.trim(PLANT, phi=phi)
    with pytest.raises(rl.NoTrustworthyNumber, match="shorter than nothing"):
        rl.trim(PLANT, phi=-300.0 * np.ones(6))
    with pytest.raises(rl.InputError, match="out of the workspace"):
        rl.trim(PLANT, phi=30.0 * np.ones(6))
    with pytest.raises(rl.InputError, match="one of them"):
        rl.trim(PLANT, phi=np.zeros(6), pose=HOME)
    with pytest.raises(rl.InputError, match="'poes'"):
        rl.trim(PLANT, poes=HOME)
    with pytest.raises(rl.InputError, match="no nonlinear plant"):
        rl.trim(rl.plant("dc-motor"))
    with pytest.raises(rl.NoTrustworthyNumber, match="no pose"):
        PLANT.derivative(np.r_[phi, np.zeros(6)], np.zeros(6))


def test_bad_simulations():
    hold = np.tile(rl.trim(PLANT).u, (31, 1))
    with pytest.raises(rl.NoTrustworthyNumber, match=r"end of its range .* at t = 0\.\d+ s") as caught:
        rl.simulate(PLANT, T, 3 * hold)
    assert caught.value.exit_code == 4
    with pytest.raises(rl.NoTrustworthyNumber, match="end of its range"):
        rl.simulate(PLANT, T, 3 * hold, step=1e-4)
    with pytest.raises(rl.InputError, match="no samples for input torque_2"):
        rl.simulate(PLANT, T, {"torque_1": hold[:, 0]})
    with pytest.raises(rl.InputError, match="hold: 'cubic'"):
        rl.simulate(PLANT, T, hold, hold="cubic")
    with pytest.raises(rl.InputError, match="at least 6"):
        rl.simulate(PLANT, T[:5], hold[:5], hold="spline")
    with pytest.raises(rl.InputError, match="3 numbers for phi_1"):
        rl.simulate(PLANT, T, hold, np.zeros(3))
    for bad in ({"rtol": 0.0}, {"rtol": "small"}, {"step": -1.0}, {"rtol": float("nan")}):
        with pytest.raises(rl.InputError, match=r"between 0 and 1|'small', expected a number"):
            rl.simulate(PLANT, T, hold, **bad)
    with pytest.raises(rl.InputError, match="one of them"):
        rl.simulate(PLANT, T, hold, rtol=1e-8, step=1e-3)
    with pytest.raises(rl.InputError, match="without error"):
        rl.simulate(rl.plant("dc-motor"), T, np.zeros(31), rtol=1e-8)
    with pytest.raises(rl.InputError, match="'spline' for a linear model"):
        rl.simulate(rl.plant("dc-motor"), T, np.zeros(31), hold="spline")


def test_bad_kinematics():
    g = PLANT.geometry
    with pytest.raises(rl.InputError, match="joint"):
        inverse_kinematics(g, HOME, joint="ball")
    with pytest.raises(rl.InputError, match=r"lengths\[0,2\]"):
        direct_kinematics(g, [0.17, 0.17, -0.17, 0.17, 0.17, 0.17])
    with pytest.raises(rl.InputError, match="2 starts"):
        direct_kinematics(g, np.full((3, 6), 0.17), [HOME, HOME])
    with pytest.raises(rl.InputError, match="1 twists"):
        acceleration_bias(g, [HOME, HOME], HOME)
    with pytest.raises(rl.InputError, match="names"):
        condition_map(g, ("tx", "tx"), [0], [0])
    with pytest.raises(rl.NoTrustworthyNumber, match="none of 1 seeds"):
        assembly_poses(g, [0.5, 0.17, 0.17, 0.17, 0.17, 0.17], [HOME])
    with pytest.raises(rl.InputError, match="2 poses"):
        _ = (
            direct_kinematics(g, np.tile(g.home_lengths, (2, 1))).poses,
            direct_kinematics(g, np.tile(g.home_lengths, (2, 1))).pose,
        )


def test_bad_batches():
    for given, words in (
        ({"lead": np.full(2, 0.004)}, "shapes the legs"),
        ({"mass": np.ones(2)}, "no such parameter"),
        ({"link_mass": np.ones(3)}, "3 values"),
        ({"link_mass": [0.4, -0.1]}, "no negative value"),
    ):
        with pytest.raises(rl.InputError, match=words):
            linear_models(PLANT, [HOME, HOME], given)
