"""Skewed mu: its closed forms and limits, both bounds re-proved from their evidence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl


def gain_problem(seed: int, kind, n: int = 3):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((n + 2, n + 2)) + 1j * rng.standard_normal((n + 2, n + 2))
    M[:n, :n] *= 0.5 / np.linalg.norm(M[:n, :n], 2)
    return M, [*(kind(f"d{i}") for i in range(n)), rl.FullBlock("p", 2, 2)]


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.sampled_from([rl.RealScalar, rl.ComplexScalar]))
def test_the_largest_gain_is_between_the_bounds(seed, kind):
    M, blocks = gain_problem(seed, kind)
    bounds = rl.mu(M, blocks, fixed=["d0", "d1", "d2"])
    assert 0 < bounds.lower <= bounds.upper
    rng = np.random.default_rng(seed + 1)
    for _ in range(60):
        d = rng.choice([-1.0, 1.0], 3) if kind is rl.RealScalar else np.exp(2j * np.pi * rng.random(3))
        inner = np.diag(d) @ np.linalg.solve(np.eye(3) - M[:3, :3] @ np.diag(d), M[:3, 3:])
        assert np.linalg.norm(M[3:, 3:] + M[3:, :3] @ inner, 2) <= bounds.upper * (1 + 1e-9)
    assert np.linalg.svd(np.eye(5) - M @ bounds.delta, compute_uv=False)[-1] < 1e-8
    assert np.abs(np.diag(bounds.delta)[:3]).max() <= 1 + 1e-12
    assert np.linalg.norm(bounds.delta[3:, 3:], 2) == pytest.approx(1 / bounds.lower, rel=1e-9)
    if kind is rl.ComplexScalar:
        assert bounds.upper <= 1.05 * bounds.lower


def test_the_scalings_prove_the_level():
    M, blocks = gain_problem(3, rl.RealScalar)
    bounds = rl.mu(M, blocks, fixed=["d0", "d1", "d2"])
    scaled = M / np.array([1, 1, 1, bounds.upper, bounds.upper])
    product = bounds.G @ scaled
    n = bounds.D - scaled.conj().T @ bounds.D_z @ scaled - 1j * (product - product.conj().T)
    assert np.linalg.eigvalsh(n)[0] >= -1e-12 * np.abs(n).max()
    assert np.linalg.eigvalsh(bounds.D)[0] > 0


def test_fixed_blocks_that_can_be_singular_have_no_finite_level():
    bounds = rl.mu([[2.0, 1.0], [1.0, 0.0]], [[1, 0], [1, 0]], fixed=["delta1"])
    assert bounds.upper == np.inf
    assert bounds.status is rl.Status.INACCURATE


def test_a_stack_and_a_closed_form():
    """|d1| <= 1: gain of d / (1 - 0.5 d) is 2; of 0 without feedback is 0."""
    stack = np.array([[[0.5, 1.0], [1.0, 0.0]], [[0.5, 1.0], [0.0, 0.0]]])
    bounds = rl.mu(stack, [[1, 0], [1, 1]], fixed=["delta1"])
    assert bounds.upper == pytest.approx([2.0, 0.0], abs=1e-3)
    assert bounds.lower[0] == pytest.approx(2.0, rel=1e-6)
