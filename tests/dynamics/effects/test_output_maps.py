"""Output maps in closed form, and where they can be seen at all."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustlab.dynamics import Site, effect
from robustlab.errors import InputError

Y = np.array([[0.0, 1.0, 2.5], [-1.0, 0.2, 4.0]])


def mapped(name, y, values, h=1e-3):
    return effect(name).output(y, values, h)


def test_closed_forms():
    np.testing.assert_allclose(mapped("sensor-gain", Y, {"s": 1.2}), 1.2 * Y)
    np.testing.assert_allclose(mapped("sensor-bias", Y, {"b": -0.3}), Y - 0.3)
    np.testing.assert_allclose(mapped("quantisation", Y, {"lsb": 0.4}), [[0, 0.8, 2.4], [-0.8, 0.0, 4.0]], atol=1e-15)


def test_an_eccentricity_repeats_every_turn_and_has_the_amplitude_of_its_parts():
    y = np.linspace(0, 2 * np.pi, 4001)[None]
    values = {"c": 0.003, "s": 0.004, "k": 1.0}
    error = mapped("sensor-eccentricity", y, values) - y
    assert np.abs(error).max() == pytest.approx(0.005, rel=1e-6)
    np.testing.assert_allclose(error, 0.005 * np.cos(y - np.arctan2(4, 3)), atol=1e-15)
    np.testing.assert_allclose(mapped("sensor-eccentricity", y + 2 * np.pi, values) - y - 2 * np.pi, error, atol=1e-14)
    assert effect("sensor-eccentricity").footprint(Site("output", "y"), values, 1.0).offset == pytest.approx(0.005)


@given(st.floats(0, 0.05), st.floats(-5, 5), st.floats(-5, 5))
def test_a_delayed_straight_line_is_exact_from_the_first_sample(d, slope, start):
    t = 1e-3 * np.arange(30)
    y = np.stack([start + slope * t, slope - start * t])
    late = np.stack([start + slope * (t - d), slope - start * (t - d)])
    np.testing.assert_allclose(mapped("sensor-delay", y, {"d": d}), late, atol=1e-11)


def test_a_step_of_zero_is_named():
    with pytest.raises(InputError, match="a positive step"):
        mapped("quantisation", Y, {"lsb": 0.0})
