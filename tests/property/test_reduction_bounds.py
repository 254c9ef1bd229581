"""Reduction of random models: bound, stability, sizes; the reported loss of a controller."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl


def random_model(seed: int, n: int, dt: float) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    margin = rng.uniform(0.02, 1)
    A = A / np.abs(poles).max() * (1 - margin / 2) if dt else A - (poles.real.max() + margin) * np.eye(n)
    m, p = rng.integers(1, 4, 2)
    scale = 10.0 ** rng.uniform(-2, 2, n)  # a badly scaled realisation of it
    A, B, C = A / scale[:, None] * scale, rng.normal(size=(n, m)) / scale[:, None], rng.normal(size=(p, n)) * scale
    return rl.StateSpaceModel(A, B, C, rng.normal(size=(p, m)), dt)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 8),
    data=st.data(),
    method=st.sampled_from(["truncation", "residualisation"]),
    dt=st.sampled_from([0.0, 0.3]),
)
def test_error_lies_between_the_next_hankel_value_and_twice_the_tail(seed, n, data, method, dt):
    G = random_model(seed, n, dt)
    order = data.draw(st.integers(0, n))
    found = rl.reduce_model(G, order, method=method)
    largest = found.hankel[0]
    assert found.order <= order
    assert not found.model.n_states or found.model.is_stable()
    assert found.error.lower <= found.bound + 1e-9 * largest
    if found.order < n:
        assert found.error.upper >= found.hankel[found.order] * (1 - 1e-6) - 1e-9 * largest
    omega = np.random.default_rng(seed).uniform(0, 5, 20)
    gap = rl.frequency_response(G, omega) - rl.frequency_response(found.model, omega)
    assert np.linalg.norm(gap, 2, axis=(1, 2)).max() <= found.error.upper + 1e-8 * largest


@pytest.mark.slow
@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 6), loss=st.sampled_from([1e-3, 0.05, 0.5]))
def test_a_reduced_controller_loses_the_reported_share_and_no_more_than_allowed(seed, n, loss):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) - 0.5 * np.eye(n)
    B, C = rng.normal(size=(n, 3)), rng.normal(size=(3, n))
    P = rl.StateSpaceModel(A, B, C, [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    design = rl.hinf(P, 1, 1, gamma_rel=1.0)
    small = rl.reduce_controller(design, loss=loss)
    assert small.K.n_states <= design.K.n_states
    assert small.loss <= loss
    # An evaluation of its own: the loop by hand, on a grid.
    K, omega = small.K, np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 400)])
    p, k = rl.frequency_response(P, omega), rl.frequency_response(K, omega)
    loop = p[:, :2, :2] + p[:, :2, 2:] @ k @ np.linalg.solve(1 - p[:, 2:, 2:] @ k, p[:, 2:, :2])
    assert np.linalg.norm(loop, 2, axis=(1, 2)).max() <= small.gamma * (1 + 1e-9)
    assert small.gamma <= design.gamma * (1 + loss) * (1 + 1e-5)
    peak = rl.peak_gain(small.closed_loop)  # wide where the closed loop is badly conditioned, and never beside gamma
    assert peak.lower * (1 - 1e-5) <= small.gamma <= peak.upper * (1 + 1e-5)
