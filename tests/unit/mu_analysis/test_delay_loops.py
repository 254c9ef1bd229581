"""Margins of loops with exact delays: closed forms, models without delays, dense grids, random points."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
INTEGRATOR = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
K2 = rl.StateSpaceModel(-0.5 * np.eye(2), np.eye(2), np.eye(2), [[1.0, 0.2], [-0.1, 0.8]])


def two_by_two(late=(0.3, 0.1)):
    A = [[-1.0, 0.4, 0.0], [-0.3, -2.0, 1.0], [0.0, -1.0, -0.5]]
    G = rl.StateSpaceModel(
        A, [[1.0, 0.0], [0.3, 1.0], [0.0, 0.5]], [[1.0, 0.0, 0.5], [0.0, 1.0, -0.3]], np.zeros((2, 2))
    )
    return rl.with_delays(G, inputs={0: late[0]}, outputs={1: late[1]})


def test_an_integrator_with_a_delay_has_its_closed_forms():
    for tau in (0.1, 0.5, 1.2):
        margin = rl.classical_margins(INTEGRATOR @ rl.delay(tau)).channels["y1"]
        assert margin.gain_margin == (0.0, pytest.approx(np.pi / 2 / tau, rel=1e-9))
        assert margin.phase_margin == pytest.approx(np.pi / 2 - tau, rel=1e-9)
        assert margin.delay_margin == pytest.approx(np.pi / 2 - tau, rel=1e-9)
        assert margin.status is rl.Status.CONVERGED


@pytest.mark.slow
def test_all_of_many_crossings_are_found():
    # a lightly damped mode after a long delay: L crosses the unit circle and the real axis many times
    mode = rl.StateSpaceModel([[0, 1], [-100.0, -0.1]], [[0], [1]], [[30.0, 0]], [[0]])
    L = (mode + 0.5 * LAG) @ rl.delay(2.0)
    S = rl.classical_margins(L).channels["y1"]
    omega = np.linspace(1e-3, 60.0, 2_000_001)
    G = rl.frequency_response(L, omega)[:, 0, 0]
    gains = omega[:-1][np.diff(np.sign(abs(G) - 1)) != 0]
    assert [c.frequency for c in S.gain_crossings] == pytest.approx(gains.tolist(), abs=1e-4)
    turns = (np.diff(np.sign(G.imag)) != 0) & (G.real[:-1] < 0) & (omega[:-1] < 40.0)
    factors = sorted(-1 / G.real[:-1][turns])
    least = min((f for f in factors if f >= 1), default=np.inf)
    wanted = [f for f in factors if f <= least * (1 + 1e-3)]
    assert sorted(c.factor for c in S.phase_crossings) == pytest.approx(wanted, rel=2e-3)
    assert S.status is rl.Status.CONVERGED


def test_closed_loops_at_the_margins_have_the_stated_stability():
    P = two_by_two()
    loop = rl.classical_margins(P, K2)
    for i, (name, margin) in enumerate(loop.channels.items()):
        assert margin.status is rl.Status.CONVERGED
        for factor, stable in ((0.97, True), (1.03, False)):
            change = np.eye(2)
            change[i, i] = margin.gain_margin[1] * factor
            closed = (rl.StateSpaceModel([], [], [], change) @ P @ K2).feedback(np.eye(2))
            assert rl.robust_stability(closed).stable is stable, name
        late = [0.0, 0.0]
        late[i] = 1.05 * margin.delay_margin
        assert (
            rl.robust_stability((rl.with_delays(P, outputs=dict(enumerate(late))) @ K2).feedback(np.eye(2))).stable
            is False
        )


@pytest.mark.slow
def test_disk_margins_of_several_loops():
    P = two_by_two()
    for at in ("output", "input", "both"):
        found = rl.disk_margin(P, K2, at=at)
        grid = rl.disk_margin(P, K2, frequency=np.geomspace(1e-2, 30.0, 400), at=at)
        assert found.status is rl.Status.CERTIFIED
        assert found.simultaneous.lower <= found.simultaneous.upper <= 1.0101 * found.simultaneous.lower
        assert found.simultaneous.lower <= grid.upper * (1 + 1e-9)
        assert found.simultaneous.upper == pytest.approx(grid.upper, rel=5e-3)
        for name, margin in found.channels.items():
            assert margin.upper == pytest.approx(grid.channels[name].upper, rel=5e-3)
    # the critical factors, as stable systems, bring a root to the axis: a little beyond, the loop is unstable
    found = rl.disk_margin(P, K2).simultaneous
    for size, stable in ((0.97, True), (1.03, False)):
        parts = [_grown(found.perturbation[name], size) for name in found.delta]
        one = np.eye(2)
        both = one[:, :1] @ parts[0] @ one[:1] + one[:, 1:] @ parts[1] @ one[1:]
        loop = (both @ P @ K2).feedback(one)
        assert rl.robust_stability(loop).stable is stable


def _grown(factor, size):
    """The factor f with delta = (f - 1) / (1 + (f - 1) / 2) taken ``size`` times as large (skew 0)."""
    one = np.eye(1)
    change = factor - one
    delta = size * change @ (one + 0.5 * change).inverse()
    return one + delta @ (one - 0.5 * delta).inverse()


def test_an_integrator_in_the_loop_is_no_pole_of_it():
    """1 / (s e^(s/2) + 1): the open loop has a pole at frequency zero."""
    integrator = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    loop = (integrator @ rl.delay(0.5)).feedback()
    omega = np.array([0.0, 1e-12, 1e-6, 0.3, 2.0])
    s = 1j * omega
    assert rl.frequency_response(loop, omega)[:, 0, 0] == pytest.approx(1 / (s * np.exp(0.5 * s) + 1), rel=1e-14)
    found = rl.peak_gain(loop)
    grid = np.linspace(0.0, 20.0, 4001)
    assert found.lower <= found.upper
    assert np.abs(1 / (1j * grid * np.exp(0.5j * grid) + 1)).max() <= found.upper <= 1.01
    assert rl.disk_margin(integrator @ rl.delay(0.5)).upper == pytest.approx(
        rl.disk_margin(integrator @ rl.delay(0.5)).simultaneous.upper, rel=0.01
    )
    P = rl.StateSpaceModel([[0.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    closed = rl.with_delays(P, inputs={1: 0.5}).close(rl.StateSpaceModel([], [], [], [[-1.0]]))
    assert rl.peak_gain(closed).status is rl.Status.CERTIFIED
    # Terms added to and subtracted from the integrator's output, where a near pole would cost digits
    near = rl.frequency_response(closed, [1e-9, 1e-7])[:, 0, 0]
    exact = [1 / (1j * w + np.exp(-0.5j * w)) for w in (1e-9, 1e-7)]
    assert near == pytest.approx(exact, rel=1e-13)
