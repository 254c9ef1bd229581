"""The parts on which every proof rests, each against an independent evaluation."""

import math

import flint
import numpy as np
import pytest
import verify_cases as cases
from flint import acb, acb_mat, arb
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verification import balls, forms, models

BITS = 128


def ball_model(seed, n, m, p, dt=0.0, margin=0.1):
    G = cases.model(seed, n, m, p, dt, margin)
    return models.Model(*(balls.exact(G[x]) for x in "ABCD"), dt)


def response(G, s):
    """The response at the complex number s, in balls, straight from the definition."""
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
        for mapped, at in ((models.modal(G)[0], s), (models.reciprocal(G), 1 / s)):
            assert overlap(response(mapped, at), truth)
            assert narrow(response(mapped, at))
        assert overlap(response(models.modal(models.reciprocal(G))[0], 1 / s), truth)
        H = ball_model(seed, 5, 2, 3, dt=0.1)
        z = (1 + s) / (1 - s)
        assert overlap(response(models.on_the_axis(H), s), response(H, z))
        assert narrow(response(models.on_the_axis(H), s))


@pytest.mark.parametrize("seed", range(6))
def test_a_loop_is_that_of_its_equations(seed):
    n, k, m, p, u, y = 3, 2, 2, 1, 2, 3
    P, K = cases.model(seed, n, m + u, p + y), cases.model(seed + 100, k, y, u)
    numbers = {f"P_{x}": P[x] for x in "ABCD"} | {f"K_{x}": K[x] for x in "ABCD"}
    with balls.precision(BITS):
        closed = models.loop(cases.claimed("loop-norm", numbers, n_meas=y, n_con=u, dt=0.0))
        s = acb(0.5, 2.0)
        plant, control = (response(models.Model(*(balls.exact(G[x]) for x in "ABCD"), 0.0), s) for G in (P, K))
        G11, G12, G21, G22 = (
            balls.part(plant, r, c) for r in (slice(0, p), slice(p, p + y)) for c in (slice(0, m), slice(m, m + u))
        )
        inner = (acb_mat(balls.identity(y)) - G22 * control).solve(G21)
        truth = G11 + G12 * control * inner
        assert (closed.n, closed.m, closed.p) == (n + k, m, p)
        assert overlap(response(closed, s), truth)
        assert narrow(truth)


@pytest.mark.parametrize("seed", range(4))
def test_the_form_of_a_polynomial_is_that_of_its_matrix(seed):
    rng = np.random.default_rng(seed)

    def entries(*shape):
        return balls.exact(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    with balls.precision(BITS):
        H = [x + balls.adjoint(x) for x in (entries(3, 3), entries(2, 2))]
        form = forms.Form(H[0], H[1], entries(3, 2))
        C, D, S, X = entries(2, 4), entries(2, 3), entries(3, 3), [entries(4, 3) for _ in range(4)]
        quadratic = form.of_sum(D, C)
        higher = quadratic.higher(X, S)
        assert len(higher) == 6
        e = arb(0.75)
        M = D + C * sum((x * e**k for k, x in enumerate(X)), acb_mat(4, 3))
        truth = balls.adjoint(S) * H[0] * S - balls.adjoint(M * S) * H[1] * M * S
        cross = balls.adjoint(S) * form.G * M * S * acb(0, 1)
        truth = truth - cross - balls.adjoint(cross)
        value = balls.adjoint(S) * quadratic.at(X[0]) * S
        value = sum((y * e ** (k + 1) for k, y in enumerate(higher)), value)
        assert overlap(value, truth)
        assert narrow(value)


def signed(seed, n, values):
    """An integer matrix of the inertia of ``values``, exact in doubles."""
    rng = np.random.default_rng(seed)
    S = np.eye(n)
    for _ in range(2 * n):
        i, j = rng.permutation(n)[:2]
        S[i] += rng.integers(-2, 3) * S[j]
    return S.T @ np.diag(values) @ S


@settings(max_examples=200, deadline=None)
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


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.01, 3))
def test_definiteness_of_a_polynomial_holds_at_each_point(seed, size):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((3, 4, 4)) + 1j * rng.standard_normal((3, 4, 4))
    X = (X + X.conj().transpose(0, 2, 1)) / 2 * np.array([0.2, size, size**2 / 4])[:, None, None] + np.eye(
        4
    ) * np.array([3.0, 0, 0]).reshape(3, 1, 1)
    with balls.precision(BITS):
        F = [balls.exact(x) for x in X]
        if balls.definite(F[0], lambda S: [balls.adjoint(S) * x * S for x in F[1:]]).proved:
            for e in np.linspace(-1, 1, 41):
                assert np.linalg.eigvalsh(X[0] + e * X[1] + e**2 * X[2])[0] > 0


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_conversions_are_exact_and_rounding_goes_outwards(x):
    y = balls.exact(np.array([[x]]))[0, 0]
    assert y.is_exact()
    assert float(y) == x
    third = arb(x) / 3
    assert arb(balls.rounded_down(third)) <= third <= arb(balls.rounded_up(third))
    assert math.isfinite(balls.rounded_up(third)) or abs(x) > 1e300
