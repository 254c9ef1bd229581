"""A part of the attack on zeros and crossings: nothing that is vouched for is wrong, in exact arithmetic."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("flint")

import attack_zeros
import zeros_judge

import robustlab as rl

# The first cases of every family, and what the attack has found: a slow zero on the right that was taken for a hidden
# mode, products of matched zeros that overflow, poles that rounding moves over the axis.
SUBSET = {
    "zeros": range(12 * len(attack_zeros.FAMILIES)),
    "crossings": range(7 * len(attack_zeros.LOOPS)),
}


@pytest.mark.parametrize("what", SUBSET)
def test_nothing_that_is_vouched_for_is_wrong(what):
    found = [attack_zeros.CASES[what](i) for i in SUBSET[what]]
    assert [r for r in found if r["wrong"]] == []
    vouched = sum(r["status"] in ("converged", "certified") for r in found)
    assert vouched >= 0.97 * len(found)


def test_the_judge_on_closed_forms():
    assert zeros_judge.invariant_zeros([[-1e-6]], [[1.0]], [[1.0]], [[1.0]]) == ([pytest.approx(-1 - 1e-6)], 1)
    lag = zeros_judge.Loop([[1.0]], [[1.0]], [[4.0]], [[0.0]])  # 4/(s - 1): |L| = 1 at sqrt(15)
    gain, phase = lag.crossings()
    assert gain == [(pytest.approx(15**0.5), pytest.approx(math.acos(0.25)))]
    assert (phase, lag.stable_closed(), lag.above_one(3.8), lag.above_one(3.9)) == ([], True, True, False)


def test_the_judge_catches_what_is_missing():
    parts = tuple(map(np.array, ([[0.0, 1.0], [-6.0, -5.0]], [[0.0], [1.0]], [[2.0, 1.0]], [[0.0]])))
    found = rl.zeros(rl.StateSpaceModel(*parts))
    rng = np.random.default_rng(0)
    assert attack_zeros.zeros_fault(parts, found, rng) == ""
    for lie in (replace(found, values=found.values[:0]), replace(found, values=found.values * (1 + 1e-8))):
        assert attack_zeros.zeros_fault(parts, lie, rng)
    unstable = ([[1.0]], [[1.0]], [[4.0]], [[0.0]])
    loop, margin = zeros_judge.Loop(*unstable), rl.classical_margins(rl.StateSpaceModel(*unstable)).channels["y1"]
    assert attack_zeros.crossings_fault(loop, margin) == ""
    assert attack_zeros.crossings_fault(loop, replace(margin, gain_crossings=()))
    assert attack_zeros.crossings_fault(loop, replace(margin, phase_margin=margin.phase_margin * 1.001))
