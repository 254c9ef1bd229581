"""Lyapunov and Sylvester equations against sums, Kronecker products and refusals."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber


@pytest.mark.parametrize("n", [1, 3, 8])
def test_as_linear_equations_in_all_entries(n):
    """``vec(A X + X B) = (I (x) A + B^T (x) I) vec X``, columns stacked: solved without any Schur form."""
    rng = np.random.default_rng(n)
    m = n + 2
    A, B, Q = rng.standard_normal((n, n)), rng.standard_normal((m, m)), rng.standard_normal((n, m))
    whole = np.kron(np.eye(m), A) + np.kron(B.T, np.eye(n))
    expected = np.linalg.solve(whole, Q.ravel(order="F")).reshape((n, m), order="F")
    found = rl.sylvester(A, B, Q)
    np.testing.assert_allclose(found.X, expected, rtol=1e-9, atol=1e-9)
    assert found.residual < 1e-13
    Q = rng.standard_normal((n, n))
    whole = np.kron(np.eye(n), A) + np.kron(A, np.eye(n))
    expected = np.linalg.solve(whole, -Q.ravel(order="F")).reshape((n, n), order="F")
    np.testing.assert_allclose(rl.lyap(A, Q).X, expected, rtol=1e-8, atol=1e-8)


def test_discrete_solution_is_the_sum():
    rng = np.random.default_rng(0)
    A, Q = 0.3 * rng.standard_normal((4, 4)), rng.standard_normal((4, 4))
    total, term = np.zeros((4, 4)), Q
    for _ in range(400):
        total, term = total + term, A @ term @ A.T
    found = rl.dlyap(A, Q)
    np.testing.assert_allclose(found.X, total, atol=1e-12)
    assert found.residual < 1e-13


def test_mirrored_eigenvalues_are_refused():
    for call in (
        lambda: rl.lyap([[1.0, 0.0], [0.0, -1.0]], np.eye(2)),
        lambda: rl.dlyap([[2.0, 0.0], [0.0, 0.5]], np.eye(2)),
        lambda: rl.sylvester([[1.0]], [[-1.0]], [[1.0]]),
        lambda: rl.sylvester([[0.0]], [[0.0]], [[1.0]]),
    ):
        with pytest.raises(NoTrustworthyNumber, match="mirror each other"):
            call()


def test_messages_carry_the_name_that_was_called():
    with pytest.raises(InputError, match=r"^lyap: Q is \(1, 1\), expected \(2, 2\)"):
        rl.lyap(np.eye(2), [[1.0]])
    with pytest.raises(InputError, match=r"^dlyap: "):
        rl.dlyap(np.eye(2), [[np.nan]])
    with pytest.raises(InputError, match=r"^sylvester: Q is \(1, 1\), expected \(2, 1\)"):
        rl.sylvester(np.eye(2), [[1.0]], [[1.0]])
    with pytest.raises(InputError, match=r"^care: B is \(1, 1\), expected \(1, 2\)"):
        rl.care([[1.0]], [[1.0]], [[1.0]], np.eye(2))


def test_empty_equations():
    nothing = np.zeros((0, 0))
    assert rl.sylvester(nothing, [[1.0]], np.zeros((0, 1))).X.shape == (0, 1)
    assert rl.lyap(nothing, nothing).X.shape == (0, 0)


def test_a_residual_of_huge_terms_is_still_a_residual():
    """Squares of 1e200 overflow: the quotient of such norms would be 0 or NaN for any X."""
    from robustlab.linear_analysis.matrix_equations import accepted_residual

    huge = np.array([[1e200]])
    assert accepted_residual("lyap", (huge, huge, -2 * huge), 1e-6) == 0.0
    with pytest.raises(NoTrustworthyNumber, match=r"^lyap: relative residual 3\.3e-01"):
        accepted_residual("lyap", (huge, huge, -huge), 1e-6)
    with pytest.raises(NoTrustworthyNumber, match="overflows"):
        accepted_residual("lyap", (huge, np.array([[np.inf]])), 1e-6)
