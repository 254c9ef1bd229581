"""Probability of violation, sample sizes, quantiles, influence: closed forms, coverage, other software."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from robustlab import InputError, RealScalar, StateSpaceModel, Status, UncertainModel, elementwise
from robustlab.worst_case_analysis import (
    clopper_pearson,
    quantile_bounds,
    violation_probability,
)


def gains(*weights):
    """Static gain ``10 + sum w_k delta_k`` in V."""
    q = len(weights)
    d = np.zeros((q + 1, q + 1))
    d[:q, q], d[q, :q], d[q, q] = 1.0, weights, 10.0
    empty = (np.zeros((0, 0)), np.zeros((0, q + 1)), np.zeros((q + 1, 0)))
    m = StateSpaceModel(*empty, d, outputs=[*(f"z{k}" for k in range(q)), ("y", "V")])
    return UncertainModel(m, [RealScalar(f"p{k}") for k in range(q)])


PEAK = {"t": [0.0, 1.0]}


# --- bounds of a probability -----------------------------------------------------------------------------------------


def test_clopper_pearson_covers():
    n, p = 60, 0.07
    bounds = [clopper_pearson(k, n, 0.9) for k in range(n + 1)]
    share = sum(scipy.stats.binom.pmf(k, n, p) for k, (low, high) in enumerate(bounds) if low <= p <= high)
    assert 0.9 <= share < 0.97


def test_published_sample_sizes():
    """Wilks (1941): 59 samples for 95 / 95; Tempo, Bai, Dabbene (1997): log(1/b) / log(1/(1-p))."""
    for p, confidence, n in ((0.05, 0.95, 59), (0.01, 0.99, 459), (0.005, 0.995, 1058)):
        found = violation_probability(gains(1.0), "peak", 20.0, probability=p, confidence=confidence, **PEAK)
        assert (found.samples_needed, found.n, found.shown) == (n, n, True)
        assert scipy.stats.binom.cdf(0, n, p) <= 1 - confidence < scipy.stats.binom.cdf(0, n - 1, p)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_quantile_bounds_cover_for_any_distribution(share):
    rng = np.random.default_rng(0)
    truth = scipy.stats.lognorm.ppf(share, 1.0)
    found = [quantile_bounds(rng.lognormal(size=200), share, 0.9) for _ in range(400)]
    hit = np.mean([q.lower <= truth <= q.upper for q in found])
    assert hit > 0.9 - 3 * np.sqrt(0.09 / 400)
    assert hit < 0.98


# --- probability of violation ----------------------------------------------------------------------------------------


def test_probability_of_a_known_distribution():
    """|10 + d1 + d2| > 11.5: the corner triangle of the square, (0.5^2 / 2) / 4 = 1/32."""
    found = violation_probability(gains(1.0, 1.0), "peak", "11.5 V", n=4000, seed=2, **PEAK)
    assert found.lower < 1 / 32 < found.upper
    assert found.at_most < found.upper
    assert found.violations == (found.values > 11.5).sum()
    assert found.worst_value == found.values.max() == pytest.approx(10 + sum(found.worst_delta.values()))
    assert (found.status, found.unit, found.shown) == (Status.CONVERGED, "V", None)
    median = next(q for q in found.quantiles if q.share == 0.5)
    assert median.lower < 10 < median.upper


def test_a_limit_is_converted():
    assert violation_probability(gains(1.0), "peak", "10500 mV", n=40, **PEAK).limit == pytest.approx(10.5)


def test_a_required_probability_is_not_confirmed():
    found = violation_probability(gains(1.0), "peak", "10.8 V", probability=0.05, **PEAK)
    assert found.violations > 0
    assert found.shown is False


def test_a_measure_whose_smallest_value_is_the_worst():
    b, c, d = [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    lag = elementwise(*(StateSpaceModel([[0.0, 1.0], [-1.0, -2 * z]], b, c, d) for z in (0.3, 0.4)))
    found = violation_probability(lag, "damping", 0.25, n=2000)  # 0.3 + 0.1 delta < 0.25: a quarter of the range
    assert found.sense == -1
    assert found.lower < 0.25 < found.upper


def test_unstable_members_violate():
    lag = elementwise(*(StateSpaceModel([[-p]], [[1.0]], [[1.0]], [[0.0]]) for p in (1.0, 3.0)))
    found = violation_probability(lag, "hinf", 1e9, n=2000)
    assert found.unbounded == found.violations
    assert found.lower < 0.25 < found.upper
    assert found.influence is not None
    assert np.isinf(found.worst_value)


@pytest.mark.parametrize(
    ("limit", "options", "error", "text"),
    [
        ("11 rad", {}, InputError, "a number in V"),
        (float("nan"), {}, InputError, "finite"),
        ("inf V", {}, InputError, "a number in V"),
        ("much", {}, InputError, "a number in V"),
        ("", {}, InputError, "a number"),
        (None, {}, InputError, "a finite number"),
        (11.0, {"n": 0}, InputError, "whole number from 1"),
        (11.0, {"n": 2.5}, InputError, "whole number from 1"),
        (11.0, {"probability": 0.0}, InputError, "probability: 0.0"),
        (11.0, {"confidence": 1.0}, InputError, "confidence: 1.0"),
        (11.0, {"quantiles": (1.5,)}, InputError, "quantile: 1.5"),
        (11.0, {"seed": -1}, InputError, "seed"),
    ],
)
def test_invalid_input_is_rejected(limit, options, error, text):
    with pytest.raises(error) as caught:
        violation_probability(gains(1.0), "peak", limit, **{"n": 40, **PEAK, **options})
    assert text in str(caught.value)


# --- influence -------------------------------------------------------------------------------------------------------


def test_influence_of_a_sum():
    """Shares of the variance are w_k^2 / sum w^2; directions are the signs of the weights."""
    weights = np.array([3.0, -2.0, 1.0, 0.0])
    sampled = violation_probability(gains(*weights), "peak", "20 V", n=4000, **PEAK)
    found, delta = sampled.influence, sampled.worst_delta
    assert found is not None
    np.testing.assert_allclose(found.first_order, weights**2 / 14, atol=0.02)
    assert found.order[:3] == (0, 1, 2)
    assert list(found.directions) == [1, -1, 1, 0]
    assert list(found.matters) == [True, True, True, False]
    np.testing.assert_allclose(found.worst_value - found.restored, weights * list(delta.values()), atol=1e-12)
