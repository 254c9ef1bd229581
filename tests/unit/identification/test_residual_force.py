"""Residual forces with known structure: curves, shares and periodic lines."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.identification import LeftOver, moving_samples, remaining_lines, residual_curves

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


def curves_of(d, std, x, seed=0):
    blocks = np.arange(len(d)) * 24 // len(d)
    return residual_curves(LeftOver("omega", "N m", UNITS, moving_samples(d, std, x, blocks)), seed)


def test_curve_over_speed_has_the_friction_in_its_band_and_other_coordinates_no_share():
    inside = []
    for seed in range(5):
        x = motion(seed, 20000)
        rng = np.random.default_rng(seed)
        d = friction(x) + 0.5 * slow_noise(rng, 20000)
        found = curves_of(d, np.full(20000, 0.2), x, seed)
        curve = found.curves["speed"]
        truth = friction({"speed": curve.x})
        inside.append((curve.low <= truth) & (truth <= curve.high))
        assert curve.share > 0.93
        assert found.curves["time"].share < 0.05
        assert found.curves["position"].share < 0.1
        assert found.noise_share == pytest.approx(0.2**2 / np.var(d), rel=0.1)
    assert np.mean(inside) > 0.85


def test_shares_are_of_held_out_blocks():
    # A spline fits noise in its own samples; in held-out blocks it explains no variance.
    x, rng = motion(3), np.random.default_rng(0)
    for name, curve in curves_of(slow_noise(rng, 5000), np.ones(5000), x).curves.items():
        assert curve.share < 0.1, name


# --- lines -----------------------------------------------------------------------------------------------------------

N, DT, BLOCKS = 2400, 0.01, 16


def left_over(force_of, seed, zeros=(0.0, 0.0)):
    """Two records of back-and-forth motion with slow noise, and ``force_of(time, place, speed)`` besides.

    The encoder shows the place less ``zeros``, where it was switched on.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for k, zero in enumerate(zeros):
        t = DT * np.arange(N)
        # Frequencies without a common period, so that position and time are told apart.
        q = 0.1 * np.sin(0.9 * t + k) + 0.05 * np.sin(2.3 * t + rng.uniform(0, 6)) + zero
        v = np.gradient(q, DT)
        noise = lfilter([0.2], [1.0, -0.9], np.append(0.0, rng.standard_normal(N - 1)))
        parts.append((force_of(t, q, v) + noise, t, q - zero, v, k * BLOCKS + np.arange(N) * BLOCKS // N))
    force, t, q, v, blocks = (np.concatenate(column) for column in zip(*parts, strict=True))
    coordinates = {"speed": v, "time": t, "position": q, "input u": rng.standard_normal(len(t))}
    return LeftOver(
        "v", "N", {"time": "s", "position": "m"}, moving_samples(force, np.full(len(t), 0.3), coordinates, blocks)
    )


def test_a_line_over_the_position_is_found_with_its_period_and_size():
    (line,) = remaining_lines(left_over(lambda t, q, v: 0.5 * np.cos(2 * np.pi * q / 0.0025 + 0.7), 1))
    assert (line["over"], line["unit"], line["force_unit"]) == ("position", "m", "N")
    assert line["period"] == pytest.approx(0.0025, rel=2e-3)
    assert line["amplitude"] == pytest.approx(0.5, rel=0.1)
    assert line["p_value"] < 0.01


def test_each_record_may_have_its_own_zero():
    made = left_over(lambda t, q, v: 0.5 * np.cos(2 * np.pi * q / 0.004), 2, zeros=(0.0, 0.0123))
    (line,) = remaining_lines(made)
    assert line["period"] == pytest.approx(0.004, rel=2e-3)
    assert line["amplitude"] == pytest.approx(0.5, rel=0.1)


def test_a_line_over_time_is_distinguished_from_one_over_the_position():
    made = left_over(lambda t, q, v: 0.5 * np.sin(2 * np.pi * 7.3 * t) + 0.4 * np.cos(2 * np.pi * q / 0.0025), 4)
    lines = {line["over"]: line for line in remaining_lines(made)}
    assert set(lines) == {"time", "position"}
    assert lines["time"]["period"] == pytest.approx(1 / 7.3, rel=1e-3)
    assert lines["position"]["period"] == pytest.approx(0.0025, rel=2e-3)


def smooth(t, q, v):
    return 2.0 * np.tanh(v / 0.01) + 5.0 * v + 3.0 * q


@pytest.mark.parametrize("seeds", [(100, 101), pytest.param(range(102, 112), marks=pytest.mark.slow)])
def test_noise_and_smooth_curves_are_not_lines(seeds):
    """Twelve records of coloured noise and smooth curves, at a false alarm rate of 1 %."""
    assert sum(bool(remaining_lines(left_over(smooth, seed))) for seed in seeds) <= 1
