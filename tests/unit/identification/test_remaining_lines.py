"""Lines that remain over position and time: those that were put in are found, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.errors import InputError
from robustlab.identification.naming.residual_after_naming import LeftOver, remaining_lines

UNITS = {"speed": "m/s", "time": "s", "position": "m", "input u": "V"}
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
    return LeftOver("v", "N", UNITS, force, np.full(len(t), 0.3), coordinates, blocks)


def test_a_line_over_the_position_is_found_with_its_period_and_size():
    (line,) = remaining_lines(left_over(lambda t, q, v: 0.5 * np.cos(2 * np.pi * q / 0.0025 + 0.7), 1))
    assert (line["over"], line["unit"], line["force_unit"]) == ("position", "m", "N")
    assert line["period"] == pytest.approx(0.0025, rel=2e-3)
    assert line["amplitude"] == pytest.approx(0.5, rel=0.1)
    assert line["p_value"] < 0.01


def test_each_record_may_count_from_its_own_zero():
    made = left_over(lambda t, q, v: 0.5 * np.cos(2 * np.pi * q / 0.004), 2, zeros=(0.0, 0.0123))
    (line,) = remaining_lines(made)
    assert line["period"] == pytest.approx(0.004, rel=2e-3)
    assert line["amplitude"] == pytest.approx(0.5, rel=0.1)


def test_a_line_over_time_is_told_from_one_over_the_position():
    made = left_over(lambda t, q, v: 0.5 * np.sin(2 * np.pi * 7.3 * t) + 0.4 * np.cos(2 * np.pi * q / 0.0025), 4)
    lines = {line["over"]: line for line in remaining_lines(made)}
    assert set(lines) == {"time", "position"}
    assert lines["time"]["period"] == pytest.approx(1 / 7.3, rel=1e-3)
    assert lines["position"]["period"] == pytest.approx(0.0025, rel=2e-3)


def friction(t, q, v):
    return 2.0 * np.tanh(v / 0.01) + 5.0 * v + 3.0 * q


@pytest.mark.parametrize("seeds", [(100, 101), pytest.param(range(102, 112), marks=pytest.mark.slow)])
def test_noise_and_smooth_curves_are_no_lines(seeds):
    """Twelve records of coloured noise and friction, at a false alarm rate of one in a hundred."""
    assert sum(bool(remaining_lines(left_over(friction, seed))) for seed in seeds) <= 1


def test_a_broken_force_is_refused():
    made = left_over(lambda t, q, v: 0.0 * t, 6)
    force = made.force.copy()
    force[7] = np.nan
    with pytest.raises(InputError, match="d"):
        remaining_lines(LeftOver("v", "N", UNITS, force, made.std, made.coordinates, made.blocks))
