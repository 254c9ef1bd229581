"""Residual tests: formulas recomputed by hand, rejection rates on noise of known colour, known effect sizes."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from robustlab.dynamics import plant, simulate
from robustlab.identification.comparison import compare, input_correlation, whiteness
from robustlab.record import Record


def _ar1(seed, n, a):
    noise = np.random.default_rng(seed).standard_normal(n + 200)
    return lfilter([1.0], [1.0, -a], noise)[200:]


def test_ljung_box_follows_its_formula():
    e = _ar1(3, 300, 0.2)
    n = len(e)
    r = [sum(e[t] * e[t + k] for t in range(n - k)) / sum(e**2) for k in range(1, 8)]
    q = n * (n + 2) * sum(r_k**2 / (n - k) for k, r_k in enumerate(r, start=1))
    found = whiteness(e, 7)
    assert found.statistic == pytest.approx(q, rel=1e-12)
    assert found.dof == 7
    assert found.p_value == pytest.approx(chi2.sf(q, 7), rel=1e-12)
    assert found.band == pytest.approx(2.5758 / np.sqrt(n), rel=1e-4)
    np.testing.assert_allclose(found.correlation[1:], r, rtol=1e-12)


def test_rejection_rate_on_white_noise_is_the_level():
    rejected = sum(whiteness(np.random.default_rng(s).standard_normal(400), 20).p_value < 0.05 for s in range(400))
    assert 8 <= rejected <= 34  # binomial(400, 0.05): within these with 99.8 %


def test_coloured_noise_is_always_rejected_and_its_predictable_share_is_known():
    found = [whiteness(_ar1(s, 4000, 0.6), 20) for s in range(20)]
    assert all(test.p_value < 1e-6 for test in found)
    # An AR(1) process with pole a is predictable to the share a^2.
    assert np.mean([test.explained_share for test in found]) == pytest.approx(0.36, abs=0.02)


@pytest.mark.parametrize("kind", ["white", "steps"])
def test_rejection_rate_of_an_independent_input_is_the_level(kind):
    rejected = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(400) if kind == "white" else np.repeat(rng.standard_normal(20), 20)
        rejected += input_correlation(u, rng.standard_normal(400), 10).p_value < 0.05
    assert 8 <= rejected <= 36


def test_band_holds_for_coloured_signals():
    # An independent AR(1) residual and input: about 99 % of the correlations must be within the corrected band.
    inside = []
    for seed in range(150):
        test = input_correlation(_ar1(2 * seed, 3000, 0.9), _ar1(2 * seed + 1, 3000, 0.9), 60)
        assert test.band > 2.0 * 2.5758 / np.sqrt(3000)  # a white-noise band would be far too narrow
        inside.append(np.abs(test.correlation[test.lags == 0]) <= test.band)
    assert np.mean(inside) >= 0.96


def test_a_left_out_input_path_is_found_with_its_share_and_its_lag():
    rng = np.random.default_rng(5)
    u, noise = rng.standard_normal(20_000), rng.standard_normal(20_000)
    e = noise + 0.5 * np.concatenate([np.zeros(3), u[:-3]])
    test = input_correlation(u, e, 10)
    assert test.p_value < 1e-6
    assert test.explained_share == pytest.approx(0.25 / 1.25, abs=0.02)
    assert test.lags[np.abs(test.correlation).argmax()] == 3
    assert np.abs(test.correlation[test.lags < 0]).max() < 1.5 * test.band


def test_feedback_shows_at_negative_lags():
    rng = np.random.default_rng(6)
    e = rng.standard_normal(5000)
    u = -np.concatenate([np.zeros(2), e[:-2]]) + 0.1 * rng.standard_normal(5000)
    test = input_correlation(u, e, 10)
    assert test.lags[np.abs(test.correlation).argmax()] == -2


# --- the residual that is tested --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_perfect_model_with_noise_is_rejected_at_the_level_only():
    # Two outputs of very unequal noise in windows of 50 samples.
    axis, t = plant("servo-axis"), 0.01 * np.arange(600)
    rejected = {"q": 0, "v": 0, "u": 0}
    for seed in range(80):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(30), 20)
        y = simulate(axis, t, u, [0.1, -0.2])
        q, v = y["q"] + 1e-3 * rng.standard_normal(600), y["v"] + 1e-2 * rng.standard_normal(600)
        record = Record(t, {"u": u}, {"q": q, "v": v}, {"u": "V", "q": "m", "v": "m/s"})
        tests = compare(axis, record, window=0.5).residual
        for name in "qv":
            rejected[name] += tests[name].whiteness.p_value < 0.05
        rejected["u"] += tests["q"].inputs["u"].p_value < 0.05
    assert all(count <= 12 for count in rejected.values()), rejected  # binomial(80, 0.05): 12 or less with 99.9 %
