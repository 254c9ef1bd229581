"""H-infinity synthesis against closed forms, at the edges, and its refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import Controller, RealScalar, UncertainModel, frequency_response, generalized_plant, h2, hinf, mixsyn
from robustlab.norms import bilinear_to_discrete, h2_norm, hinf_norm
from robustlab.result import Status
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


# --- lower bounds of gamma --------------------------------------------------------------------------------------------


SINGULAR = StateSpaceModel([[-1.0]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]])


def test_a_hidden_mode_next_to_a_multiple_pole_is_no_zero():
    """Four integrators in a row in any coordinates: only W1(inf) = 0.5 limits gamma."""
    rng = np.random.default_rng(1)
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


# --- generalised plants and their loops -------------------------------------------------------------------------------


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


# --- H2 synthesis -----------------------------------------------------------------------------------------------------


def regular_plant(seed=0, n=4, m1=3, m2=2, p1=3, p2=2, dt=0.0, D11=False, D22=False, unstable=True):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    size = np.abs(np.linalg.eigvals(A)).max()
    A = A / size * (1.2 if unstable else 0.8) if dt else A
    D = rng.standard_normal((p1 + p2, m1 + m2))
    D[:p1, :m1] *= bool(D11)
    D[p1:, m1:] *= 0.3 * bool(D22)
    return StateSpaceModel(A, rng.standard_normal((n, m1 + m2)), rng.standard_normal((p1 + p2, n)), D, dt)


def change_of_norm(P, K, step, rng):
    """Return the H2 norm of the loop with every entry of K changed at random (in continuous time all but D_K)."""
    moved = [m + step * rng.standard_normal(m.shape) for m in (K.A, K.B, K.C)]
    D = K.D + step * rng.standard_normal(K.D.shape) * K.is_discrete
    return h2_norm(lower_lft(P, StateSpaceModel(*moved, D, K.dt))).value


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("D22", [False, True])
def test_no_small_change_of_k_is_better(dt, D22):
    rng = np.random.default_rng(1)
    P = regular_plant(dt=dt, D11=bool(dt), D22=D22)
    design = h2(P, 2, 2)
    assert design.status is Status.CONVERGED
    assert design.regularisation == 0
    assert design.gamma == pytest.approx(h2_norm(lower_lft(P, design.K)).value, rel=1e-9)
    for _ in range(8):
        state = rng.bit_generator.state
        up = change_of_norm(P, design.K, 1e-4, rng)
        rng.bit_generator.state = state
        down = change_of_norm(P, design.K, -1e-4, rng)
        assert up >= design.gamma * (1 - 1e-12)
        assert down >= design.gamma * (1 - 1e-12)
        slope = abs(up - down) / 2e-4
        assert slope <= 1e-3 * (up + down - 2 * design.gamma) / 1e-8 * 1e-4 + 1e-5 * design.gamma


def test_textbook_scalar_by_hand():
    """x' = a x + w1 + u, z = (x, u), y = x + w2: X = Y = a + sqrt(1 + a^2), norm^2 = X + F^2 Y with F = -X."""
    a = 0.5
    P = StateSpaceModel([[a]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    x = a + np.sqrt(1 + a * a)
    design = h2(P, 1, 1)
    assert design.gamma == pytest.approx(np.sqrt(x + x**3), rel=1e-9)
    np.testing.assert_allclose(design.K.A, [[a - 2 * x]], rtol=1e-9)
    np.testing.assert_allclose(design.K.B @ design.K.C, [[-x * x]], rtol=1e-9)


def test_a_direct_term_that_k_can_cancel_is_cancelled():
    rng = np.random.default_rng(7)
    P = regular_plant(seed=7, m1=2, p1=2)  # D12 and D21 square
    D = np.array(P.D)
    D[:2, :2] = rng.standard_normal((2, 2))
    P = StateSpaceModel(P.A, P.B, P.C, D)
    design = h2(P, 2, 2)
    wanted = -np.linalg.solve(D[:2, 2:], D[:2, :2]) @ np.linalg.inv(D[2:, :2])
    np.testing.assert_allclose(design.K.D, wanted, rtol=1e-9)
    assert np.isfinite(design.gamma)
    assert not design.closed_loop.D.any()


def test_singular_plant_reports_its_regularisation():
    """Double integrator with neither control penalty nor measurement noise."""
    P = generalized_plant(
        StateSpaceModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0]], [[0, 0]], inputs=["w", "u"], outputs=["q"]),
        ["q"],
        ["u"],
    )
    lines: list[str] = []
    design = h2(P, progress=lines.append)
    assert design.status is Status.CONVERGED
    assert design.regularisation > 0
    assert design.smallest_norm <= design.gamma
    assert "regularisation" in dict(design.facts())
    assert lines[0].startswith("regularisation 1e-01: H2 norm")
    assert design.to_json()["regularisation"] == design.regularisation
