"""Residual forces with known structure: curves and shares; and the figure."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.errors import InputError
from robustlab.identification.naming.residual_force import residual_force

H = 1e-3
UNITS = {"speed": "rad/s", "position": "rad", "time": "s", "input u": "V"}


def slow_noise(rng, n, bandwidth=5.0):
    """Noise of unit variance behind a first-order low pass."""
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


def test_curve_over_speed_has_the_friction_in_its_band_and_other_coordinates_no_share():
    inside = []
    for seed in range(5):
        x = motion(seed, 20000)
        rng = np.random.default_rng(seed)
        d = friction(x) + 0.5 * slow_noise(rng, 20000)
        found = residual_force(d, np.full(20000, 0.2), x, UNITS, unit="N m", seed=seed)
        curve = found.curves["speed"]
        truth = friction({"speed": curve.x})
        inside.append((curve.low <= truth) & (truth <= curve.high))
        assert curve.share > 0.93
        assert found.curves["time"].share < 0.05
        assert found.curves["position"].share < 0.1
        assert found.noise_share == pytest.approx(0.2**2 / np.var(d), rel=0.1)
    assert np.mean(inside) > 0.85


def test_shares_are_of_blocks_never_seen():
    # A spline follows noise in the samples it is fitted to; held-out, it explains nothing.
    x, rng = motion(3), np.random.default_rng(0)
    for name, curve in residual_force(slow_noise(rng, 5000), np.ones(5000), x).curves.items():
        assert curve.share < 0.1, name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"d": np.zeros(99)}, "100 samples"),
        ({"d": np.full(100, np.nan)}, "NaN"),
        ({"d_std": np.zeros(100)}, "positive"),
        ({"coordinates": {}}, "no coordinates"),
        ({"coordinates": {"speed": np.zeros(7)}}, "speed"),
        ({"blocks": 3}, "blocks"),
        ({"blocks": 50}, "blocks"),
        ({"blocks": np.zeros(99)}, "blocks"),
        ({"blocks": np.arange(100) // 50}, "2 blocks"),
    ],
)
def test_bad_input_is_named(change, message):
    usual = {"d": np.ones(100), "d_std": np.ones(100), "coordinates": {"speed": np.arange(100.0)}, "blocks": 10}
    with pytest.raises(InputError, match=message):
        residual_force(**(usual | change))
