"""Worst-case disk margin: a brute-force search, published values, members, bad inputs."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab import disk_margin

K = rl.StateSpaceModel([[0.0]], [[1.0]], [[2.0]], [[3.0]])  # 3 + 2/s


def oscillator() -> rl.UncertainModel:
    """``x'' + (0.4 + 0.3 d) x' + (2 + p) x = u``, y = 0.5 x + x'."""
    M = rl.StateSpaceModel(
        [[0, 1], [-2, -0.4]],
        [[0, 0, 0], [-0.3, -1, 1]],
        [[0, 1], [1, 0], [0.5, 1]],
        np.zeros((3, 3)),
    )
    stiffness = rl.RealScalar("stiffness", parameter=rl.ParameterRange(2.0, 1.0, "N/m"))
    return rl.UncertainModel(M, [rl.RealScalar("damping"), stiffness])


@pytest.mark.parametrize("skew", [0.7])
def test_one_loop_against_every_member_of_a_grid(skew):
    plant = oscillator()
    lag = rl.StateSpaceModel([[-4.0]], [[4.0]], [[1.0]], [[0.0]])
    k = rl.statespace.series(K, lag)
    result = disk_margin(plant, k, skew=skew)
    members = [
        disk_margin(plant.evaluate({"damping": a, "stiffness": b}), k, skew=skew).simultaneous.upper
        for a in np.linspace(-1, 1, 5)
        for b in np.linspace(-1, 1, 5)
    ]
    assert result.status is rl.Status.CERTIFIED
    assert result.lower <= min(members) * (1 + 1e-9)
    assert result.upper == pytest.approx(min(members), rel=5e-3)
    assert result.lower >= 0.99 * result.upper
    assert result.nominal.lower >= result.lower
    # The member is one of the set, and its margin is what is claimed.
    assert max(map(abs, result.delta.values())) <= 1 + 1e-12
    again = disk_margin(plant.evaluate(result.delta), k, skew=skew).simultaneous
    assert again.upper == pytest.approx(result.upper, rel=1e-9)
    assert result.physical["stiffness"][0] == pytest.approx(2 + result.delta["stiffness"])


def test_the_spinning_satellite_as_published_by_mathworks():
    """wcdiskmargin, loop at a time, first output: between 0.6147 and 0.6160, gains 0.5298 to 1.8875."""
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    B = np.hstack([np.eye(2), 0.1 * np.eye(2), np.eye(2)])
    C = np.vstack([turn, np.zeros((2, 2)), np.eye(2) + 10 * turn])
    D = np.zeros((6, 6))
    D[2:4, 4:6], D[4:6, 0:2] = np.eye(2), np.eye(2)
    outputs = ["z1", "z2", "z3", "z4", "y1", "y2"]
    M = rl.StateSpaceModel(-0.2 * np.eye(2) + 10 * turn, B, C, D, outputs=outputs)
    p = rl.RealScalar("p", 2, rl.ParameterRange(10.0, 1.0, "rad/s"))
    plant = rl.UncertainModel(M, [p, rl.FullBlock("DEL", 2, 2)])
    gain = rl.StateSpaceModel([], [], [], [[1, -2], [0, 1]])
    result = disk_margin(plant, gain, channel="y1")
    assert result.lower <= 0.6160
    assert result.upper >= 0.6147
    assert result.lower == pytest.approx(0.6147, rel=5e-3)
    assert result.upper == pytest.approx(0.6160, rel=2e-3)
    assert result.gain_margin == pytest.approx((0.5298, 1.8875), rel=3e-3)
    assert result.physical["p"] == (pytest.approx(11.0), "rad/s")
    assert np.linalg.norm(result.delta["DEL"], 2) <= 1 + 1e-9


def test_bad_inputs_are_named():
    plant = oscillator()
    with pytest.raises(rl.InputError, match="one of"):
        disk_margin(plant, K, channel="y")
    with pytest.raises(rl.InputError, match="channel: 'y1' for a model without uncertainty"):
        disk_margin(plant.nominal, K, channel="y1")
    with pytest.raises(rl.InputError, match="accuracy"):
        disk_margin(plant, K, accuracy=0.0)
    with pytest.raises(rl.NoTrustworthyNumber, match="unstable"):
        disk_margin(plant, rl.StateSpaceModel([], [], [], [[-5.0]]))
