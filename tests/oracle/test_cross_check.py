"""Margins and worst-case gains, confirmed or contradicted by SLICOT."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis.cross_check import cross_check
from robustlab.result import Status


def oscillators(blocks, seed=0, dt=0.0):
    """A stable random model whose channels fit the blocks, with one input and one output more."""
    rng = np.random.default_rng(seed)
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    A = np.array([[-0.2, 2.0, 0, 0], [-2.0, -0.2, 0.3, 0], [0, 0, -0.5, 5.0], [0.4, 0, -5.0, -0.5]])
    if dt:
        A = 0.9 * A / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((4, q + 1)), rng.standard_normal((p + 1, 4))
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, np.zeros((p + 1, q + 1)), dt), blocks)


SETS = {
    "one full": [rl.FullBlock("f", 2, 2)],
    "wide": [rl.FullBlock("f", 1, 3), rl.ComplexScalar("c")],
    "real and complex": [rl.RealScalar("r"), rl.ComplexScalar("c")],
    "repeated": [rl.RealScalar("r", 2), rl.ComplexScalar("c", 2)],
    "asymmetric": [rl.RealScalar("r", parameter=rl.ParameterRange(1.0, 0.5, below=0.25)), rl.ComplexScalar("c")],
    "four reals": [rl.RealScalar(f"r{i}") for i in range(4)],
}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_slicot_agrees_with_margins(name, dt):
    uncertain = oscillators(SETS[name], seed=3, dt=dt)
    check = cross_check(uncertain, rl.robust_stability(uncertain))
    assert check.status is Status.CONVERGED
    assert check.answered == check.asked
    assert check.exact == (name in ("one full", "wide", "real and complex"))


@pytest.mark.parametrize("name", ["one full", "four reals"])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_slicot_agrees_with_gains(name, dt):
    uncertain = oscillators(SETS[name], seed=5, dt=dt)
    small = rl.UncertainModel(scaled(uncertain.M, 0.02), uncertain.blocks)
    worst = rl.peak_gain(small)
    check = cross_check(small, worst)
    assert check.status is Status.CONVERGED
    assert worst.lower * (1 - 1e-6) <= check.theirs <= worst.upper * (1 + 1e-6)


def test_a_margin_that_is_too_small_or_too_large_is_contradicted():
    uncertain = oscillators(SETS["real and complex"], seed=3)
    margin = rl.robust_stability(uncertain)
    attained = dataclasses.replace(margin, upper=0.9 * margin.upper)  # says that a smaller Delta destabilises
    assert cross_check(uncertain, attained).status is Status.FAILED
    proved = dataclasses.replace(margin, lower=1.1 * margin.lower)  # says that a smaller mu is proved
    assert cross_check(uncertain, proved).status is Status.FAILED


def test_a_gain_that_is_not_attained_is_contradicted():
    uncertain = rl.UncertainModel(scaled(oscillators(SETS["one full"]).M, 0.02), SETS["one full"])
    worst = rl.peak_gain(uncertain)
    check = cross_check(uncertain, dataclasses.replace(worst, lower=1.02 * worst.upper, upper=1.03 * worst.upper))
    assert check.status is Status.FAILED
    assert "contradicts" in check.said


def test_an_unstable_member_has_no_norm_to_compare():
    uncertain = oscillators(SETS["one full"])
    margin = rl.robust_stability(uncertain)
    large = rl.UncertainModel(scaled(uncertain.M, 2 * margin.upper), uncertain.blocks)
    assert cross_check(large, rl.peak_gain(large)).status is Status.INCONCLUSIVE


def scaled(M, factor):
    """The same model with Delta ``factor`` times as large."""
    n = M.n_inputs - 1
    B = np.hstack([factor * M.B[:, :n], M.B[:, n:]])
    return rl.StateSpaceModel(M.A, B, M.C, M.D, M.dt)
