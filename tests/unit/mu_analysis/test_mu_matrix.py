"""mu of constant matrices: closed forms, published numbers, edges, bad input."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis import proves


def random_complex(seed: int, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


SLICOT = np.array(
    [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    * 2
)
SLICOT_BLOCKS = [[-1, 0], [-1, 0], [2, 2], [1, 0], [1, 0]]


def test_example_of_the_slicot_documentation():
    bounds = rl.mu(SLICOT, SLICOT_BLOCKS)
    assert bounds.upper == pytest.approx(41.74753408, rel=1e-8)
    assert bounds.lower == pytest.approx(41.74753408, rel=1e-7)
    assert bounds.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (2, 4), (4, 2), (1, 3)])
def test_one_full_block_is_the_largest_singular_value(shape):
    M = random_complex(1, *shape)
    bounds = rl.mu(M, [[shape[1], shape[0]]])
    expected = np.linalg.norm(M, 2)
    assert bounds.upper == pytest.approx(expected, rel=1e-9)
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.delta.shape == (shape[1], shape[0])


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_one_repeated_complex_scalar_is_the_spectral_radius(n):
    M = random_complex(2, n, n)
    bounds = rl.mu(M, [[n, 0]])
    expected = np.abs(np.linalg.eigvals(M)).max()
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)


def test_one_repeated_real_scalar_is_the_largest_real_eigenvalue():
    M = np.diag([3.0 + 1j, -2.0, 1.0])
    T = random_complex(3, 3, 3)
    bounds = rl.mu(T @ M @ np.linalg.inv(T), [[-3, 0]])
    assert bounds.lower == pytest.approx(2.0, rel=1e-9)
    assert bounds.upper == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("n", [2, 5, 12])
def test_rank_one_matrix_with_complex_scalars(n):
    # mu(u v^*) = sum |u_i| |v_i|
    u, v = random_complex(4, 2, n)
    expected = (np.abs(u) * np.abs(v)).sum()
    bounds = rl.mu(np.outer(u, v.conj()), [[1, 0]] * n)
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)


def test_rank_one_matrix_with_real_scalars():
    # min max |d_i| with sum d_i a_i = 1 by brute force over the phase of the dual
    a = random_complex(5, 4)
    theta = np.linspace(0, np.pi, 400001)
    dual = np.cos(theta) / np.abs((np.exp(1j * theta)[:, None] * a).real).sum(axis=1)
    expected = 1 / np.abs(dual).max()
    bounds = rl.mu(np.outer(np.ones(4), a), [[-1, 0]] * 4)
    assert bounds.lower == pytest.approx(expected, rel=1e-6)
    assert bounds.upper == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("M", "blocks"),
    [
        (np.zeros((3, 3)), [[1, 0], [-2, 0]]),
        ([[0, 1], [0, 0]], [[1, 0], [1, 0]]),
        (np.triu(np.ones((6, 6)), 1), [[-1, 0]] * 6),
        (np.zeros((0, 0)), []),
        (1j * np.eye(2), [[-1, 0], [-1, 0]]),
        ([[1j, 2], [0, 1j]], [[-2, 0]]),
    ],
)
def test_nothing_destabilises(M, blocks):
    bounds = rl.mu(M, blocks)
    assert bounds.upper == 0.0
    assert bounds.lower == 0.0
    assert not bounds.delta.any()
    assert bounds.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("kind", [-1, 1])
@pytest.mark.parametrize("decades", [12, 100, 150])
def test_a_small_coupling_is_no_zero(decades, kind):
    # mu([[0, a], [b, 0]]) = sqrt(a b); the square of b / a is below the smallest number
    bounds = rl.mu([[0, 10.0**decades], [10.0**-decades, 0]], [[kind, 0]] * 2)
    assert bounds.lower == pytest.approx(1.0, rel=1e-9)
    assert bounds.upper == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("blocks", [[[1, 0]] * 2, [[-1, 0]] * 2, [[2, 2]], [[2, 0]]])
@pytest.mark.parametrize("factor", [1e-300, 1e-200, 1e200, 1e300])
def test_size_of_the_matrix_is_a_factor_of_mu(factor, blocks):
    M = np.array([[1.0, 2.0], [3.0, 4.0]])
    plain, scaled = rl.mu(M, blocks), rl.mu(factor * M, blocks)
    assert scaled.lower == pytest.approx(factor * plain.lower, rel=1e-9)
    assert scaled.upper == pytest.approx(factor * plain.upper, rel=1e-6)
    assert scaled.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("coupling", [1e3, 1e10, 1e13, 1e16])
def test_a_nearly_singular_loop_of_a_non_normal_matrix_is_no_lower_bound(coupling, real):
    # One repeated scalar: mu is the largest (real) eigenvalue, for any entries above the diagonal.
    block = [[-2 if real else 2, 0]]
    assert rl.mu([[0.5, coupling], [0.0, 0.5]], block).lower <= 0.5 * (1 + 1e-9)
    assert rl.mu([[0.0, coupling], [0.0, 0.0]], block).lower == 0.0
    if real:
        assert rl.mu([[0.5, coupling], [-1 / coupling, 0.5]], block).lower == 0.0


@pytest.mark.parametrize("imaginary", [1e-9, 2e-11, 5e-12, 1e-12, 1e-13])
def test_real_delta_needs_a_real_value(imaginary):
    assert rl.mu([[1 + 1j * imaginary]], [[-1, 0]]).lower == 0.0
    two = rl.mu(np.diag([1 + 1j * imaginary, 0.5]), [[-1, 0]] * 2)
    assert two.lower == pytest.approx(0.5, rel=1e-9)
    assert two.upper >= 0.5
    # det(I - M Delta) = 1 - j d1 d2
    assert rl.mu([[0, 1j], [1, 0]], [[-1, 0]] * 2).lower == 0.0


def test_a_bound_next_to_zero_is_proved_in_spite_of_couplings():
    M = [[0.83347462 - 1.7043919j, 0], [-0.12644912 - 0.0820067j, 0]]
    bounds = rl.mu(M, [[-1, 0], [-1, 0]])
    assert bounds.lower == 0.0
    assert bounds.upper <= 1e-5


def test_reducible_matrix_is_as_large_as_its_largest_component():
    M = np.zeros((6, 6), dtype=complex)
    parts = random_complex(7, 3, 2, 2)
    for i, part in enumerate(parts):
        M[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = part
    M[0:2, 2:6] = 1e3
    M[2:4, 4:6] = 1e6
    bounds = rl.mu(M, [[1, 0]] * 6)
    expected = max(rl.mu(part, [[1, 0]] * 2).upper for part in parts)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)
    assert bounds.lower == pytest.approx(expected, rel=1e-5)
    assert proves(M, bounds.D, bounds.D_z, bounds.G, bounds.upper)


def test_stack_equals_single_matrices():
    M = random_complex(8, 3, 4, 4)
    blocks = [[-1, 0], [1, 0], [2, 2]]
    stacked = rl.mu(M, blocks)
    assert stacked.upper.shape == stacked.lower.shape == (3,)
    assert stacked.D.shape == stacked.G.shape == stacked.delta.shape == (3, 4, 4)
    for i in range(3):
        assert stacked.upper[i] == pytest.approx(rl.mu(M[i], blocks).upper, rel=1e-6)


def test_a_bound_that_is_too_small_is_not_proved():
    bounds = rl.mu(SLICOT, SLICOT_BLOCKS)
    assert proves(SLICOT, bounds.D, bounds.D_z, bounds.G, bounds.upper)
    assert not proves(SLICOT, bounds.D, bounds.D_z, bounds.G, bounds.upper * (1 - 1e-6))
    assert not proves(SLICOT, -bounds.D, -bounds.D_z, bounds.G, bounds.upper)
