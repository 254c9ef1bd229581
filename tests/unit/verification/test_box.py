"""A box of frequency: its family of matrices, compared with determinants and eigenvalues."""

import numpy as np
import pytest
from flint import acb, acb_mat, arb
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verification import Blurred, Work, balls, models, norms

BITS = 192


@settings(max_examples=200)
@given(st.integers(0, 10**6), st.integers(1, 6), st.floats(0.01, 10))
def test_regular_within_agrees_with_the_eigenvalues(seed, n, r):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    real = rng.random(n) < 0.4
    values[real] = values[real].real
    V = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)) + 2 * np.eye(n)
    with balls.precision(BITS):
        exact_V = balls.exact(V)
        H = exact_V * balls.exact(np.diag(values)) * acb_mat(balls.inverse(exact_V))
        singular = bool((real & (np.abs(values) * r >= 1)).any())
        near = bool((real & (np.abs(np.abs(values) * r - 1) < 1e-6)).any())
        if singular or not near:
            assert norms.regular_within(H, r) == (not singular)


def test_defective_and_extreme_families():
    with balls.precision(BITS):
        shift = balls.exact(np.diag(np.ones(3), 1).astype(complex))
        assert norms.regular_within(shift, 10.0)  # nilpotent: there is no base of eigenvectors
        assert not norms.regular_within(balls.exact(np.array([[1.0 + 0j]])), 1.0)  # singular at the end of the range
        assert norms.regular_within(balls.exact(np.array([[1.0 + 0j]])), 0.999999)
        assert norms.regular_within(balls.exact(np.array([[1.0 + 1e-9j]])), 2.0)
        assert norms.regular_within(balls.exact(np.array([[1e-300 + 0j]])), 1e290)
        assert not norms.regular_within(balls.exact(np.array([[np.nan + 0j]])), 1.0)
        wide = balls.exact(np.array([[1.0 + 1e-3j]])) + acb_mat(1, 1, [acb(arb(0), arb(0, 2e-3))])
        with pytest.raises(Blurred):
            norms.regular_within(wide, 2.0)


def test_an_unobservable_pole_is_detected():
    """B = 0: F is constant and positive, and A has the eigenvalue j."""
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    G = models.Model(balls.exact(A), balls.zeros(2, 1), balls.exact(np.ones((1, 2))), balls.zeros(1, 1), 0.0)
    form = models.gain_form(1, 1, 1.0)
    with balls.precision(BITS):
        quadratic = form.of_sum(G.D, G.C)
        assert norms._box(G, 0.5, 0.4999, quadratic).proved
        assert not norms._box(G, 0.5, 0.5, quadratic).proved
        assert not norms.axis(G, [(0.0, 2.0, form)], Work(400)).proved
        assert norms.axis(G, [(0.0, 0.9999, form)], Work(400)).proved


@pytest.mark.parametrize("n", [3, 5])
def test_a_nonnormal_matrix_with_small_eigenvalues_is_regular(n):
    """A rotated Jordan block of 1/2 with 50 off the diagonal: |H| has a radius far above 1, without eigenvectors."""
    Q = np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
    H = Q @ (0.5 * np.eye(n) + 50.0 * np.eye(n, k=1)) @ Q.T
    assert np.abs(np.linalg.eigvals(np.abs(H))).max() > 10
    with balls.precision(BITS):
        assert norms.regular_within(balls.exact(H.astype(complex)), 1.0)
        assert not norms.regular_within(balls.exact(H.astype(complex)), 2.01)
