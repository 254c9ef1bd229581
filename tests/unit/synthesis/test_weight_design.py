"""Weights from specifications and from noise, and contradictions among them, against designs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn
from robustlab.synthesis.specifications.weight_design import (
    check_weights,
    design_weights,
    makeweight,
    noise_weight,
    performance_weight,
)

LAG = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def gain(model, omega):
    return float(np.abs(frequency_response(model, [omega])[0, 0, 0]))


def test_specifications_become_the_three_weights():
    weights = design_weights(bandwidth=2.0, error=0.01, peak=1.8, control_limit=50.0, noise_from=30.0, plant=LAG)
    assert weights.conflicts == ()
    assert weights.W1 is not None
    assert weights.W2 is not None
    assert weights.W3 is not None
    assert gain(weights.W1, 0.0) == pytest.approx(100.0)
    assert gain(weights.W2, 1.0) == pytest.approx(0.02)
    assert gain(weights.W3, 0.0) == pytest.approx(1 / 1.8)
    design = mixsyn(LAG, weights.W1, weights.W2, weights.W3)
    assert design.gamma < 1.1
    assert design_weights(bandwidth=2.0).W3 is None


def test_s_plus_t_conflict_is_named_at_its_frequency_and_bounds_every_design():
    weights = design_weights(bandwidth=10.0, noise_from=2.0)
    conflict = weights.conflicts[0]
    assert 2 < conflict.frequency < 10
    # By hand: a b / sqrt(a^2 + b^2) at that frequency.
    assert weights.W1 is not None
    assert weights.W3 is not None
    a, b = gain(weights.W1, conflict.frequency), gain(weights.W3, conflict.frequency)
    assert conflict.gamma == pytest.approx(a * b / np.hypot(a, b))
    assert "S + T = 1" in conflict.text
    design = mixsyn(LAG, weights.W1, 1e-3, weights.W3, gamma_rel=1.0)
    assert design.gamma >= conflict.gamma


def test_too_little_control_is_named():
    weights = design_weights(bandwidth=10.0, control_limit=0.5, plant=LAG)
    assert "allow more control" in weights.summary()
    design = mixsyn(LAG, weights.W1, weights.W2, gamma_rel=1.0)
    assert design.gamma >= weights.conflicts[0].gamma
    assert check_weights(weights.W1, weights.W2) == []  # nothing to compare without the plant


def test_right_half_plane_zeros_and_poles_bound_the_weights():
    zero_at_one = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])
    W1 = performance_weight(5.0)
    found = check_weights(W1, plant=zero_at_one)
    assert found[0].gamma == pytest.approx(gain_at(W1, 1.0))
    assert np.isnan(found[0].frequency)
    assert mixsyn(zero_at_one, W1, 1e-4, gamma_rel=1.0).gamma >= found[0].gamma
    unstable = StateSpaceModel([[8.0]], [[1.0]], [[1.0]], [[0.0]])
    W3 = design_weights(noise_from=2.0).W3
    found = check_weights(None, None, W3, plant=unstable)
    assert found[0].gamma == pytest.approx(gain_at(W3, 8.0))
    assert "pole" in found[0].text
    assert found[0].to_json()["gamma"] == found[0].gamma


def gain_at(model, s):
    value = model.C @ np.linalg.solve(s * np.eye(model.n_states) - model.A, model.B) + model.D
    return abs(float(value[0, 0]))


def test_weights_on_several_channels():
    G = StateSpaceModel(np.diag([-1.0, -2.0]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    assert check_weights(performance_weight(10.0), None, design_weights(noise_from=2.0).W3, plant=G)[0].gamma > 1.6


@pytest.mark.parametrize("order", [1, 2, 4])
def test_makeweight_goes_through_its_point(order):
    for low, high in ((100.0, 0.1), (0.02, 5.0)):
        W = makeweight(low, (3.0, 1.0), high, order=order)
        assert W.n_states == order
        assert W.is_stable()
        assert gain(W, 0.0) == pytest.approx(low)
        assert gain(W, 3.0) == pytest.approx(1.0)
        assert gain(W, np.inf) == pytest.approx(high)
        inverse = StateSpaceModel(W.A - W.B @ np.linalg.solve(W.D, W.C), W.B, W.C, W.D)
        assert inverse.is_stable()  # minimum phase


@pytest.mark.parametrize(
    ("arguments", "dt", "gains"),
    [
        ((100, 1, 0.5), 0.0, (100.0, 1.0, 0.5)),
        ((100, [1, 3], 0.5), 0.0, (100.0, 3.0, 0.5)),
        ((0.2, 2, 30, 0, 3), 0.0, (0.2, 1.0, 30.0)),
        ((100, 1, 0.5, 0.1), 0.1, (100.0, 1.0, 0.5)),
        ((100, (5, 2), 0.5, 0.1, 3), 0.1, (100.0, 2.0, 0.5)),
    ],
)
def test_makeweight_as_in_matlab(arguments, dt, gains):
    """Gains at zero frequency, at the given one, and at infinity or the Nyquist frequency."""
    W = makeweight(*arguments)
    assert W.dt == dt
    frequency = np.ravel(arguments[1])[0]
    z = (1, np.exp(1j * frequency * dt), -1) if dt else (0, 1j * frequency, 1e12)
    assert [abs(complex(W(s)[0, 0])) for s in z] == pytest.approx(gains, rel=1e-9)


def test_noise_weight_finds_the_filter_that_coloured_the_noise():
    rng = np.random.default_rng(2)
    dt = 0.01
    white = rng.standard_normal(60000)
    coloured = 0.3 * lfilter([1.0], [1.0, -0.9], white) + 2.0  # a lag with a corner at 10 rad/s, and an offset
    fit = noise_weight(coloured, dt)
    assert 1 <= fit.order <= 4
    assert fit.lowest >= 0
    for omega in (1.0, 5.0, 20.0, 100.0):
        true = 0.3 / abs(1 - 0.9 * np.exp(-1j * omega * dt)) * np.sqrt(dt)
        assert 0.85 * true < gain(fit.weight, omega) < 1.6 * true


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (design_weights, "nothing specified"),
        (lambda: design_weights(bandwidth=-1.0), "bandwidth"),
        (lambda: check_weights(StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]])), "stable weight"),
        (lambda: makeweight(1.0, (1.0, 2.0), 0.1), "between"),
        (lambda: makeweight(1.0, (2.0, 0.5, 0.2), 0.1), "through"),
        (lambda: makeweight(-1.0, (1.0, 0.5), 0.1), "low_gain"),
        (lambda: makeweight(1.0, (1.0, 0.5), 0.1, order=0), "order"),
        (lambda: makeweight(2.0, 4.0, 0.1, 1.0), "below pi / dt"),
        (lambda: makeweight(2.0, 1.0, 1.5), "between"),
        (lambda: noise_weight(np.ones(5000), 0.1), "constant"),
        (lambda: noise_weight(np.arange(20.0), 0.1), "20 samples"),
        (lambda: noise_weight([np.nan] * 1000, 0.1), "NaN"),
        (lambda: noise_weight(np.arange(5000.0), -0.1), "dt"),
        (lambda: noise_weight(np.arange(5000.0), 0.1, bands=0), "bands"),
    ],
)
def test_senseless_numbers_are_named(call, text):
    with pytest.raises(InputError, match=text):
        call()
