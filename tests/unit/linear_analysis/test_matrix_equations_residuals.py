"""Riccati and Lyapunov equations against their residuals and closed forms."""

import numpy as np
import pytest

from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import care, dare, hamiltonian_riccati, lyapunov


@pytest.mark.parametrize("n", [1, 2, 5, 12])
@pytest.mark.parametrize("indefinite", [False, True])
def test_care_residual_and_stability(n, indefinite):
    rng = np.random.default_rng(n)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, 3)), rng.standard_normal((2, n))
    R = np.diag([1.0, 2.0, -1e4 if indefinite else 0.5])
    S = 0.1 * rng.standard_normal((n, 3))
    Q = C.T @ C + 0.5 * np.eye(n)
    found = care(A, B, Q, R, S)
    left = A.T @ found.X + found.X @ A + Q - (found.X @ B + S) @ np.linalg.solve(R, B.T @ found.X + S.T)
    assert np.linalg.norm(left) <= 1e-8 * (np.linalg.norm(found.X) * np.linalg.norm(A) + np.linalg.norm(Q))
    assert np.linalg.eigvals(A + B @ found.gain).real.max() < 0
    np.testing.assert_allclose(found.X, found.X.T)


def test_a_chain_of_lags_over_nine_decades_has_the_poles_of_its_spectral_factor():
    """With ``y = k u / p(s)`` the optimal poles are the stable roots of ``p(s) p(-s) + k^2``, for Q = c^T c, R = 1.

    The Schur form of the Hamiltonian alone gives an X wrong by a half, with a relative residual of 0.3.
    """
    lags, gains = 10.0 ** np.array([-5.5, 0.5, 2.8, 3.7, 3.8]), 10.0 ** np.array([-0.3, 1.8, 0.5, -2.6])
    A, B, C = np.diag(-lags) + np.diag(gains, 1), np.zeros((5, 1)), np.zeros((1, 5))
    B[-1], C[0, 0] = 10.0**1.6, 10.0**4.8
    p, mirrored = np.poly(-lags), np.poly(lags) * -1.0
    product = np.polymul(p, mirrored)[::2]  # in s^2
    product[-1] += (C[0, 0] * B[-1, 0] * gains.prod()) ** 2
    expected = np.sort_complex(-np.sqrt(np.roots(product).astype(complex)))
    found = care(A, B, C.T @ C, np.eye(1))
    X = hamiltonian_riccati(A, B @ B.T, C.T @ C)
    assert X is not None
    for loop in (A + B @ found.gain, A - B @ B.T @ X):
        np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(loop)), expected, rtol=1e-6)


# K by the eigenvectors of the Hamiltonian with 600 bits (python-flint); B = e_1 or e_n, Q = I, R = 1.
SPREAD = [
    ([[0, 0, 0], [-1e-7, 1.95, -0.951], [0, 1, 0]], [1, 0, 0], [4.9, -1.1505e8, 3.7089e7], 1e-12),
    ([[1, 1e-8], [0, 2]], [0, 1], [647213595.4999579, 6.23606797749979], 1e-12),
]


@pytest.mark.parametrize(("A", "b", "K", "rtol"), SPREAD)
def test_a_solution_of_sixteen_decades_is_found(A, b, K, rtol):
    """MATLAB Answers: `lqr` of the first one is refused for eigenvalues on the axis, which are 0.975 away from it."""
    n = len(A)
    found = care(A, np.transpose([b]), np.eye(n), np.eye(1))
    np.testing.assert_allclose(-found.gain[0], K, rtol=rtol)
    X = hamiltonian_riccati(np.array(A, float), np.outer(b, b).astype(float), np.eye(n))
    np.testing.assert_allclose(b @ X, K, rtol=rtol)


ONE, ZERO, NO_CARE = [[1.0]], [[0.0]], "^care: no stabilising solution was found.*"


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: care(ONE, ZERO, ONE, ONE), NO_CARE + "imaginary axis"),
        (lambda: care(np.eye(2)[::-1] * [[1], [-1]], np.zeros((2, 1)), np.zeros((2, 2)), ONE), NO_CARE + "imaginary"),
        (lambda: care(ONE, ONE, ONE, ZERO), NO_CARE + "R is singular"),
        (lambda: lyapunov(ZERO, ONE), r"\S"),
        (lambda: lyapunov(np.diag([1.0, -1.0]), np.ones((2, 2))), r"\S"),
        (lambda: dare(ONE, ZERO, ONE, ONE), "unit circle"),
        (lambda: dare([[2.0]], ZERO, ONE, ONE), "unit circle"),
        (lambda: dare(ONE, ONE, ZERO, ONE), "unit circle"),
    ],
)
def test_equations_without_a_solution_are_refused(call, reason):
    with pytest.raises(NoTrustworthyNumber, match=reason):
        call()


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("n", [0, 1, 6])
def test_lyapunov_residual(n, discrete):
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n)) * 0.2 - (0 if discrete else 1) * np.eye(n)
    Q = np.eye(n)
    X = lyapunov(A, Q, discrete)
    left = A @ X @ A.T - X + Q if discrete else A @ X + X @ A.T + Q
    assert np.abs(left).max(initial=0.0) < 1e-10


@pytest.mark.parametrize("n", [1, 2, 6])
def test_dare_against_scipy_and_its_own_equation(n):
    rng = np.random.default_rng(n)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    F = rng.standard_normal((n + 2, n + 2))
    W = F @ F.T
    Q, R, S = W[:n, :n], W[n:, n:], W[:n, n:]
    found = dare(A, B, Q, R, S)
    X, F = found.X, found.gain
    np.testing.assert_allclose(A.T @ X @ A - X + Q + (A.T @ X @ B + S) @ F, 0, atol=1e-8 * np.linalg.norm(X))
    assert np.abs(np.linalg.eigvals(A + B @ F)).max() < 1
    assert (np.linalg.eigvalsh(X) > -1e-9 * np.linalg.norm(X)).all()


def test_dare_without_states():
    assert dare(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), [[1.0]]).gain.shape == (1, 0)
