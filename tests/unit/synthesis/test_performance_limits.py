"""Performance limits against optimal designs, numeric integrals of actual loops, and formulas of the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from lqg import lqg

from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.invariant_zeros import transmission_zeros
from robustlab.statespace import StateSpaceModel, series
from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn
from robustlab.synthesis.problem.performance_limits import performance_limits
from robustlab.synthesis.specifications.loop_functions import loop_functions
from robustlab.synthesis.specifications.weight_design import performance_weight

# (s - 3) / ((s - 1)(s + 5)) up to a gain: zero at 3, pole at 1.
ZERO_AND_POLE = StateSpaceModel([[1.0, 0.0], [1.0, -5.0]], [[1.0], [0.0]], [[-1.0, 8.0]], [[0.0]])


def random_plant(seed, dt=0.0, n=4, p=2, m=2):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A = A / 1.3 if dt else A + 0.3 * np.eye(n)
    return StateSpaceModel(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)), dt)


def test_siso_zero_and_pole_by_hand():
    limits = performance_limits(ZERO_AND_POLE)
    assert [z.value for z in limits.zeros] == [pytest.approx(3.0)]
    assert [p.value for p in limits.poles] == [pytest.approx(1.0)]
    assert limits.sensitivity_peak == pytest.approx((3 + 1) / (3 - 1))
    assert limits.complementary_peak == pytest.approx(2.0)
    assert limits.sensitivity_integral == pytest.approx(np.pi)
    assert (limits.bandwidth_above, limits.bandwidth_below) == pytest.approx((2.0, 1.5))
    text = " ".join(limits.sentences())
    assert "1 zero in the right half plane: 3" in text
    assert "no room" in text


@pytest.mark.parametrize(("seed", "dt"), [(1, 0.0), (0, 0.2)])
def test_peaks_are_what_optimal_designs_reach(seed, dt):
    """H-infinity designs of S, T and K S alone; the discrete plants' delay of a sample is a zero at infinity."""
    G = random_plant(seed, dt)
    limits = performance_limits(G)
    assert limits.zeros or dt
    assert limits.poles
    for weights, wanted in (
        ((1.0, None, None), limits.sensitivity_peak),
        ((None, None, 1.0), limits.complementary_peak),
        ((None, 1.0, None), limits.control_peak),
    ):
        gamma = mixsyn(G, *weights, gamma_rel=1.0).gamma
        assert wanted * (1 - 1e-6) <= gamma <= wanted * 1.002


def test_a_repeated_zero_counts_twice():
    """(s - 2)^2 / ((s - 1)(s + 3)(s + 4)): the product formula with the zero twice."""
    A = np.diag([1.0, -3.0, -4.0])
    C = [[1 / 20, -25 / 4, 36 / 5]]  # residues of the partial fractions with B = 1: sum 1
    G = StateSpaceModel(A, np.ones((3, 1)), C, [[0.0]])
    np.testing.assert_allclose(transmission_zeros(G), [2, 2], atol=1e-6)
    assert performance_limits(G).sensitivity_peak == pytest.approx(3.0**2, rel=1e-6)


def test_discrete_delay_and_unstable_pole():
    """0.3 / (z - 1.5) with k samples more of delay: the peak of T is 1.5^(k + 1)."""
    for k in (0, 1, 3):
        A, B, C = np.diag(np.ones(k), -1), np.zeros((k + 1, 1)), np.zeros((1, k + 1))
        A[0, 0], B[0, 0], C[0, -1] = 1.5, 0.3, 1.0
        limits = performance_limits(StateSpaceModel(A, B, C, [[0.0]], 0.1))
        assert limits.complementary_peak == pytest.approx(1.5 ** (k + 1), rel=1e-6)
        assert limits.zeros == ()


