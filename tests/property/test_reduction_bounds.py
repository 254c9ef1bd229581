"""Reduction of random models: bound, stability, sizes; the reported loss of a controller."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import frequency_response
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.statespace import StateSpaceModel


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
    peak = rl.peak_gain(small.closed_loop)  # wide if the closed loop is badly conditioned, but always contains gamma
    assert peak.lower * (1 - 1e-5) <= small.gamma <= peak.upper * (1 + 1e-5)


# --- properties of the h-infinity norm on random models ---------------------------------------------------------------


SETTINGS = settings(max_examples=40)


@st.composite
def stable_models(draw):
    n = draw(st.integers(1, 7))
    m, p = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = rng.standard_normal((n, n))
    A -= np.eye(n) * (np.linalg.eigvals(A).real.max() + 10 ** draw(st.floats(-4, 1)))
    A *= 10 ** draw(st.floats(-4, 4))
    t = 10 ** rng.uniform(-3, 3, n)  # a badly scaled basis
    D = rng.standard_normal((p, m)) * draw(st.sampled_from([0.0, 1.0, 30.0]))
    return StateSpaceModel(
        A * t[:, None] / t, rng.standard_normal((n, m)) * t[:, None], rng.standard_normal((p, n)) / t, D
    )


@SETTINGS
@given(stable_models())
def test_bracket_holds_against_a_dense_sweep(model):
    norm = hinf_norm(model)
    size = np.abs(model.poles())
    omega = np.concatenate([np.geomspace(size.min() / 100, size.max() * 100, 3000), np.abs(model.poles().imag)])
    sweep = np.linalg.norm(frequency_response(model, omega), 2, axis=(1, 2)).max()
    assert norm.status.trustworthy
    assert sweep <= norm.upper * (1 + 1e-9)
    assert sweep <= norm.value * (1 + 2e-6)
    attained = np.linalg.norm(frequency_response(model, norm.frequency)[0], 2)
    assert abs(attained - norm.lower) <= 1e-9 * norm.lower


@SETTINGS
@given(stable_models(), st.floats(-2, 1))
def test_the_bilinear_map_keeps_the_norm(model, log_step):
    dt = 10**log_step / np.median(np.abs(model.poles()))
    norm, mapped = hinf_norm(model), hinf_norm(bilinear_to_discrete(model, dt))
    assert abs(mapped.value / norm.value - 1) < 1e-5
