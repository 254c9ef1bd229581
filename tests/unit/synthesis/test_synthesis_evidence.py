"""Evidence of an H-infinity design: lower bounds, estimates, bandwidth."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import hinf, mixsyn
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.result import plain
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import GeneralizedPlant, gamma_bound

SINGULAR = StateSpaceModel([[-1.0]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]])


# --- lower bounds ---


@pytest.mark.parametrize("seed", range(2))
def test_a_hidden_mode_next_to_a_multiple_pole_is_no_zero(seed):
    """Four integrators in a row in any coordinates: only W1(inf) = 0.5 limits gamma."""
    rng = np.random.default_rng(seed)
    T = rng.normal(size=(4, 4))
    A = T @ np.diag(np.ones(3), 1) @ np.linalg.inv(T)
    G = StateSpaceModel(A, rng.normal(size=(4, 2)), rng.normal(size=(1, 4)), np.zeros((1, 2)))
    design = mixsyn(G, StateSpaceModel([[-1e-7]], [[1.0]], [[5e-5]], [[0.5]]), 0.3)
    assert design.lower_bound.value == pytest.approx(0.5, rel=1e-6)
    assert 0.5 < design.gamma < 0.55


def test_a_right_half_plane_zero_bounds_gamma_by_the_weight_there():
    """S(z) = 1 at a zero z of the plant, so ||W1 S|| >= |W1(z)|; with a small penalty on u it is attained."""
    zero = 2.0
    G = StateSpaceModel([[-1.0]], [[1.0]], [[-1.0 - zero]], [[1.0]])  # (s - 2) / (s + 1)
    W1 = StateSpaceModel([[-0.1]], [[1.0]], [[3.0]], [[0.0]])
    design = mixsyn(G, W1, gamma_rel=1.0)
    exact = 3.0 / (zero + 0.1)
    assert design.gamma_lower == pytest.approx(exact, rel=1e-5)
    assert design.gamma_lower <= exact
    assert exact * (1 - 1e-9) <= design.gamma <= 1.001 * exact
    assert "right half plane" in design.lower_bound.known
    assert "proved at the zero s = 2 rad/s" in design.lower_bound.known


def test_lower_bound_equals_gamma_if_one_frequency_decides():
    design = hinf(SINGULAR, 1, 1, gamma_rel=1.0)
    exact = 1 / np.sqrt(2)
    assert design.gamma_lower <= exact * (1 + 1e-12)
    assert design.gamma_lower == pytest.approx(exact, rel=1e-4)
    assert "0 rad/s: no controller, causal or not" in design.lower_bound.known


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_no_stable_loop_is_below_the_bound(seed):
    """No stabilising controller, here K = 0 or a small random K of a stable plant, violates it."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    A = rng.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    D = rng.standard_normal((3, 3)) * rng.integers(0, 2, (3, 3))
    D[2, 2] = 0.0
    plant = StateSpaceModel(A, rng.standard_normal((n, 3)), rng.standard_normal((3, n)), D)
    found = gamma_bound(GeneralizedPlant(plant, 1, 1)).value
    for size in (0.0, 0.1, 1.0):
        k = rng.standard_normal(4) * size
        K = StateSpaceModel([[-1.0 - abs(k[0])]], [[k[1]]], [[k[2]]], [[k[3]]])
        norm = hinf_norm(GeneralizedPlant(plant, 1, 1).close(K))
        assert found <= norm.upper * (1 + 1e-9)


def test_bound_of_a_discrete_plant():
    plant = bilinear_to_discrete(SINGULAR, 0.5)
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    assert design.gamma_lower == pytest.approx(1 / np.sqrt(2), rel=1e-4)
    assert "0 rad/s" in design.lower_bound.known


def test_the_evidence_is_in_the_file():
    data = json.loads(json.dumps(plain(hinf(SINGULAR, 1, 1).to_json())))
    assert {"gamma_lower", "lower_bound", "assumptions"} <= data.keys()
    assert data["lower_bound"]["proved"] is True
