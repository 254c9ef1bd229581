"""H-infinity synthesis against closed forms, at the edges, and its refusals."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import Controller, hinf
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis import Synthesis


def output_feedback_problem(a: float, d22: float = 0.0) -> StateSpaceModel:
    """x' = a x + w1 + u, z = [x; u], y = x + w2 + d22 u; its smallest gamma is a + sqrt(a^2 + 2)."""
    return StateSpaceModel([[a]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, d22]])


def check(design: Synthesis, plant: StateSpaceModel) -> None:
    """Check that the loop rebuilt from K on the plant is stable, with a norm of at most gamma."""
    loop = lower_lft(plant, design.K)
    assert loop.is_stable()
    assert hinf_norm(loop).lower <= design.gamma
    assert design.status is Status.CERTIFIED
    assert design.closed_loop.is_stable()


@pytest.mark.parametrize("a", [-10.0, -0.1, 0.0, 20.0])
def test_one_state_output_feedback_closed_form(a):
    plant = output_feedback_problem(a)
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    check(design, plant)
    gamma = a + np.sqrt(a * a + 2)
    assert gamma * (1 - 1e-9) <= design.gamma <= 1.001 * gamma


@pytest.mark.parametrize("a", [-3.0, -0.2, 2.0])
def test_singular_state_feedback_closed_form(a):
    """x' = a x + w + u, z = [x; u], y = x (D21 = 0): gamma is 1 / sqrt(1 + a^2) for a <= 0, else 1."""
    plant = StateSpaceModel([[a]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]])
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    check(design, plant)
    gamma = 1 / np.sqrt(1 + a * a) if a <= 0 else 1.0
    assert gamma * (1 - 1e-9) <= design.gamma <= 1.002 * gamma


@pytest.mark.parametrize(("time", "u", "y"), [(1e-6, 1e-4, 1e5), (1e6, 1e-12, 1e12)])
def test_units_of_time_controls_and_measurements_do_not_matter(time, u, y):
    base = output_feedback_problem(-1.0)
    scale_in, scale_out = np.array([1, 1, u]), np.array([1, 1, y])
    plant = StateSpaceModel(
        base.A * time, base.B * scale_in * time, base.C * scale_out[:, None], base.D * scale_out[:, None] * scale_in
    )
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    check(design, plant)
    assert design.gamma == pytest.approx(np.sqrt(3) - 1, rel=1e-3)


def test_static_plant_meets_parrotts_bound():
    """Without states: min over K of || [a, b; c, K] || is max(||[a b]||, ||[a; c]||)."""
    a, b, c = 0.6, 0.5, 0.7
    empty = np.zeros((0, 0))
    D = np.array([[a, b, 0], [c, 0, 1.0], [0, 1.0, 0]])
    plant = StateSpaceModel(empty, np.zeros((0, 3)), np.zeros((3, 0)), D)
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    check(design, plant)
    assert design.gamma == pytest.approx(max(np.hypot(a, b), np.hypot(a, c)), rel=1e-3)


@pytest.mark.parametrize("d22", [3.0, 1e8, -1.0])
def test_direct_term_from_controls_to_measurements_does_not_change_gamma(d22):
    plant = output_feedback_problem(0.5, d22)
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    check(design, plant)
    assert design.gamma == pytest.approx(0.5 + 1.5, rel=1e-3)
    assert np.linalg.cond(np.eye(1) - design.K.D * d22) < 1e12


def test_broken_assumptions_are_named_with_their_meaning():
    """No direct penalty on the valve, no noise on the level, and an undamped oscillation that z does not show."""
    plant = StateSpaceModel(
        [[0.0, 2.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, -1.0]], [[1.0, 1.0], [0.0, 1.0], [1.0, 1.0]],
        [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], np.zeros((2, 2)),
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


@pytest.mark.parametrize("dt", [1e-3, 0.5])
def test_discrete_plant_is_solved_and_verified_in_discrete_time(dt):
    plant = bilinear_to_discrete(output_feedback_problem(0.5), dt)
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    assert design.K.dt == dt
    check(design, plant)
    assert design.gamma == pytest.approx(2.0, rel=1e-3)


def test_controller_has_names_units_and_evidence():
    base = output_feedback_problem(-1.0)
    plant = StateSpaceModel(
        base.A, base.B, base.C, base.D, inputs=["w", "n", ("u", "V")], outputs=["z", "zu", ("y", "rad")]
    )
    design = hinf(plant, 1, 1)
    assert design.K.inputs[0] == ("y", "rad")
    assert design.K.outputs[0] == ("u", "V")
    stored = design.controller
    assert isinstance(stored, Controller)
    assert (stored.gamma, stored.status, stored.method) == (design.gamma, Status.CERTIFIED, "hinf")
    assert set(design.to_json()) >= {"gamma", "status", "K", "peak_frequency", "reason", "norm"}
    assert "z" in design.limit
