"""Properties of the H-infinity norm on random models."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import frequency_response
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.statespace import StateSpaceModel

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
