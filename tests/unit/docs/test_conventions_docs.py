"""docs/conventions.md: the code runs and its numbers are right; each convention, built the wrong way, is told."""

from __future__ import annotations

import control
import numpy as np
import pytest

import robustlab as rl

G = rl.StateSpaceModel(
    [[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], inputs=["u"], outputs=[("q", "rad")]
)


def test_the_gain_of_python_control_s_lqr_closes_the_loop_of_the_states():
    K, _, _ = control.lqr(G.to_control(), np.eye(2), [[1.0]])
    states = rl.StateSpaceModel(G.A, G.B, np.eye(2), np.zeros((2, 1)))
    margin = rl.disk_margin(states, K, sign=-1, at="input").simultaneous
    assert margin.lower >= 1.0 - 1e-9  # Kalman's inequality: |1 + L| >= 1, a disk of gains from 1/2 up with skew 1
    positive = -K
    with pytest.raises(rl.NoTrustworthyNumber, match="unstable"):
        rl.disk_margin(states, 3 * positive, at="input")


def test_the_break_point_is_named():
    two = rl.StateSpaceModel(-np.eye(2), np.eye(2), [[1, 2], [0, 1]], np.zeros((2, 2)), outputs=["p", "q"])
    gain = rl.StateSpaceModel([], [], [], [[1, 0], [0, 4]])
    at_output, at_input = (rl.disk_margin(two, gain, at=at) for at in ("output", "input"))
    assert (at_output.at, list(at_output.channels)) == ("output", ["p", "q"])
    assert (at_input.at, list(at_input.channels)) == ("input", ["u1", "u2"])
    # The two orders of the product are the two places.
    assert rl.disk_margin(two @ gain).simultaneous.lower == pytest.approx(at_output.simultaneous.lower, rel=1e-3)
    assert rl.disk_margin(gain @ two).simultaneous.lower == pytest.approx(at_input.simultaneous.lower, rel=1e-3)


def test_phases_are_radians_here_and_degrees_in_python_control():
    import control

    L = 4.0 * rl.StateSpaceModel([[0, 1], [0, -1]], [[0], [1]], [[1, 0]], [[0]])
    _, degrees, _, _ = control.margin(L.to_control())
    found = rl.classical_margins(L).channels["y1"]
    assert found.phase_margin == pytest.approx(np.radians(degrees), rel=1e-6)
    assert "degrees" in found.summary()
