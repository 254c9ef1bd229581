"""The D-G upper bound against a semidefinite program solved by another code (cvxpy with Clarabel)."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import FullBlock, RealScalar
from robustlab.uncertainty import as_blocks, structure_size


def hermitian_variable(cp, n):
    return cp.Variable((n, n), hermitian=True) if n > 1 else cp.Variable((1, 1))


def feasible(M, blocks, beta):
    """Whether the D-G inequality at beta has a solution, with trace normalised and a margin maximised."""
    import cvxpy as cp

    q = structure_size(blocks)[0]
    d_w, d_z, g = [], [], []
    constraints = []
    for block in blocks:
        if isinstance(block, FullBlock):
            d = cp.Variable()
            d_w.append(d * np.eye(block.rows))
            d_z.append(d * np.eye(block.cols))
            g.append(np.zeros((block.rows, block.cols)))
            constraints.append(d >= 1e-6)
        else:
            d = hermitian_variable(cp, block.rows)
            d_w.append(d)
            d_z.append(d)
            constraints.append(d >> 1e-6 * np.eye(block.rows))
            real = isinstance(block, RealScalar)
            g.append(hermitian_variable(cp, block.rows) if real else np.zeros((block.rows, block.rows)))

    def diagonal(parts, shapes):
        rows = [
            [parts[i] if i == j else np.zeros((shapes[i][0], shapes[j][1])) for j in range(len(parts))]
            for i in range(len(parts))
        ]
        return cp.bmat(rows)

    sizes_w = [(b.rows, b.rows) for b in blocks]
    sizes_z = [(b.cols, b.cols) for b in blocks]
    Dw, Dz = diagonal(d_w, sizes_w), diagonal(d_z, sizes_z)
    G = diagonal(g, [(b.rows, b.cols) for b in blocks])
    slack = cp.Variable()
    value = M.conj().T @ Dz @ M + 1j * (G @ M - M.conj().T @ G.H) - beta**2 * Dw
    lmi = (value + value.H) / 2 + slack * np.eye(q)
    problem = cp.Problem(cp.Maximize(slack), [*constraints, lmi << 0, cp.real(cp.trace(Dw)) == q, slack <= 1])
    # The answer is the sign of the slack: six digits of it are plenty, and more of them end as "inaccurate".
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-6, tol_gap_rel=1e-6, tol_feas=1e-6)
    assert problem.status == "optimal"
    return slack.value > 1e-5


@pytest.mark.parametrize(
    "rows",
    [
        [[-1, 0], [-1, 0], [1, 0]],
        [[-1, 0]] * 6,
        [[-2, 0], [1, 0]],
        [[-2, 0], [-2, 0], [1, 0]],
        [[-3, 0], [3, 0]],
        [[2, 0], [1, 2]],
        [[3, 0], [2, 0], [1, 0]],
        [[2, 3], [3, 1], [-1, 0]],
        [[2, 2], [2, 2], [-2, 0]],
        [[-2, 0], [-1, 0], [2, 1]],
    ],
)
@pytest.mark.parametrize("real", [False, True])
def test_upper_bound_is_the_optimum_of_the_lmi(rows, real):
    blocks = as_blocks(rows)
    rng = np.random.default_rng(len(rows))
    q, p = structure_size(blocks)
    M = rng.standard_normal((p, q)) + (0 if real else 1j) * rng.standard_normal((p, q))
    M = (M / np.linalg.norm(M, 2)).astype(complex)
    upper = rl.mu(M, blocks).upper
    assert feasible(M, blocks, upper * 1.001)
    assert not feasible(M, blocks, upper * 0.999)


@pytest.mark.parametrize("n", [5, 14])
def test_agrees_with_ab13md(n):
    import slycot

    rng = np.random.default_rng(n)
    M = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    real = n // 2
    own = rl.mu(M, [[-1, 0]] * real + [[1, 0]] * (n - real)).upper
    peer = slycot.ab13md(M, np.ones(n, dtype=int), np.array([1] * real + [2] * (n - real)))[0]
    assert own == pytest.approx(peer, rel=1e-6)