def numeric(f, dt=0.0):
    """Integral over all frequencies of an even integrand, after omega = tan or up to the Nyquist frequency."""
    panel, share = np.polynomial.legendre.leggauss(20)
    panels = 60  # of 20 Gauss points each, over -1..1
    nodes = (-1 + (2 * np.arange(panels)[:, None] + panel + 1) / panels).ravel()
    weights = np.tile(share / panels, panels)
    if dt:
        omega = np.pi / dt * (nodes + 1) / 2
        return float((weights * f(omega)).sum() * np.pi / dt / 2)
    # The tail falls like omega^-2: a few scales in one substitution omega = tan^3.
    t = np.pi / 4 * (nodes + 1)
    omega = np.tan(t) ** 3
    return float((weights * f(omega) * 3 * np.tan(t) ** 2 / np.cos(t) ** 2).sum() * np.pi / 4)


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_bode_integral_of_an_actual_loop(dt):
    """LQG loops: plant and controller strictly proper (discrete: the measurement is one sample late)."""
    for seed in (0, 1):
        G = random_plant(seed, dt)
        delayed = series(G, StateSpaceModel(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)), dt)) if dt else G
        n = delayed.n_states
        K = lqg(delayed, np.eye(n), np.eye(2), np.eye(n), np.eye(2)).K
        S = loop_functions(delayed, K, sign=1).S
        found = numeric(lambda w, S=S: np.log(np.abs(np.linalg.det(frequency_response(S, w)))), dt)
        poles = K.poles()
        own = np.pi / dt * np.log(np.maximum(np.abs(poles), 1)).sum() if dt else np.pi * np.maximum(poles.real, 0).sum()
        wanted = performance_limits(delayed).sensitivity_integral + own
        assert found == pytest.approx(wanted, rel=1e-3, abs=1e-3)


def test_poisson_integral_of_an_actual_loop():
    K = lqg(ZERO_AND_POLE, np.eye(2), [[0.1]], np.eye(2), [[0.1]]).K
    S = loop_functions(ZERO_AND_POLE, K, sign=1).S
    limits = performance_limits(ZERO_AND_POLE)
    zero = limits.zeros[0].value
    found = numeric(lambda w: np.log(np.abs(frequency_response(S, w)[:, 0, 0])) * limits.poisson_weight(zero, w))
    own = [abs((p + zero) / (np.conj(p) - zero)) for p in K.poles() if p.real > 0]
    assert found == pytest.approx(limits.poisson_integral(zero) + np.pi * np.log(own).sum(), rel=1e-3)
    assert limits.poisson_integral(zero) == pytest.approx(np.pi * np.log(2))


def test_gamma_of_a_weighted_design_obeys_and_nears_its_bound():
    W1 = performance_weight(1.0, error=0.01)
    bound = performance_limits(ZERO_AND_POLE).gamma_bounds(W1, W1)
    by_hand = (3 / 2 + 1) / (3 + 0.01) * 2  # |W1(3)| (3 + 1) / (3 - 1)
    of_zero = next(b for b in bound if b.weight == "W1")
    assert of_zero.gamma == pytest.approx(by_hand)
    assert "zero at 3" in of_zero.text
    design = mixsyn(ZERO_AND_POLE, W1, gamma_rel=1.0)
    assert of_zero.gamma <= design.gamma <= 1.005 * of_zero.gamma
    of_pole = next(b for b in bound if b.weight == "W3")
    assert of_pole.gamma <= mixsyn(ZERO_AND_POLE, None, None, W1, gamma_rel=1.0).gamma <= 1.005 * of_pole.gamma


def test_delay_and_unstable_pole():
    lag = StateSpaceModel([[2.0]], [[1.0]], [[1.0]], [[0.0]])
    limits = performance_limits(lag, delay=0.1)
    assert limits.complementary_peak == pytest.approx(np.exp(0.2))
    assert limits.bandwidth_below == pytest.approx(10.0)
    assert any("Delay of 0.1 s" in line for line in limits.sentences())


