"""Robust gain margins against closed forms, worst-case gains, and the published example."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.statespace import StateSpaceModel

# 1 / (s + 1 + delta / 2): the largest gain of the set times k is 1 / (1 - k / 2).
LAG = rl.UncertainModel(
    StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]]), [rl.RealScalar("pole")]
)


@pytest.mark.parametrize("level", [1.05, 2.0, 4.0, 20.0])
def test_closed_form(level):
    wanted = 2 * (1 - 1 / level)
    found = rl.robust_gain(LAG, level)
    assert found.status == "certified"
    assert found.lower <= wanted * (1 + 1e-6)
    assert found.upper >= wanted * (1 - 1e-6)
    assert found.upper <= found.lower * 1.01
    assert found.proof.upper <= level
    assert rl.hinf_norm(LAG.evaluate(found.delta)).lower >= level * (1 - 1e-9)


def test_the_level_is_not_scaled_with_the_set():
    """Robust performance asks another question: there both grow."""
    assert rl.robust_gain(LAG, 2.0).lower == pytest.approx(1.0, rel=0.01)
    assert rl.robust_performance(0.5 * LAG).lower > 1.0 - 1e-4  # k / 2 = 1 - k / 2 at k = 1: the same only there
    assert rl.robust_performance(0.25 * LAG).lower == pytest.approx(4 / 3, rel=1e-3)
    assert rl.robust_gain(LAG, 4.0).lower == pytest.approx(1.5, rel=0.01)


def test_published_example():
    """MathWorks' robgain example: the sensitivity of a PID loop stays below 1.5 for [0.7821, 0.7837] of the set."""
    plant = rl.parametric([[0, 1], ["-k", "-1.8"]], [[0], [18.0]], [[1, 0]], [[0]], {"k": (10.0, 6.0, 14.0)})
    unmodelled = rl.UncertainModel(StateSpaceModel([], [], [], [[0, 1.0], [0.5, 1.0]]), [rl.FullBlock("delta", 1, 1)])
    # 2.3 + 3/s + 0.38 s / (0.001 s + 1)
    pid = StateSpaceModel([[0, 0], [0, -1000.0]], [[1.0], [1.0]], [[3.0, -380_000.0]], [[2.3 + 380.0]])
    sensitivity = (1 + plant @ unmodelled @ pid) ** -1
    found = rl.robust_gain(sensitivity, 1.5, tolerance=0.003)
    assert found.lower <= 0.7837
    assert found.upper >= 0.7821
    assert found.upper <= found.lower * 1.003


def test_ends():
    assert rl.robust_gain(LAG, 0.5).upper == 0.0  # the nominal gain is 1
    still = rl.UncertainModel(
        StateSpaceModel([[-1.0]], [[0.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [rl.RealScalar("nothing")]
    )
    found = rl.robust_gain(still, 2.0)
    assert (found.upper, found.delta, found.status) == (np.inf, {}, "certified")
    assert 2.0**15 <= found.lower < np.inf  # what was proved, and no more
    assert found.proof.upper <= 2.0


def test_bad_input():
    with pytest.raises(rl.InputError, match="level"):
        rl.robust_gain(LAG, -1.0)
    with pytest.raises(rl.InputError, match="UncertainModel"):
        rl.robust_gain(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 1.0)
