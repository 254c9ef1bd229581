"""Robust gain margins against closed forms, worst-case gains, and the published example."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.statespace import StateSpaceModel

# 1 / (s + 1 + delta / 2): the largest gain of the set times k is 1 / (1 - k / 2).
LAG = rl.UncertainModel(
    StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]]), [rl.RealScalar("pole")]
)


def times(uncertain, size):
    """The set grown by a factor."""
    M, q = uncertain.M, uncertain.delta_shape[0]
    grown = np.append(np.full(q, size), np.ones(M.n_inputs - q))
    return rl.UncertainModel(StateSpaceModel(M.A, M.B * grown, M.C, M.D * grown, M.dt), uncertain.blocks)


@pytest.mark.parametrize("level", [1.05, 2.0, 4.0, 20.0])
def test_closed_form(level):
    wanted = 2 * (1 - 1 / level)
    found = rl.robust_gain(LAG, level)
    assert found.status == "certified"
    assert found.lower <= wanted * (1 + 1e-6)
    assert found.upper >= wanted * (1 - 1e-6)
    assert found.upper <= found.lower * 1.01
    assert found.proof
    assert rl.peak_gain(times(LAG, found.lower)).lower <= level * (1 + 1e-6)
    assert rl.peak_gain(LAG.evaluate(found.delta)).lower >= level * (1 - 1e-9)


def test_published_example():
    """MathWorks' robgain example: the sensitivity of a PID loop stays below 1.5 for [0.7821, 0.7837] of the set."""
    plant = rl.parametric([[0, 1], ["-k", "-1.8"]], [[0], [18.0]], [[1, 0]], [[0]], {"k": (10.0, 6.0, 14.0)})
    unmodelled = rl.UncertainModel(StateSpaceModel([], [], [], [[0, 1.0], [0.5, 1.0]]), [rl.FullBlock("delta", 1, 1)])
    # 2.3 + 3/s + 0.38 s / (0.001 s + 1)
    pid = StateSpaceModel([[0, 0], [0, -1000.0]], [[1.0], [1.0]], [[3.0, -380_000.0]], [[2.3 + 380.0]])
    sensitivity = (1 + plant @ unmodelled @ pid) ** -1
    found = rl.robust_gain(sensitivity, 1.5, tolerance=0.003)
    assert found.lower <= 0.7837
    assert found.upper >= 0.7821
    assert found.upper <= found.lower * 1.003


def test_bad_input():
    with pytest.raises(rl.InputError, match="level"):
        rl.robust_gain(LAG, -1.0)
    with pytest.raises(rl.InputError, match="UncertainModel"):
        rl.robust_gain(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 1.0)


def test_next_to_the_stability_limit_both_ends_come_together():
    """Two states, one real parameter, a level that only members next to the limit reach: one proof, no bisection."""
    M = StateSpaceModel([[-1, 0.2], [0, -2]], [[-0.5, 1], [0.2, 0.3]], [[1, 0], [0.3, 1]], np.zeros((2, 2)))
    uncertain = rl.UncertainModel(M, [rl.RealScalar("k")])
    found = rl.robust_gain(uncertain, 2.0, effort=0.02)  # its share of the usual work is far more than it takes
    assert found.status == "certified"
    assert found.upper <= found.lower * 1.001

    # The gain of the member at k falls over frequency: it is that at 0, a rational function of k.
    def gain(k):
        return rl.peak_gain(uncertain.evaluate({"k": k})).upper

    sign = np.sign(found.delta["k"])
    assert gain(sign * found.lower * (1 - 1e-6)) < 2.0 <= gain(sign * found.upper) * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_members_and_worst_case_gains_agree_with_both_ends(seed):
    """Random sets of all kinds of blocks, continuous and discrete, ranges wider on one side: judged by other means."""
    rng = np.random.default_rng(seed)
    kinds = [
        [rl.RealScalar("a")],
        [rl.RealScalar("a", parameter=rl.ParameterRange(1.0, 0.1, below=0.3)), rl.RealScalar("b")],
        [rl.RealScalar("a"), rl.ComplexScalar("c")],
        [rl.RealScalar("a", 2), rl.RealScalar("b"), rl.RealScalar("c")],
    ]
    blocks = kinds[seed % 4]
    n, q = 3, sum(b.rows for b in blocks)
    A = rng.normal(size=(n, n))
    dt = 0.1 if seed % 3 == 2 else 0.0
    A = (
        A / (1.3 * np.abs(np.linalg.eigvals(A)).max())
        if dt
        else A - (np.linalg.eigvals(A).real.max() + 0.4) * np.eye(n)
    )
    M = StateSpaceModel(A, rng.normal(size=(n, q + 1)), rng.normal(size=(q + 1, n)), np.zeros((q + 1, q + 1)), dt)
    uncertain = rl.UncertainModel(M, blocks)
    level = 2.0 * rl.peak_gain(uncertain.nominal).upper
    found = rl.robust_gain(uncertain, level)
    assert found.status == "certified"
    assert rl.peak_gain(times(uncertain, found.lower), tolerance=0.1).lower <= level * (1 + 1e-6)
    for delta in rng.uniform(-1, 1, size=(20, len(blocks))):
        values = {b.name: found.lower * d for b, d in zip(blocks, delta, strict=True)}
        assert rl.peak_gain(uncertain.evaluate(values)).lower <= level * (1 + 1e-6)
    if all(b.interval for b in blocks):
        member = uncertain.evaluate(found.delta)
        assert not member.is_stable() or rl.peak_gain(member).upper >= level * (1 - 1e-6)


def test_a_range_that_is_wider_below_is_proved_as_wide_as_it_is(monkeypatch):
    """1 / (s + a), a from 0.2 to 1.1 about 1: delta goes to -8. What is proved must not rest on what was found."""
    from robustlab.mu_analysis.axis import robust_gain as room

    uncertain = rl.parametric([["-a"]], [[1]], [[1]], [[0]], {"a": (1.0, 0.2, 1.1)})
    found = rl.robust_gain(uncertain, 2.0)
    assert found.lower <= 0.625 <= found.upper * (1 + 1e-9)  # a = 0.5
    assert found.upper <= found.lower * 1.01
    monkeypatch.setattr(room._Search, "descend", lambda self: None)
    assert 0.5 < rl.robust_gain(uncertain, 2.0).lower <= 0.625
