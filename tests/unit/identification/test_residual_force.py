"""Residual forces with known structure: curves, bands and shares."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.identification import force_curves

H = 1e-3
UNITS = {"speed": "rad/s", "position": "rad", "time": "s", "input u": "V"}


def slow_noise(rng, n, bandwidth=5.0):
    """Return noise of unit variance behind a first-order low pass."""
    pole = np.exp(-2 * np.pi * bandwidth * H)
    x = lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 3000))[3000:]
    return x / x.std()


def motion(seed, n=5000):
    rng = np.random.default_rng([seed, 1])
    t = H * np.arange(n)
    v = sum(rng.uniform(6, 20) * np.sin(2 * np.pi * rng.uniform(0.2, 4) * t + rng.uniform(0, 6.3)) for _ in range(8))
    u = 0.05 * v + 0.01 * np.gradient(v, H)
    return {"speed": v, "position": H * np.cumsum(v), "time": t, "input u": u}


def friction(x):
    return np.sign(x["speed"]) * (2.0 + np.exp(-np.abs(x["speed"]) / 5.0)) + 0.02 * x["speed"]


def curves_of(d, std, x):
    return force_curves(d, std, x, np.arange(len(d)) * 24 // len(d), UNITS, "N m")


def test_curve_over_speed_has_the_friction_in_its_band_and_other_coordinates_no_share():
    inside = []
    for seed in range(5):
        x = motion(seed, 20000)
        rng = np.random.default_rng(seed)
        d = friction(x) + 0.5 * slow_noise(rng, 20000)
        found = curves_of(d, np.full(20000, 0.2), x)
        curve = found.curves["speed"]
        truth = friction({"speed": curve.x})
        inside.append((curve.low <= truth) & (truth <= curve.high))
        assert curve.share > 0.93
        assert found.curves["time"].share < 0.05
        assert found.curves["position"].share < 0.1
        assert found.noise_share == pytest.approx(0.2**2 / np.var(d), rel=0.1)
    assert np.mean(inside) > 0.85


def test_shares_are_of_held_out_blocks():
    # A curve fits noise in its own samples; in held-out blocks it explains no variance.
    x, rng = motion(3), np.random.default_rng(0)
    for name, curve in curves_of(slow_noise(rng, 5000), np.ones(5000), x).curves.items():
        assert curve.share < 0.1, name
