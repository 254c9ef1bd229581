"""The basic operations of every proof, each against an independent evaluation."""

import math

import flint
import numpy as np
import pytest
import verify_cases as cases
from flint import acb, acb_mat, arb
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verification import balls, models

BITS = 128


def ball_model(seed, n, m, p, dt=0.0, margin=0.1):
    G = cases.model(seed, n, m, p, dt, margin)
    return models.Model(*(balls.exact(G[x]) for x in "ABCD"), dt)


def response(G, s):
    """Evaluate the response at the complex number s, in balls, from the definition."""
    n = G.n
    pencil = acb_mat(balls.identity(n)) * s - G.A
    return G.D + G.C * pencil.solve(acb_mat(balls.identity(n)) * G.B)


def overlap(X, Y):
    return acb_mat(X).overlaps(acb_mat(Y))


def narrow(X):
    return all(float(x.real.rad()) + float(x.imag.rad()) < 1e-12 for x in acb_mat(X).entries())


@pytest.mark.parametrize("seed", range(5))
def test_maps_of_a_model_keep_its_response(seed):
    with balls.precision(BITS):
        G = ball_model(seed, 5, 2, 3)
        s = acb(0.25, 1.5)
        truth = response(G, s)
        mapped = response(models.reciprocal(G), 1 / s)
        assert overlap(mapped, truth)
        assert narrow(mapped)
        H = ball_model(seed, 5, 2, 3, dt=0.1)
        z = (1 + s) / (1 - s)
        assert overlap(response(models.on_the_axis(H), s), response(H, z))
        assert narrow(response(models.on_the_axis(H), s))


def signed(seed, n, values):
    """An integer matrix of the inertia of ``values``, exact in doubles."""
    rng = np.random.default_rng(seed)
    S = np.eye(n)
    for _ in range(2 * n):
        i, j = rng.permutation(n)[:2]
        S[i] += rng.integers(-2, 3) * S[j]
    return S.T @ np.diag(values) @ S


@settings(max_examples=200)
@given(st.integers(0, 10**6), st.integers(2, 7), st.sampled_from([1.0, 1e-9, 1e-300]), st.booleans())
def test_definiteness_is_inertia(seed, n, least, definite):
    values = np.ones(n)
    values[0] = least if definite else 0.0
    X = balls.exact(signed(seed, n, np.round(values)))
    with balls.precision(BITS):
        if definite and least == 1.0:
            assert balls.definite(X).proved
        else:  # singular, or lost in the rounding of values: nothing to prove
            assert not balls.definite(X).proved
        values[0] = -1.0
        assert not balls.definite(balls.exact(signed(seed, n, values))).proved


def test_ill_conditioned_and_badly_scaled_matrices():
    with balls.precision(BITS):
        hilbert = flint.arb_mat.hilbert(16, 16)  # condition 1e22
        assert balls.definite(hilbert).proved
        scale = balls.diagonal([arb(2) ** (200 * (-1) ** i * i) for i in range(16)])
        assert balls.definite(scale * hilbert * scale).proved
        wide = hilbert + balls.identity(16) * arb(0, 1e-18)
        assert not balls.definite(wide).proved
        assert balls.definite(balls.zeros(0, 0)).proved
        assert not balls.definite(balls.zeros(1, 1)).proved
        assert not balls.definite(balls.exact(np.array([[np.nan]]))).proved
        assert not balls.definite(balls.exact(np.array([[np.inf]]))).proved


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_conversions_are_exact_and_rounding_goes_outwards(x):
    y = balls.exact(np.array([[x]]))[0, 0]
    assert y.is_exact()
    assert float(y) == x
    third = arb(x) / 3
    assert arb(balls.rounded_down(third)) <= third <= arb(balls.rounded_up(third))
    assert math.isfinite(balls.rounded_up(third)) or abs(x) > 1e300
