"""Localisation of errors: shares against Parseval and known bands, clipping against known signals."""

import numpy as np
import pytest

from robustlab.identification.comparison import motion_of, spectrum
from robustlab.identification.data_checks import clipped_runs
from robustlab.record import Record


def test_density_integrates_to_the_mean_square():
    t = np.arange(20_000) * 1e-3
    error = np.random.default_rng(0).standard_normal(len(t)) + 3.0 * np.sin(2 * np.pi * 50 * t)
    s = spectrum(t, {}, error, np.zeros_like(t))
    assert (s.error.sum() * (s.frequency[1] - s.frequency[0])) == pytest.approx(np.mean(error**2), rel=0.02)
    assert s.error_share.sum() == pytest.approx(1.0)
    assert s.bands[0] == 0.0
    assert s.bands[-1] == pytest.approx(500.0)


def test_an_error_in_one_band_is_found_there():
    t = np.arange(8000) * 1e-3
    measured = np.sin(2 * np.pi * 2 * t)
    error = 0.1 * np.sin(2 * np.pi * 60 * t) + 0.01 * np.sin(2 * np.pi * 2 * t)
    s = spectrum(t, {}, measured, measured - error)
    k = np.searchsorted(s.bands, 60.0) - 1
    assert s.error_share[k] == pytest.approx(0.01 / (0.01 + 0.0001), abs=0.005)


def test_coherence_is_one_for_an_error_made_by_the_input_and_low_otherwise():
    rng = np.random.default_rng(1)
    t = np.arange(40_000) * 1e-2
    u, w = rng.standard_normal(len(t)), rng.standard_normal(len(t))
    s = spectrum(t, {"u": u, "w": w}, 0.3 * u, np.zeros_like(t))
    assert s.coherence["u"].min() > 0.999
    assert np.mean(s.coherence["w"] <= s.coherence_level) == pytest.approx(0.99, abs=0.01)


def test_speed_is_the_measured_one_else_the_derivative_of_the_position():
    t = np.arange(500) * 0.01
    q = Record(t, outputs={"q": np.sin(t), "c": t}, units={"q": "m"})
    found = motion_of(q, 100)
    assert found.speed_source.startswith("derivative of q")
    assert found.speed_unit == "m/s"
    np.testing.assert_allclose(found.speed, np.cos(t), atol=1e-4)
    both = Record(t, outputs={"q": np.sin(t), "v": np.cos(t)}, units={"q": "rad", "v": "rad/s"})
    assert motion_of(both, 100).speed_source == "v"
    assert motion_of(Record(t, outputs={"c": t}), 100).speed is None
    assert motion_of(Record(t[:3], outputs={"q": t[:3]}, units={"q": "m"}), 3).speed is None


def test_clipping_is_distinguished_from_standstill_and_from_two_levels():
    t = np.arange(2000) * 0.01
    clipped = clipped_runs(np.clip(np.sin(t), -2, 0.8))
    assert sum(last - first for first, last in clipped) == (np.sin(t) >= 0.8).sum()
    assert clipped_runs(np.sin(t)) == []
    smooth = np.where(t < 5, 0.5 - 0.5 * np.cos(np.pi * np.minimum(t, 5) / 5), 1.0)  # stops
    assert clipped_runs(np.round(smooth, 6)) == []
    assert clipped_runs(np.sign(np.sin(t))) == []
    waits = np.maximum(np.arange(2000) - 500, 0) * 0.01  # constant before it starts at full slope
    assert clipped_runs(waits) == []
