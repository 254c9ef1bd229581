"""The critical Delta in the time domain."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis import replay


def oscillator(kind, dt: float = 0.0) -> rl.UncertainModel:
    """x'' + (0.4 - 0.1 delta) x' + x = u: delta = 4 removes the damping, at 1 rad/s."""
    M = rl.StateSpaceModel(
        [[0.0, 1.0], [-1.0, -0.4]], [[0.0, 0.0], [0.1, 1.0]], [[0.0, 1.0], [1.0, 0.0]], np.zeros((2, 2))
    )
    if dt:
        from robustlab.norms import bilinear_to_discrete

        M = bilinear_to_discrete(M, dt)
    return rl.UncertainModel(M, [kind("c")])


@pytest.mark.parametrize("dt", [0.0, 0.05])
@pytest.mark.parametrize("kind", [rl.RealScalar, rl.ComplexScalar])
def test_the_critical_delta_has_an_undamped_oscillation(kind, dt):
    uncertain = oscillator(kind, dt)
    margin = rl.robust_stability(uncertain)
    assert margin.upper == pytest.approx(4.0, rel=1e-6)
    shown = replay(uncertain, margin)
    assert shown.growth == pytest.approx(1.0, abs=1e-3)
    assert shown.period == pytest.approx(2 * np.pi, rel=1e-3)
    assert np.abs(shown.nominal[-20:]).max() < 1e-4
    inside = np.abs(shown.inside)
    assert inside[-40:].max() < 0.9 * inside[:40].max()
