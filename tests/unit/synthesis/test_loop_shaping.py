"""Normalised-coprime-factor loop shaping: gamma_min, sign of K, discrete time, weights, refusals."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from robustlab import (
    complementary_weight,
    control_weight,
    frequency_response,
    hinf,
    loop_functions,
    mixsyn,
    ncf,
    nu_gap,
    performance_weight,
)
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, feedback, lower_lft, series
from robustlab.uncertainty import four_block

# 200 / ((10 s + 1) (0.05 s + 1)^2) as a chain, and (s + 2) / s.
DISTURBED = StateSpaceModel(
    [[-0.1, 0, 0], [20, -20, 0], [0, 20, -20]], [[20.0], [0], [0]], [[0, 0, 1]], [[0]], inputs=["u"], outputs=["y"]
)
PI = StateSpaceModel([[0.0]], [[1.0]], [[2.0]], [[1.0]])


def random_plant(seed, n, p, m, dt=0.0, direct=0.0, unstable=True):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    if dt:
        A *= (1.3 if unstable else 0.9) / np.abs(np.linalg.eigvals(A)).max()
    else:
        A += (0.5 if unstable else -0.5) * np.eye(n) - np.linalg.eigvals(A).real.max() * np.eye(n)
    D = direct * rng.standard_normal((p, m))
    return StateSpaceModel(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt)


def test_skogestad_9_3():
    design = ncf(DISTURBED, PI)
    assert design.gamma_min == pytest.approx(2.33877, abs=1e-4)
    assert design.gamma <= 1.1 * design.gamma_min * 1.001
    assert design.status is Status.CERTIFIED
    assert design.margin.best == pytest.approx(0.42758, abs=1e-5)


@pytest.mark.parametrize("dt", [0.0, 0.05])
@pytest.mark.parametrize(
    ("n", "p", "m", "direct", "unstable"),
    [(1, 1, 1, 0.0, True), (4, 2, 2, 0.0, True), (5, 3, 2, 0.0, False), (5, 2, 3, 0.7, True), (8, 1, 2, 1.5, True)],
)
def test_random_plants_reach_the_requested_factor(dt, n, p, m, direct, unstable):
    for seed in range(2):
        G = random_plant(seed, n, p, m, dt, direct, unstable)
        for factor in (1.02, 1.5):
            design = ncf(G, factor=factor)
            assert design.status is Status.CERTIFIED
            assert design.K.dt == dt
            norm = hinf_norm(lower_lft(four_block(G), design.K))
            assert norm.upper <= factor * design.gamma_min * 1.001
            assert norm.lower >= design.gamma_min * (1 - 1e-6)
            assert design.gamma == pytest.approx(norm.upper, rel=1e-5)


def test_gamma_min_is_the_hinf_optimum_of_the_four_blocks():
    G = random_plant(2, 3, 2, 1)
    best = hinf(four_block(G), 2, 1, gamma_rel=1.0)
    assert ncf(G).gamma_min == pytest.approx(best.gamma, rel=2e-3)


@pytest.mark.parametrize("pole", [-0.9, -0.99999])
def test_a_pole_near_minus_one_of_a_discrete_plant(pole):
    G = StateSpaceModel([[pole, 0.3], [0.0, 0.5]], [[1.0], [1.0]], [[1.0, 0.2]], [[0.0]], 0.1)
    design = ncf(G)
    assert design.status is Status.CERTIFIED
    assert hinf_norm(lower_lft(four_block(G), design.K)).upper <= 1.1 * design.gamma_min * 1.001


def test_sign_positive_feedback_of_k_and_negative_feedback_of_minus_k():
    design = ncf(DISTURBED, PI)
    open_loop = series(design.K, DISTURBED)
    unit = StateSpaceModel([], [], [], [[1.0]])
    assert feedback(open_loop, unit, 1).is_stable()
    assert not feedback(open_loop, unit, -1).is_stable()
    # K_n = -K in u = K_n (r - y) tracks: integral action of W1 makes T(0) = 1.
    loop = loop_functions(design)
    np.testing.assert_allclose(loop.T.dc_gain(), [[1.0]], atol=1e-9)


def test_non_square_weights():
    G = random_plant(6, 4, 2, 3)
    design = ncf(G, np.eye(3)[:, :2], [[1.0, 0.5]])
    assert design.K_shaped.D.shape == (2, 1)
    assert design.K.D.shape == (3, 2)
    assert design.status is Status.CERTIFIED


def test_plants_nearer_in_the_nu_gap_than_the_margin_are_stabilised():
    G = random_plant(3, 3, 2, 2)
    design = ncf(G)
    rng = np.random.default_rng(0)
    tried = 0
    for scale in np.geomspace(0.005, 0.3, 12):
        other = StateSpaceModel(
            G.A + scale * rng.standard_normal(G.A.shape), G.B, G.C + scale * rng.standard_normal(G.C.shape), G.D
        )
        if nu_gap(G, other).upper < design.margin.lower:
            tried += 1
            assert lower_lft(four_block(other), design.K).is_stable()
    assert tried >= 3


def test_the_discrete_example_of_raoc_as_published_and_by_two_discrete_riccati_equations():
    """RobustAndOptimalControl.jl: 200/(0.025 s^3 + 1.0025 s^2 + 10.1 s + 1), W1 = (s + 2)/(s + 1e-6), zoh at 0.01 s."""
    from scipy.linalg import matrix_balance
    from scipy.signal import cont2discrete, tf2ss

    g = cont2discrete(tf2ss([200], [0.025, 1.0025, 10.1, 1]), 0.01)[:4]
    w = cont2discrete(tf2ss([1, 2], [1, 1e-6]), 0.01)[:4]
    design = ncf(StateSpaceModel(*g, 0.01), StateSpaceModel(*w, 0.01))
    assert design.status is Status.CERTIFIED
    assert round(design.gamma_min, 4) == 2.4086
    assert design.gamma <= 1.1 * design.gamma_min * 1.001
    # gamma_min = sqrt(1 + rho(X Z)) of g w, strictly proper, with X and Z of the normalised coprime factors.
    A = np.block([[w[0], np.zeros((1, 3))], [g[1] @ w[2], g[0]]])
    B, C = np.vstack([w[1], g[1] @ w[3]]), np.hstack([g[3] @ w[2], g[2]])
    _, (t, _) = matrix_balance(A, permute=False, separate=True)
    A, B, C = A / t[:, None] * t, B / t[:, None], C * t
    X = solve_discrete_are(A, B, C.T @ C, np.eye(1))
    Z = solve_discrete_are(A.T, C.T, B @ B.T, np.eye(1))
    assert design.gamma_min == pytest.approx(np.sqrt(1 + np.abs(np.linalg.eigvals(X @ Z)).max()), rel=1e-8)


# --- S, T, K S and S G by their definitions ---------------------------------------------------------------------------


OMEGA = np.geomspace(1e-3, 1e3, 60)


def random_model(rng, n, p, m, dt=0.0, direct=1.0):
    A = rng.standard_normal((n, n)) * 0.3
    return StateSpaceModel(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), direct * rng.standard_normal((p, m)), dt
    )


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_functions_equal_their_definitions(sign, dt):
    rng = np.random.default_rng(3)
    G, K = random_model(rng, 4, 2, 3, dt), random_model(rng, 2, 3, 2, dt, 0.2)
    loop = loop_functions(G, K, sign=sign)
    omega = OMEGA[OMEGA < 300]
    g, k = frequency_response(G, omega), frequency_response(K, omega)
    s = np.linalg.inv(np.eye(2) - sign * g @ k)
    for name, expected in (("S", s), ("T", -sign * g @ k @ s), ("KS", -sign * k @ s), ("SG", s @ g)):
        np.testing.assert_allclose(frequency_response(loop.model(name), omega), expected, atol=1e-9)
    np.testing.assert_allclose(loop.gain("SG", omega), np.linalg.norm(s @ g, 2, axis=(1, 2)), atol=1e-9)


def test_a_mixed_sensitivity_design_is_within_its_bounds():
    rng = np.random.default_rng(5)
    G = random_model(rng, 4, 2, 3)
    weights = performance_weight(1.0), control_weight(10.0, 50.0), complementary_weight(20.0)
    design = mixsyn(G, *weights)
    loop = loop_functions(design)
    assert loop.is_stable()
    assert loop.S.n_states == G.n_states + design.K.n_states  # without states of the weights
    g, k = frequency_response(G, OMEGA), frequency_response(design.K, OMEGA)
    s = np.linalg.inv(np.eye(2) + g @ k)
    np.testing.assert_allclose(frequency_response(loop.S, OMEGA), s, atol=1e-8)
    np.testing.assert_allclose(frequency_response(loop.KS, OMEGA), k @ s, atol=1e-8)
    for name in ("S", "KS", "T"):
        assert (loop.gain(name, OMEGA) <= loop.bound(name, OMEGA) * (1 + 1e-9)).all()
    assert loop.bound("SG", OMEGA) is None
    bound = loop.bound("S", [2.0])
    assert bound is not None
    assert bound[0] == pytest.approx(design.gamma / abs(frequency_response(weights[0], [2.0])[0, 0, 0]), rel=1e-12)
