"""S, T, K S and S G against their definitions, in both signs, and the bounds of weights."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import (
    complementary_weight,
    control_weight,
    frequency_response,
    loop_functions,
    mixsyn,
    performance_weight,
)
from robustlab.statespace import StateSpaceModel

OMEGA = np.geomspace(1e-3, 1e3, 60)


def random_model(rng, n, p, m, dt=0.0, direct=1.0):
    A = rng.standard_normal((n, n)) * 0.3
    return StateSpaceModel(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), direct * rng.standard_normal((p, m)), dt
    )


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_functions_equal_their_definitions(sign, dt):
    rng = np.random.default_rng(3)
    G, K = random_model(rng, 4, 2, 3, dt), random_model(rng, 2, 3, 2, dt, 0.2)
    loop = loop_functions(G, K, sign=sign)
    omega = OMEGA[OMEGA < 300]
    g, k = frequency_response(G, omega), frequency_response(K, omega)
    s = np.linalg.inv(np.eye(2) - sign * g @ k)
    for name, expected in (("S", s), ("T", -sign * g @ k @ s), ("KS", -sign * k @ s), ("SG", s @ g)):
        np.testing.assert_allclose(frequency_response(loop.model(name), omega), expected, atol=1e-9)
    np.testing.assert_allclose(loop.singular_values("SG", omega), np.linalg.svd(s @ g, compute_uv=False), atol=1e-9)


def test_a_mixed_sensitivity_design_is_within_its_bounds():
    rng = np.random.default_rng(5)
    G = random_model(rng, 4, 2, 3)
    weights = performance_weight(1.0), control_weight(10.0, 50.0), complementary_weight(20.0)
    design = mixsyn(G, *weights, gamma_rel=1.0)
    loop = loop_functions(design)
    assert loop.is_stable()
    assert loop.S.n_states == G.n_states + design.K.n_states  # without states of the weights
    g, k = frequency_response(G, OMEGA), frequency_response(design.K, OMEGA)
    s = np.linalg.inv(np.eye(2) + g @ k)
    np.testing.assert_allclose(frequency_response(loop.S, OMEGA), s, atol=1e-8)
    np.testing.assert_allclose(frequency_response(loop.KS, OMEGA), k @ s, atol=1e-8)
    for name in ("S", "KS", "T"):
        assert (loop.gain(name, OMEGA) <= loop.bound(name, OMEGA) * (1 + 1e-9)).all()
    assert loop.bound("SG", OMEGA) is None
    bound = loop.bound("S", [2.0])
    assert bound is not None
    assert bound[0] == pytest.approx(design.gamma / abs(frequency_response(weights[0], [2.0])[0, 0, 0]), rel=1e-12)
