"""Gap metric and robust gain against closed forms, published values and members."""

import numpy as np
import pytest

import robustlab as rl

# 1 / (s + 1 + delta / 2): the largest gain of the set times k is 1 / (1 - k / 2).
LAG = rl.UncertainModel(rl.ss([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [rl.RealScalar("pole")])


@pytest.mark.parametrize("k", [0.1, 3.0, 40.0])
def test_gap_of_integrators(k):
    assert rl.gap(rl.tf([1], [1, 0]), rl.tf([k], [1, 0])).value == pytest.approx(abs(1 - k) / (1 + k), rel=1e-3)


def test_gaps_published_by_mathworks():
    """Printed to four digits."""
    slow = rl.gap(rl.tf([1], [1, -0.001]), rl.tf([1], [1, 0.001]))
    assert 0.001999 < slow.lower <= slow.value <= 0.0021
    lag = rl.gap(rl.tf([50], [1, 50]), rl.tf([400], [1, 58, 400]))
    assert 0.6147 <= round(lag.value, 4) <= 0.6156
    near = rl.gap(rl.tf([1, 2], [1, 5, 10]), rl.tf([1, 1], [1, 3, 10]))
    assert 0.1390 <= round(near.value, 4) <= 0.1391


def test_gap_of_equal_and_of_incompatible_models():
    one = rl.tf([1], [1, 1])
    assert rl.gap(one, one).value < 1e-9
    assert rl.gap(one, -one).value == 1.0  # the nu-gap is 1


@pytest.mark.parametrize("level", [1.05, 4.0])
def test_robust_gain_closed_form(level):
    wanted = 2 * (1 - 1 / level)
    found = rl.robust_gain(LAG, level)
    assert found.status == "certified"
    assert found.lower * (1 - 1e-9) <= wanted <= found.upper * (1 + 1e-9)
    assert found.upper <= found.lower * 1.01
    assert rl.peak_gain(LAG.evaluate(found.delta)).upper >= level * (1 - 1e-9)
    assert rl.verify(found).proved


@pytest.mark.slow
def test_robust_gain_published():
    """MathWorks' robgain example: the sensitivity of a PID loop is below 1.5 for [0.7821, 0.7837] of the set."""
    plant = rl.parametric([[0, 1], ["-k", "-1.8"]], [[0], [18.0]], [[1, 0]], [[0]], {"k": (10.0, 6.0, 14.0)})
    unmodelled = rl.UncertainModel(rl.ss([], [], [], [[0, 1.0], [0.5, 1.0]]), [rl.FullBlock("delta", 1, 1)])
    # 2.3 + 3/s + 0.38 s / (0.001 s + 1)
    pid = rl.ss([[0, 0], [0, -1000.0]], [[1.0], [1.0]], [[3.0, -380_000.0]], [[2.3 + 380.0]])
    found = rl.robust_gain((1 + plant @ unmodelled @ pid) ** -1, 1.5)
    assert found.lower <= 0.7837
    assert found.upper >= 0.7821
    assert found.upper <= found.lower * 1.01


def test_robust_gain_at_its_ends():
    assert rl.robust_gain(LAG, 0.5).upper == 0.0  # the nominal gain is 1
    near = rl.robust_gain(LAG, 1.0 + 5e-7)  # within the bracket of the nominal gain: no size is proved
    assert (near.lower, near.status) == (0.0, "inconclusive")
    still = rl.UncertainModel(rl.ss([[-1.0]], [[0.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [rl.RealScalar("none")])
    found = rl.robust_gain(still, 2.0)
    assert (found.upper, found.delta, found.status) == (np.inf, {}, "certified")
    assert found.lower >= 2.0**15
