"""Fault rows 18 to 23 for synthesis: each bad case ends in its time, with its message."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import hinf, mixsyn
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis import hamiltonian_riccati
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft


def output_feedback_problem(a: float, d22: float = 0.0, dt: float = 0.0) -> StateSpaceModel:
    """x' = a x + w1 + u, z = [x; u], y = x + w2 + d22 u; its smallest gamma is a + sqrt(a^2 + 2)."""
    return StateSpaceModel([[a]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, d22]], dt)


# --- row 18: discrete and continuous ---


def test_discrete_plant_with_continuous_weight_is_refused():
    plant = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    weight = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(InputError, match=r"W1: dt is 0 s, expected 0.1 s"):
        mixsyn(plant, weight, 1.0)


# --- row 20: what no controller can do, and what the textbook would not allow ---


def test_broken_assumptions_are_named_with_their_meaning():
    """No direct penalty on the valve, no noise on the level, and an undamped oscillation that z does not show."""
    A = np.zeros((3, 3))
    A[:2, :2] = [[0.0, 2.0], [-2.0, 0.0]]
    A[2, 2] = -1.0
    plant = StateSpaceModel(
        A, [[1.0, 1.0], [0.0, 1.0], [1.0, 1.0]], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], np.zeros((2, 2)),
        inputs=["w", "valve"], outputs=["z", "level"], states=["swing", "swing rate", "tank"],
    )  # fmt: skip
    design = hinf(plant, 1, 1)
    text = " | ".join(design.assumptions)
    assert "control valve has no direct penalty" in text
    assert "measurement level has no direct noise" in text
    assert "zero on the axis at 2 rad/s" in text
    assert "swing" in text
    assert design.status is Status.CERTIFIED
    assert ("regularised, because", design.assumptions[0]) in design.facts()


# --- row 21: scaling, ill-posed loops, lost digits ---


def test_units_twelve_orders_apart_do_not_change_gamma():
    base = output_feedback_problem(-1.0)
    u, y = 1e-12, 1e12
    plant = StateSpaceModel(
        base.A * 1e6, base.B * [1, 1, u] * 1e6, base.C * np.array([[1], [1], [y]]),
        base.D * np.array([[1], [1], [y]]) * [1, 1, u],
    )  # fmt: skip
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    assert design.status is Status.CERTIFIED
    assert design.gamma == pytest.approx(np.sqrt(3) - 1, rel=1e-3)


@pytest.mark.parametrize("d22", [1e8, -1.0, 3.7])
def test_direct_term_never_gives_an_ill_posed_loop(d22):
    plant = output_feedback_problem(0.5, d22)
    design = hinf(plant, 1, 1)
    assert np.linalg.cond(np.eye(1) - design.K.D * d22) < 1e12
    assert hinf_norm(lower_lft(plant, design.K)).value <= design.gamma


def test_nan_is_refused_before_any_native_call():
    with pytest.raises(InputError, match=r"NaN|not finite"):
        output_feedback_problem(float("nan"))
    bad = np.array([[np.nan]])
    assert hamiltonian_riccati(bad, np.eye(1), np.eye(1)) is None


# --- row 23: time ---


def test_time_limit_is_kept_and_reported():
    rng = np.random.default_rng(0)
    n = 24
    A = rng.standard_normal((n, n)) - 2 * np.eye(n)
    plant = StateSpaceModel(A, rng.standard_normal((n, 5)), rng.standard_normal((5, n)), np.zeros((5, 5)))
    try:
        design = hinf(plant, 2, 2, time_limit=0.2)
    except NoTrustworthyNumber as error:
        assert "not repeatable" in str(error)
    else:
        assert design.status is not Status.CERTIFIED
        assert "not repeatable" in design.reason
        assert hinf_norm(lower_lft(plant, design.K)).value <= design.gamma
