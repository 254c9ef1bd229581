"""Two-layer control: rejected input and its messages."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import SineTrajectory, follow, two_layer


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