def test_a_well_behaved_plant_has_no_limit():
    limits = performance_limits(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert (limits.sensitivity_peak, limits.complementary_peak, limits.control_peak) == (1.0, 1.0, 0.0)
    assert limits.bandwidth_below == np.inf
    assert limits.sentences()[0].startswith("No zero and no pole")
    assert performance_limits(StateSpaceModel([], [], [], [[2.0]])).sensitivity_peak == 1.0


def test_zeros_of_square_wide_and_tall_plants():
    for p, m in ((2, 2), (2, 3), (3, 2)):
        G = random_plant(7, p=p, m=m)
        for s in transmission_zeros(G):
            pencil = np.block([[G.A - s * np.eye(4), G.B], [G.C, G.D]])
            assert np.linalg.svd(pencil, compute_uv=False)[-1] < 1e-8
        assert (len(transmission_zeros(G)) > 0) == (p == m)
    # A wide plant with a common factor (s - 2) / (s + 2) keeps that zero.
    factor = StateSpaceModel([[-2.0]], [[1.0]], [[-4.0]], [[1.0]])
    wide = series(StateSpaceModel([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]]), factor)
    np.testing.assert_allclose(transmission_zeros(wide), [2.0], atol=1e-8)
    assert performance_limits(wide).zeros[0].value == pytest.approx(2.0)


def test_directions_of_zeros_and_poles():
    G = random_plant(0)
    limits = performance_limits(G)
    for zero in limits.zeros:
        value = G.C @ np.linalg.solve(zero.value * np.eye(4) - G.A, G.B)
        np.testing.assert_allclose(zero.output.conj() @ value, 0, atol=1e-9)
        np.testing.assert_allclose(value @ zero.input, 0, atol=1e-9)


def test_json_and_refusals():
    limits = performance_limits(ZERO_AND_POLE)
    assert limits.to_json()["zeros"][0]["value"] == pytest.approx(3.0)
    with pytest.raises(InputError, match="delay"):
        performance_limits(ZERO_AND_POLE, delay=-1.0)
    with pytest.raises(InputError, match="2 x 2"):
        performance_limits(random_plant(0), delay=0.1)
    with pytest.raises(InputError, match="outputs"):
        performance_limits(StateSpaceModel([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    with pytest.raises(InputError, match="discrete"):
        performance_limits(random_plant(0, 0.1)).poisson_integral(1.0)


@pytest.mark.parametrize("S", [1.0, 1e5])
def test_all_zeros_of_a_chain_with_large_gains(S):
    """(t - 1)(t - 2)(t - 3)/t^4 with t = (s + a)/S; with large S one zero was found, at 6/11."""
    A = -1e-3 * np.eye(4) + S * np.eye(4, k=1)
    limits = performance_limits(StateSpaceModel(A, np.eye(4)[:, 3:], [[-6.0, 11.0, -6.0, 1.0]], [[0.0]]))
    np.testing.assert_allclose([z.value for z in limits.zeros], np.array([1, 2, 3]) * S - 1e-3, rtol=1e-13)
    assert limits.status == "converged"


def test_a_far_zero_hides_no_near_one():
    """-1e-12 + (s - 1)/((s + 1)(s + 2)): one zero next to 1, one at 1e12."""
    limits = performance_limits(StateSpaceModel([[0, 1], [-2, -3]], [[0], [1]], [[-1.0, 1.0]], [[-1e-12]]))
    np.testing.assert_allclose([z.value for z in limits.zeros], [1.0, 1e12], rtol=1e-10)
    assert limits.bandwidth_below == pytest.approx(0.5)


def test_limits_of_zeros_that_are_not_solved_exactly_are_inaccurate(monkeypatch):
    monkeypatch.setattr("robustlab.linear_analysis.invariant_zeros.MOST_STATES", 1)
    limits = performance_limits(ZERO_AND_POLE)
    assert limits.status == "inaccurate"
    assert "Not to be trusted: 2 states: more than 1" in limits.summary()
