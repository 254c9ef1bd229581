"""The door to SLICOT: answers of known problems, bad input, a child that hangs, crashes, or has no slycot."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import slicot
from robustlab.errors import DependencyMissing, InputError, NoTrustworthyNumber


def test_one_full_block_is_the_largest_singular_value():
    rng = np.random.default_rng(0)
    M = rng.standard_normal((4, 3, 3)) + 1j * rng.standard_normal((4, 3, 3))
    bounds = slicot.structured_norm_bounds(M, [3], [False])
    assert bounds == pytest.approx(np.linalg.norm(M, 2, axis=(1, 2)), rel=1e-6)


def test_two_scalars_have_a_closed_form():
    # mu of [[0, a], [b, 0]] for two complex scalars is sqrt(|a b|).
    M = np.array([[[0, 4.0], [1.0, 0]], [[0, 9j], [1.0, 0]]])
    assert slicot.structured_norm_bounds(M, [1, 1], [False, False]) == pytest.approx([2.0, 3.0], rel=1e-6)


def test_norm_of_a_lag_and_of_a_resonance():
    one = np.ones((1, 1))
    assert slicot.peak_gain(-one, one, 3 * one, 0 * one, discrete=False) == pytest.approx(3.0, rel=1e-9)
    zeta = 0.05
    A = np.array([[0.0, 1.0], [-1.0, -2 * zeta]])
    gain = slicot.peak_gain(A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), 0 * one, discrete=False)
    assert gain == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-9)
    assert slicot.peak_gain(0.5 * one, one, one, 0 * one, discrete=True) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(
    ("matrices", "sizes", "real"),
    [
        (np.ones((2, 2)), [1, 1], [False, False]),
        (np.ones((1, 2, 3)), [2], [False]),
        (np.full((1, 2, 2), np.nan), [1, 1], [False, False]),
        (np.ones((1, 2, 2)), [2], [True]),
    ],
)
def test_bad_input_does_not_reach_the_routine(matrices, sizes, real):
    with pytest.raises(InputError, match="AB13MD"):
        slicot.structured_norm_bounds(matrices, sizes, real)


def test_nan_in_a_model_is_refused():
    with pytest.raises(InputError, match="AB13DD"):
        slicot.peak_gain(np.array([[np.nan]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), discrete=False)


def test_a_child_that_hangs_is_killed(monkeypatch):
    monkeypatch.setattr(slicot, "SECONDS", 0.05)  # no interpreter starts as quickly
    with pytest.raises(NoTrustworthyNumber, match="no answer in"):
        slicot.structured_norm_bounds(np.ones((1, 1, 1)), [1], [False])


def test_a_child_that_crashes_is_told(monkeypatch, tmp_path):
    (tmp_path / "slycot").mkdir()
    (tmp_path / "slycot" / "__init__.py").write_text("import os\nos.abort()\n")
    monkeypatch.setattr(slicot, "_environment", lambda: environment(tmp_path))
    with pytest.raises(NoTrustworthyNumber, match="the child process failed"):
        slicot.structured_norm_bounds(np.ones((1, 1, 1)), [1], [False])


def test_without_slycot_the_way_out_is_said(monkeypatch, tmp_path):
    (tmp_path / "slycot.py").write_text("raise ImportError('no slycot here')\n")
    monkeypatch.setattr(slicot, "_environment", lambda: environment(tmp_path))
    with pytest.raises(DependencyMissing) as told:
        slicot.structured_norm_bounds(np.ones((1, 1, 1)), [1], [False])
    assert "pip install slycot" in str(told.value.hint)


def environment(first):
    real = ORIGINAL()
    return {**real, "PYTHONPATH": f"{first}:{real['PYTHONPATH']}"}


ORIGINAL = slicot._environment
