"""H-infinity synthesis against closed forms, at the edges, and its refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import Controller, RealScalar, UncertainModel, frequency_response, generalized_plant, hinf, mixsyn
from robustlab.errors import InputError
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.result import Status, plain
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis import GeneralizedPlant, Synthesis, gamma_bound


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


# --- evidence of an h-infinity design: lower bounds, estimates, bandwidth ---------------------------------------------


SINGULAR = StateSpaceModel([[-1.0]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]])


# --- lower bounds ---


@pytest.mark.parametrize("seed", range(2))
def test_a_hidden_mode_next_to_a_multiple_pole_is_no_zero(seed):
    """Four integrators in a row in any coordinates: only W1(inf) = 0.5 limits gamma."""
    rng = np.random.default_rng(seed)
    T = rng.normal(size=(4, 4))
    A = T @ np.diag(np.ones(3), 1) @ np.linalg.inv(T)
    G = StateSpaceModel(A, rng.normal(size=(4, 2)), rng.normal(size=(1, 4)), np.zeros((1, 2)))
    design = mixsyn(G, StateSpaceModel([[-1e-7]], [[1.0]], [[5e-5]], [[0.5]]), 0.3)
    assert design.lower_bound.value == pytest.approx(0.5, rel=1e-6)
    assert 0.5 < design.gamma < 0.55


def test_a_right_half_plane_zero_bounds_gamma_by_the_weight_there():
    """S(z) = 1 at a zero z of the plant, so ||W1 S|| >= |W1(z)|; with a small penalty on u it is attained."""
    zero = 2.0
    G = StateSpaceModel([[-1.0]], [[1.0]], [[-1.0 - zero]], [[1.0]])  # (s - 2) / (s + 1)
    W1 = StateSpaceModel([[-0.1]], [[1.0]], [[3.0]], [[0.0]])
    design = mixsyn(G, W1, gamma_rel=1.0)
    exact = 3.0 / (zero + 0.1)
    assert design.gamma_lower == pytest.approx(exact, rel=1e-5)
    assert design.gamma_lower <= exact
    assert exact * (1 - 1e-9) <= design.gamma <= 1.001 * exact
    assert "right half plane" in design.lower_bound.known
    assert "proved at the zero s = 2 rad/s" in design.lower_bound.known


def test_lower_bound_equals_gamma_if_one_frequency_decides():
    design = hinf(SINGULAR, 1, 1, gamma_rel=1.0)
    exact = 1 / np.sqrt(2)
    assert design.gamma_lower <= exact * (1 + 1e-12)
    assert design.gamma_lower == pytest.approx(exact, rel=1e-4)
    assert "0 rad/s: no controller, causal or not" in design.lower_bound.known


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_no_stable_loop_is_below_the_bound(seed):
    """No stabilising controller, here K = 0 or a small random K of a stable plant, violates it."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    A = rng.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    D = rng.standard_normal((3, 3)) * rng.integers(0, 2, (3, 3))
    D[2, 2] = 0.0
    plant = StateSpaceModel(A, rng.standard_normal((n, 3)), rng.standard_normal((3, n)), D)
    found = gamma_bound(GeneralizedPlant(plant, 1, 1)).value
    for size in (0.0, 0.1, 1.0):
        k = rng.standard_normal(4) * size
        K = StateSpaceModel([[-1.0 - abs(k[0])]], [[k[1]]], [[k[2]]], [[k[3]]])
        norm = hinf_norm(GeneralizedPlant(plant, 1, 1).close(K))
        assert found <= norm.upper * (1 + 1e-9)


def test_the_evidence_is_in_the_file():
    data = json.loads(json.dumps(plain(hinf(SINGULAR, 1, 1).to_json())))
    assert {"gamma_lower", "lower_bound", "assumptions"} <= data.keys()
    assert data["lower_bound"]["proved"] is True


# --- generalised plants from models and uncertain models, scaling, and their loops ------------------------------------


def uncertain_model() -> UncertainModel:
    M = StateSpaceModel(
        [[-1.0, 0.2], [0.0, -2.0]],
        [[0.1, 1.0, 0.0], [0.0, 0.5, 1.0]],
        [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        np.zeros((3, 3)),
        inputs=["w1", "force", "u"],
        outputs=["z1", "q", "v"],
    )
    return UncertainModel(M, [RealScalar("k")])


def test_thesis_ordering_delta_then_performance_then_measurement():
    plant = generalized_plant(uncertain_model(), measurements=["v"], controls=["u"])
    assert plant.model.input_names == ("w1", "force", "u")
    assert plant.model.output_names == ("z1", "q", "v", "v measured")
    assert (plant.n_meas, plant.n_con, len(plant.blocks)) == (1, 1, 1)
    m = plant.model
    assert m.C[2].tolist() == m.C[3].tolist()
    narrow = generalized_plant(uncertain_model(), ["v"], ["u"], disturbances=["force"], performance=["q"])
    assert narrow.model.output_names == ("z1", "q", "v")


def test_closing_the_generalised_plant_is_closing_the_uncertain_model():
    uncertain = uncertain_model()
    plant = generalized_plant(uncertain, ["v"], ["u"])
    K = StateSpaceModel([[-3.0]], [[1.0]], [[0.5]], [[-0.1]])
    loop = UncertainModel(plant.close(K), uncertain.blocks).evaluate({"k": 0.7})
    direct = lower_lft(
        generalized_plant(uncertain.evaluate({"k": 0.7}), ["v"], ["u"]).model,
        K,
    )
    omega = np.geomspace(1e-2, 1e2, 20)
    np.testing.assert_allclose(frequency_response(loop, omega), frequency_response(direct, omega), atol=1e-12)


@pytest.mark.parametrize(("n_w", "n_z", "missing"), [(0, 0, "w and no performance"), (0, 1, "w"), (1, 0, "output z")])
@pytest.mark.parametrize("design", ["hinf", "h2", "fixed", "fixed of two", "sampled norm"])
def test_a_plant_without_performance_channels_is_refused(design, n_w, n_z, missing):
    """Every norm of its loop is zero."""
    P = StateSpaceModel(
        np.diag([1.0, -2.0]), np.ones((2, n_w + 1)), np.ones((n_z + 1, 2)), np.zeros((n_z + 1, n_w + 1))
    )
    calls = {
        "hinf": lambda: rl.hinf(P, 1, 1),
        "h2": lambda: rl.h2(P, 1, 1),
        "fixed": lambda: rl.fixed_structure(P, 1, n_meas=1, n_con=1),
        "fixed of two": lambda: rl.fixed_structure([P, P], 1, n_meas=1, n_con=1),
        "sampled norm": lambda: rl.sampled_data_norm(P, StateSpaceModel([], [], [], [[-5.0]], 0.01)),
    }
    with pytest.raises(InputError, match=f"no .*{missing}.* beside 1 controls and 1 measurements"):
        calls[design]()
