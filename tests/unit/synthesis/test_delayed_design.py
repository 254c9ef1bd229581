"""Controllers in loops with exact delays: what is proved against dense grids, and designs that only seem to work."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.synthesis.hinf.delayed_design import judged

P = rl.StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
OMEGA = np.geomspace(1e-3, 1e3, 40_001)


def peak(loop):
    return np.linalg.svd(rl.frequency_response(loop, OMEGA), compute_uv=False).max()


def test_a_given_controller_is_judged_with_exact_delays():
    late, gain = rl.with_delays(P, inputs={2: 0.3}), -0.4
    found = judged(late, rl.StateSpaceModel([], [], [], [[gain]]))
    L = -gain * np.exp(-0.3j * OMEGA) / (1j * OMEGA + 1)
    g = 1 / (1j * OMEGA + 1)
    T = np.array([[g / (1 + L), gain * g * np.exp(-0.3j * OMEGA) / (1 + L)], [gain * g / (1 + L), gain / (1 + L)]])
    exact = np.linalg.svd(np.moveaxis(T, 2, 0), compute_uv=False).max()
    assert found.stability.stable
    assert found.gain.lower == pytest.approx(exact, rel=1e-6)
    assert exact <= found.gamma <= 1.01 * exact
    assert found.status is rl.Status.CERTIFIED


def test_a_design_is_proved_with_the_delays_as_they_are():
    late = rl.with_delays(P, inputs={2: 0.5}, outputs={2: 0.2})
    found = rl.hinf(late, 1, 1)
    assert found.status is rl.Status.CERTIFIED
    assert peak(found.closed_loop) <= found.gamma <= 1.03 * found.design.gamma
    other = rl.star(late, found.K, 1, 1)  # the loop once more
    assert np.abs(rl.frequency_response(other, OMEGA) - rl.frequency_response(found.closed_loop, OMEGA)).max() < 1e-12


def test_a_design_that_forgets_the_delay_is_found_out():
    late = rl.with_delays(P, inputs={2: 1.0})
    careless = rl.StateSpaceModel([], [], [], [[-8.0]])  # stable without the delay, not with it
    assert rl.star(P, careless, 1, 1).nominal.is_stable()
    found = judged(late, careless)
    assert found.stability.stable is False
    assert found.status is rl.Status.FAILED
    assert found.gamma == np.inf
