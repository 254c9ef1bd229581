"""What splitting a model costs: the error of a reduced model holds between the model given and the one returned."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

import robustlab as rl
from robustlab.result import Status


def mixed(apart, gain, seed=0, dt=0.0):
    """Three stable modes and others of this gain, in states mixed by a random matrix."""
    rng = np.random.default_rng(seed)
    A = block_diag([[-1.0]], [[-0.2, 3.0], [-3.0, -0.2]], apart)
    if dt:
        A = block_diag(np.diag([0.3, -0.5, 0.8]), apart)
    n = len(A)
    B, C, T = rng.normal(size=(n, 1)), rng.normal(size=(1, n)), rng.normal(size=(n, n))
    B[3:] *= np.sqrt(gain)
    C[:, 3:] *= np.sqrt(gain)
    return rl.StateSpaceModel(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), [[0.0]], dt)


def test_no_error_is_exceeded_where_modes_on_the_boundary_have_huge_gains():
    # Judged in balls of 60 digits, beside the poles too, by code that shares none with the package.
    pytest.importorskip("flint")
    from reduction_attack import run

    rows = [run(seed) for seed in range(24)]
    good = [row for row in rows if row["status"] == "certified"]
    assert len(good) >= 12
    assert sum(row["left_out"] > 0 for row in good) >= 5
    assert not [row["words"] for row in good if row["false"]]


def test_a_peak_that_is_a_millionth_of_what_cancels_in_it_is_not_missed():
    # The eigenvalues of the Hamiltonian miss it: the error was certified 7e-4 below what it is beside a resonance.
    pytest.importorskip("flint")
    from reduction_attack import run

    row = run(697)
    assert row["status"] == "certified"
    assert not row["false"]


def test_an_unstable_mode_of_huge_gain_adds_what_its_rounding_may_be():
    quiet, loud = (rl.reduce_model(mixed([[0.5]], gain), 3) for gain in (1.0, 1e14))
    assert quiet.status is loud.status is Status.CERTIFIED
    assert quiet.left_out == loud.left_out == ()
    assert quiet.error.upper <= quiet.bound * (1 + 1e-2)
    # 1e14 times rounding is no small part of the error, and the bracket says so.
    assert loud.error.upper - loud.error.lower > 1e-4 * loud.error.upper
    assert quiet.error.lower <= loud.error.upper


@pytest.mark.parametrize(("apart", "dt", "centre"), [
    ([[0.0]], 0.0, 0.0),
    ([[0.0, 2.0], [-2.0, 0.0]], 0.0, 2.0),
    ([[1.0]], 0.1, 0.0),
    ([[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]], 0.1, 2.0),
])  # fmt: skip
def test_around_a_mode_on_the_boundary_nothing_is_proved_and_this_is_said(apart, dt, centre):
    found = rl.reduce_model(mixed(apart, 1.0, 1, dt), len(apart) + 1)
    assert found.status is Status.CERTIFIED
    ((low, high),) = found.left_out
    assert low <= centre <= high
    assert high - low < 1e-4
    assert dict(found.facts())["not proved at"]
    assert found.error.upper <= found.bound * (1 + 2e-3)


def test_what_is_not_rounded_is_proved_everywhere():
    # Parts that are apart already, and some that come apart exactly in binary numbers.
    apart = rl.StateSpaceModel(np.diag([-1.0, -50.0, 0.0]), np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    upper = rl.StateSpaceModel([[-1.0, 2.0], [0.0, 0.0]], [[3.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    for model, order in ((apart, 2), (upper, 1)):
        found = rl.reduce_model(model, order)
        assert (found.status, found.left_out) == (Status.CERTIFIED, ())
    # A model without stable modes comes back as it is.
    kept = rl.reduce_model(rl.StateSpaceModel(np.diag([1.0, 2.0]), [[1.0], [1e9]], [[1.0, 0.1]], [[0.0]]), 2)
    assert np.array_equal(kept.model.A, np.diag([1.0, 2.0]))
    assert kept.error.upper == 0.0
    # Two copies of an unstable mode are one.
    one = rl.reduce_model(rl.StateSpaceModel(np.eye(2), [[1.0], [1e9]], [[1.0, 0.1]], [[0.0]]), 2)
    assert (one.model.A.tolist(), one.left_out, one.status) == ([[1.0]], (), Status.CERTIFIED)
    assert one.error.upper <= 1e-15 * (1 + 1e8)
