"""Goals for structured controllers against closed forms, frequency responses and independent margins."""

from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.synthesis import (
    Damping,
    GainGoal,
    MarginGoal,
    SensitivityGoal,
    TrackingGoal,
    VarianceGoal,
)

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
SERVO = rl.StateSpaceModel(
    [[0, 1, 0], [0, -1, 1], [0, 0, -5]], [[0], [0], [5]], [[1, 0, 0]], [[0]], inputs=["u"], outputs=["y"]
)
OTHER = rl.StateSpaceModel(
    [[0, 1, 0], [0, -1, 1.3], [0, 0, -4]], [[0], [0], [4]], [[1, 0, 0]], [[0]], inputs=["u"], outputs=["y"]
)
OMEGA = np.geomspace(1e-4, 1e4, 3000)


def loop_of(g: rl.StateSpaceModel, K: rl.StateSpaceModel) -> tuple[Any, Any, Any]:
    """S, K S and T on the grid, from the responses of plant and controller."""
    gain, k = (rl.frequency_response(m, OMEGA)[:, 0, 0] for m in (g, K))
    S = 1 / (1 + gain * k)
    return S, k * S, gain * k * S


def test_a_variance_under_a_hard_gain_limit_in_closed_form() -> None:
    """x' = -(1 + k) x + d: deviation 1/sqrt(2 (1 + k)); from noise to control the gain is k at high frequency."""
    found = rl.tune(LAG, "p", [VarianceGoal(0.1), GainGoal(5.0, "noise", "control", hard=True)], starts=1)
    assert found.status is rl.Status.CONVERGED, found.reason
    soft, hard = found.goals
    assert hard.value <= 1
    assert hard.value == pytest.approx(1, abs=5e-3)
    assert soft.value == pytest.approx(10 / np.sqrt(12), rel=5e-3)
    assert found.values["Kp[1]"] == pytest.approx(5, rel=1e-2)
    assert found.gamma == soft.value


@pytest.mark.slow
def test_every_value_is_that_of_the_loop_at_its_worst_frequency_and_plant() -> None:
    goals = [TrackingGoal(2.0), SensitivityGoal(1.4, hard=True), GainGoal(20.0, "noise", "control", hard=True)]
    found = rl.tune([SERVO, OTHER], "pd", [*goals, GainGoal(1.1, "reference"), Damping(0.4)], starts=1)
    assert found.status is rl.Status.CERTIFIED, found.reason
    assert not found.missed
    weight = rl.frequency_response(rl.performance_weight(1.0, 1e-2, 2.0), OMEGA)[:, 0, 0]
    for i, g in enumerate((SERVO, OTHER)):
        S, KS, T = loop_of(g, found.K)
        by_hand = [weight * S, S / 1.4, KS / 20, T / 1.1]
        for goal, values in zip(found.goals, by_hand, strict=True):
            peak = np.abs(values).max()
            assert 0.995 * goal.values[i] <= peak <= goal.values[i] * (1 + 1e-9), goal.text
        poles = np.linalg.eigvals(
            np.block([[g.A - g.B @ found.K.D @ g.C, g.B @ found.K.C], [-found.K.B @ g.C, found.K.A]])
        )
        assert (-poles.real / np.abs(poles)).min() >= 0.4 - 1e-6
    assert found.table() is not None


@pytest.mark.slow
def test_the_margin_is_that_of_disk_margin() -> None:
    found = rl.tune(SERVO, "pd", [TrackingGoal(1.5), MarginGoal(1.2, "input", hard=True)], starts=1)
    margin = rl.disk_margin(SERVO, found.K, at="input").simultaneous
    assert found.goals[1].value == pytest.approx(1.2 / margin.lower, rel=1e-4)
    assert margin.lower >= 1.2 * (1 - 1e-4)


def test_a_goal_beyond_a_zero_is_proved_infeasible() -> None:
    """(1 - s)/(1 + s): S(1) = 1 and |W S| >= |W(1)| = (1/1.5 + 5)/(1 + 0.5) for every controller."""
    plant = rl.StateSpaceModel([[-1.0]], [[1.0]], [[2.0]], [[-1.0]])
    found = rl.tune(plant, "pi", [SensitivityGoal(1.5, bandwidth=5.0, error=0.1, hard=True)], starts=1)
    assert found.status is rl.Status.INFEASIBLE
    (goal,) = found.missed
    assert goal.floor == pytest.approx((1 / 1.5 + 5) / 1.5, rel=1e-4)
    assert "no controller of any structure" in found.reason
    assert not found.status.trustworthy


def test_a_goal_beyond_the_structure_is_missed_without_a_proof() -> None:
    found = rl.tune(LAG, "p", [TrackingGoal(1.0, hard=True), GainGoal(1.0)], bounds={"Kp[1]": (0.0, 1.0)}, starts=1)
    assert found.status is rl.Status.INCONCLUSIVE
    assert [goal.text for goal in found.missed] == [found.goals[0].text]
    assert found.missed[0].value == pytest.approx(50, rel=1e-2)  # S(0) = 1/2 at an error of 0.01
    assert "no proof that it cannot be met" in found.reason


def test_a_sampled_plant() -> None:
    """z-domain by hand: P control of x+ = a x + b u; the gain from reference to output at z = 1 and z = -1."""
    g = rl.discretise(LAG, 0.1, "zoh")
    a, b = float(g.A[0, 0]), float(g.B[0, 0])
    found = rl.tune(g, "p", [TrackingGoal(1.0), GainGoal(5.0, "noise", "control", hard=True)], starts=1)
    assert found.status is rl.Status.CERTIFIED, found.reason
    k = found.values["Kp[1]"]
    at = [abs(k / (1 + k * b / (z - a))) for z in (1.0, -1.0)]
    assert found.goals[1].value == pytest.approx(max(at) / 5, rel=1e-4)
    S0 = 1 / (1 + k * b / (1 - a))
    assert found.goals[0].value >= 100 * S0 * (1 - 1e-6)  # 1/error at z = 1
